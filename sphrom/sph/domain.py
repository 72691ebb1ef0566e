"""What every domain offers: where the fluid is, how far walls are, and points to fill it with.

A domain lies in an axis-parallel box, periodic along some axes. Walls stand where fluid ends. All
lengths are in [m], and positions are (n_points, 2).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array, Indices, Mask
from sphrom.sph.polygons import ROUNDING, least_widths

FINEST = 5e-5
"""Finer features aren't looked at when widths are measured, over the size of the box."""
SIDES = (("left", "right"), ("bottom", "top"))
"""Names of the walls at the lower and upper ends of each axis."""


@dataclass(frozen=True)
class Walls:
    """Ghost particles, fixed in the solid as deep as some layers of particles."""

    position: Array
    """(n_ghosts, 2) [m]."""
    velocity: Array
    """(n_ghosts, 2) that of the wall each belongs to [m/s]."""
    wall: Indices
    """(n_ghosts,) the wall that each belongs to, an index of `Domain.wall_names`."""
    normal: Array | None
    """(n_ghosts, 2) 1 along the axes of the normals of the walls that a ghost is behind, else 0;
    None where walls follow no axis."""

    def moving(self, wall_velocity: Callable[[Array], Array]) -> Walls:
        """Return them with the velocity (n_ghosts, 2) [m/s] of walls, from ghosts' positions."""
        return replace(self, velocity=wall_velocity(self.position))


@dataclass(frozen=True)
class WallSearch:
    """Distances from walls at every substep, of sources as `sphrom.kernels.sweeps` has them."""

    kernels: Any
    """The compiled module that knows walls of this kind."""
    lists: tuple[Any, ...]
    """The walls, as its kernels take them."""

    def distances(self, targets: Indices, source: Array) -> Array:
        """Return the distance (n_targets,) [m] of some sources from the nearest wall."""
        distance = np.empty(targets.size)
        self.kernels.wall_distances(targets, source, *self.lists, distance)
        return distance


def first_of(particles: Indices, position: Array) -> str:
    """Return the first of some particles at positions (2, n_particles) [m], in words."""
    x, y = position[:, particles[0]]
    more = f" (one of {particles.size})" if particles.size > 1 else ""
    return f"particle {particles[0]} at ({x:.6g}, {y:.6g}) m{more}"


class Domain(ABC):
    """The part of a box that fluid fills."""

    lower: tuple[float, float]
    """The box's lower corner [m]."""
    upper: tuple[float, float]
    """The box's upper corner [m]."""
    periodic: tuple[bool, bool]
    """Whether the box is periodic, by axis."""

    @property
    def lengths(self) -> tuple[float, float]:
        """The box's edges [m]."""
        return (self.upper[0] - self.lower[0], self.upper[1] - self.lower[1])

    @property
    @abstractmethod
    def fluid(self) -> BaseGeometry:
        """What fluid fills of the box."""

    @property
    @abstractmethod
    def fluid_with_images(self) -> BaseGeometry:
        """The fluid in the box and, along periodic axes, in its images on either side."""

    @property
    def area(self) -> float:
        """The area that fluid fills [m2]."""
        return float(shapely.area(self.fluid))

    @property
    def separate_areas(self) -> list[float]:
        """The areas [m2] of parts of the fluid without a way between them, the largest first."""
        return [self.area]

    @property
    @abstractmethod
    def solid_names(self) -> tuple[str, ...]:
        """What each solid in the box is called."""

    @property
    def wall_names(self) -> tuple[str, ...]:
        """What each wall is called: sides of the box that aren't periodic, then solids."""
        sides = (names for names, p in zip(SIDES, self.periodic, strict=True) if not p)
        return (*(name for names in sides for name in names), *self.solid_names)

    @property
    def fills_box(self) -> bool:
        """Whether fluid fills the whole box."""
        return not self.solid_names

    @property
    def has_walls(self) -> bool:
        """Whether anything bounds the fluid."""
        return bool(self.wall_names)

    @property
    def narrowest_gap(self) -> float:
        """The least width of the fluid between walls, or length of a period [m].

        `sphrom.sph.polygons` says which walls it is between.
        """
        periods = (n for n, p in zip(self.lengths, self.periodic, strict=True) if p)
        return min((self._least_widths[0], *periods))

    @property
    def thinnest_solid(self) -> float:
        """The least width of a solid between fluid and fluid, infinite where none is [m]."""
        return self._least_widths[1]

    @cached_property
    def _least_widths(self) -> tuple[float, float]:
        if self.fills_box:
            return min(self.lengths), math.inf
        # Of finer corners there may be thousands.
        fluid = shapely.simplify(self.fluid_with_images, FINEST * max(self.lengths))
        return least_widths(fluid, self._is_wall, np.array(self.lower), np.array(self.upper))

    def _is_wall(self, place: Array) -> Mask:
        """Whether the outline (n_points, 2) is a wall, and not where the images end."""
        slack, lengths = ROUNDING * max(self.lengths), np.array(self.lengths)
        within = (place > self.lower - lengths + slack) & (place < self.upper + lengths - slack)
        return np.asarray((within | ~np.array(self.periodic)).all(axis=1))

    @abstractmethod
    def contains(self, position: Array) -> Mask:
        """Return which positions lie in the fluid or on its edge, once wrapped."""

    def wall_distance(self, position: Array) -> Array:
        """Return the distance (n_points,) [m] to the nearest wall, zero within one."""
        return np.maximum(self.distance_and_normal(position)[0], 0.0)

    @abstractmethod
    def distance_and_normal(self, position: Array) -> tuple[Array, Array]:
        """Return signed distances (n_points,) [m] from walls, and normals (n_points, 2).

        Distances are positive in the fluid and negative in the solid. Normals are unit vectors
        along which the signed distance grows, from the nearest wall into the fluid. Without walls
        distances are infinite and normals zero.
        """

    @abstractmethod
    def nearest_wall(self, position: Array) -> Indices:
        """Return the wall (n_points,) nearest to positions, an index of `wall_names`."""

    def on_wall(self, position: Array) -> Array:
        """Return the points of walls (n_points, 2) [m] that are nearest to positions."""
        distance, normal = self.distance_and_normal(position)
        return position - distance[:, None] * normal

    def arms(self, name: str, place: Array) -> Array:
        """Return how far places on a wall (n_points, 2) are from what it may turn about [m].

        That is the centroid of a solid, and the centre of the box for its sides.
        """
        return place - 0.5 * np.add(self.lower, self.upper)

    def circulation(self, name: str, velocity: Callable[[Array], Array]) -> float:
        """Return the integral of a wall's velocity along it, anticlockwise [m2/s].

        That of a straight side of the box is zero: it surrounds nothing.

        Parameters
        ----------
        velocity : (n_points, 2) [m/s] at places on walls (n_points, 2) [m].
        """
        return 0.0

    @abstractmethod
    def wall_search(self, particle_spacing: float) -> WallSearch:
        """Return what finds particles' distances from walls at every substep."""

    def sections(self, x: float) -> list[tuple[float, float]]:
        """Return the intervals [m] of the vertical line at x that are in the fluid, from below."""
        line = shapely.linestrings([(x, self.lower[1]), (x, self.upper[1])])
        slack = ROUNDING * max(self.lengths)
        spans: list[tuple[float, float]] = []
        parts = shapely.get_parts(shapely.intersection(line, self.fluid))
        heights = (shapely.get_coordinates(part)[:, 1] for part in parts[~shapely.is_empty(parts)])
        for low, high in sorted((y.min(), y.max()) for y in heights):
            middle = np.array([[x, 0.5 * (low + high)]])
            if high - low <= slack or self.wall_distance(middle)[0] <= slack:
                continue
            if spans and low <= spans[-1][1] + slack:
                low = spans.pop()[0]
            spans.append((float(low), float(high)))
        return spans

    def fluid_share(self, edges: Sequence[Array]) -> Array:
        """Return the share of fluid in the cells between edges along each axis, x first [m].

        Returns (n_rows, n_columns); zero where it is rounding.
        """
        x, y = edges
        cells = shapely.box(x[None, :-1], y[:-1, None], x[None, 1:], y[1:, None])
        shapely.prepare(self.fluid)
        share = shapely.area(shapely.intersection(cells, self.fluid)) / shapely.area(cells)
        share[share < ROUNDING] = 0.0
        return np.asarray(share)

    def fits_lattice(self, particle_spacing: float) -> bool:
        """Whether particles of a spacing [m] fill the domain without a rest, as packed ones do."""
        return True

    @abstractmethod
    def fill(self, particle_spacing: float) -> Array:
        """Return the points (n_particles, 2) [m] of a lattice that lie in the fluid."""

    def n_particles(self, particle_spacing: float) -> int:
        """Return how many particles have the fluid's area."""
        return round(self.area / particle_spacing**2)

    @abstractmethod
    def ghosts(self, particle_spacing: float, n_layers: int) -> Walls:
        """Return the points beyond the fluid's edge, within some layers of it, of walls at rest."""

    def n_ghosts(self, particle_spacing: float, n_layers: int) -> int:
        """Return how many ghosts there are."""
        return len(self.ghosts(particle_spacing, n_layers).position)

    def wrap(self, position: Array) -> Array:
        """Return positions moved into the box along its periodic axes."""
        wrapped = np.array(position, dtype=np.float64)
        for axis, (low, length) in enumerate(zip(self.lower, self.lengths, strict=True)):
            if self.periodic[axis]:
                inside = np.mod(wrapped[:, axis] - low, length)
                # np.mod of a tiny negative number rounds up to the length itself.
                inside[inside >= length] = 0.0
                wrapped[:, axis] = low + inside
        return wrapped
