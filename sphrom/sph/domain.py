"""The interface of all domains: the fluid's region, distances from walls, and initial points.

A domain lies in an axis-parallel box that is periodic along some axes. Walls are where fluid ends.
All lengths are in [m], and positions are (n_points, 2).
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
from sphrom.text import place_text

FINEST = 5e-5
"""Size of the finest features that count in the measurement of widths, relative to that of the
box."""
WHOLE_TOLERANCE = 1e-6
"""Largest distance of a wall from the lattice, relative to the particle spacing."""
SIDES = (("left", "right"), ("bottom", "top"), ("back", "front"))
"""Names of the walls at the lower and upper ends of each axis."""


@dataclass(frozen=True)
class Walls:
    """Ghost particles, fixed in the solid to a depth of some layers of particles."""

    position: Array
    """(n_ghosts, 2) [m]."""
    velocity: Array
    """(n_ghosts, 2), that of each ghost's wall [m/s]."""
    wall: Indices
    """(n_ghosts,), the wall of each ghost, an index of `Domain.wall_names`."""
    normal: Array | None
    """(n_ghosts, 2), 1 along the axes of the normals of the walls in front of a ghost, else 0; None
    if walls are not parallel to the axes."""

    def moving(self, wall_velocity: Callable[[Array], Array]) -> Walls:
        """Return them with wall velocities (n_ghosts, 2) [m/s] evaluated at the ghosts."""
        return replace(self, velocity=wall_velocity(self.position))


@dataclass(frozen=True)
class WallSearch:
    """Distances from walls at every substep; sources are laid out as in `sphrom.kernels.fields`."""

    kernels: Any
    """The compiled module for walls of this kind."""
    lists: tuple[Any, ...]
    """The walls in the form that these kernels take."""

    def distances(self, targets: Indices, source: Array) -> Array:
        """Return the distance (n_targets,) [m] of some sources from the nearest wall."""
        distance = np.empty(targets.size)
        self.kernels.wall_distances(targets, source, *self.lists, distance)
        return distance


def lattice_points(x: Array, y: Array) -> Array:
    """Return the points (n_points, 2) of a lattice with columns at x and rows at y, row by row."""
    return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def first_of(particles: Indices, position: Array) -> str:
    """Describe the first of some particles at positions (n_dim, n_particles) [m], in words."""
    place = place_text(position[:, particles[0]], ".6g")
    more = f" (one of {particles.size})" if particles.size > 1 else ""
    return f"particle {particles[0]} at {place} m{more}"


class Domain(ABC):
    """The part of a box that is filled with fluid."""

    lower: tuple[float, ...]
    """The box's lower corner [m]."""
    upper: tuple[float, ...]
    """The box's upper corner [m]."""
    periodic: tuple[bool, ...]
    """Whether the box is periodic, by axis."""

    @property
    def n_dim(self) -> int:
        """The number of axes."""
        return len(self.lower)

    @property
    def lengths(self) -> tuple[float, ...]:
        """The box's edges [m]."""
        return tuple(high - low for low, high in zip(self.lower, self.upper, strict=True))

    @property
    @abstractmethod
    def fluid(self) -> BaseGeometry:
        """The region of the fluid in the box."""

    @property
    @abstractmethod
    def fluid_with_images(self) -> BaseGeometry:
        """The fluid in the box and, along periodic axes, in its images on either side."""

    @property
    def area(self) -> float:
        """The area of the fluid [m2]."""
        return float(shapely.area(self.fluid))

    @property
    def separate_areas(self) -> list[float]:
        """The areas [m2] of disconnected parts of the fluid, the largest first."""
        return [self.area]

    @property
    def polygons(self) -> Sequence[tuple[str, BaseGeometry]]:
        """The solids of any shape [m], with their names; none if all follow the axes."""
        return ()

    @property
    @abstractmethod
    def solid_names(self) -> tuple[str, ...]:
        """The name of each solid in the box."""

    @property
    def wall_names(self) -> tuple[str, ...]:
        """The name of each wall: sides of the box that are not periodic, then solids."""
        sides = (names for names, p in zip(SIDES, self.periodic, strict=False) if not p)
        return (*(name for names in sides for name in names), *self.solid_names)

    @property
    def fills_box(self) -> bool:
        """Whether fluid fills the whole box."""
        return not self.solid_names

    @property
    def has_walls(self) -> bool:
        """Whether there are any walls."""
        return bool(self.wall_names)

    @property
    def narrowest_gap(self) -> float:
        """The least width of the fluid between walls, or the length of a period [m].

        `sphrom.sph.polygons` defines which pairs of walls count.
        """
        periods = (n for n, p in zip(self.lengths, self.periodic, strict=True) if p)
        return min((self._least_widths[0], *periods))

    @property
    def thinnest_solid(self) -> float:
        """The least width of a solid with fluid on both sides [m]; infinite if there is none."""
        return self._least_widths[1]

    @cached_property
    def _least_widths(self) -> tuple[float, float]:
        if self.fills_box:
            return min(self.lengths), math.inf
        # There may be thousands of finer corners.
        fluid = shapely.simplify(self.fluid_with_images, FINEST * max(self.lengths))
        return least_widths(fluid, self._is_wall, np.array(self.lower), np.array(self.upper))

    def _is_wall(self, place: Array) -> Mask:
        """Whether points (n_points, 2) of the outline are on a wall, not where the images end."""
        slack = ROUNDING * max(self.lengths)
        lengths = np.array(self.lengths)
        within = (place > self.lower - lengths + slack) & (place < self.upper + lengths - slack)
        return (within | ~np.array(self.periodic)).all(axis=1)

    @abstractmethod
    def contains(self, position: Array) -> Mask:
        """Return whether positions are in the fluid or on its edge, after wrapping."""

    def wall_distance(self, position: Array) -> Array:
        """Return the distance (n_points,) [m] to the nearest wall, zero inside one."""
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
        """Return the vectors (n_points, 2) [m] to places on a wall from its centre of rotation.

        This is the centroid of a solid, and the centre of the box for its sides.
        """
        return place - 0.5 * np.add(self.lower, self.upper)

    def circulation(self, name: str, velocity: Callable[[Array], Array]) -> float:
        """Return the integral of a wall's velocity along it, anticlockwise [m2/s].

        For a straight side of the box it is zero, because the side encloses nothing.

        Parameters
        ----------
        velocity : returns (n_points, 2) [m/s] at places on walls (n_points, 2) [m].
        """
        return 0.0

    @abstractmethod
    def wall_search(self, particle_spacing: float) -> WallSearch:
        """Return the search for particles' distances from walls, for use at every substep."""

    def sections(self, x: float) -> list[tuple[float, float]]:
        """Return the intervals [m] of the vertical line at x that are in the fluid, from below."""
        line = shapely.linestrings([(x, self.lower[1]), (x, self.upper[1])])
        slack = ROUNDING * max(self.lengths)
        parts = shapely.get_parts(shapely.intersection(line, self.fluid))
        parts = parts[shapely.length(parts) > slack]
        middles = shapely.line_interpolate_point(parts, 0.5, normalized=True)
        # A part that follows a wall is not in the fluid.
        inside = parts[self.wall_distance(shapely.get_coordinates(middles)) > slack]
        joined = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(inside)))
        return sorted((low, high) for _, low, _, high in shapely.bounds(joined).tolist())

    def fluid_share(self, edges: Sequence[Array]) -> Array:
        """Return the share of fluid (n_rows, n_columns) in cells between edges, x first [m].

        Shares that are only rounding are zero.
        """
        x, y = edges
        cells = shapely.box(x[None, :-1], y[:-1, None], x[None, 1:], y[1:, None])
        shapely.prepare(self.fluid)
        share = shapely.area(shapely.intersection(cells, self.fluid)) / shapely.area(cells)
        share[share < ROUNDING] = 0.0
        return share

    def fits_lattice(self, particle_spacing: float) -> bool:
        """Whether particles of a spacing [m] fill the domain exactly, as packed ones do."""
        return True

    def lattice_spacing(self, particle_spacing: float) -> float:
        """Return the spacing [m] of the lattice nearest to a wanted one."""
        return particle_spacing

    def pitches(self, particle_spacing: float) -> tuple[float, float]:
        """Return the distances of lattice points along x and y [m]."""
        return particle_spacing, particle_spacing

    def row_end(self, level: float, pitch: float) -> float:
        """Return the height [m] nearest to a level at which a row ends, or the level if one does.

        Rows begin at the floor, `pitch` apart [m].
        """
        rows = (level - self.lower[1]) / pitch
        nearest = max(1, round(rows))
        return level if abs(rows - nearest) <= WHOLE_TOLERANCE else self.lower[1] + nearest * pitch

    @abstractmethod
    def fill(self, particle_spacing: float) -> Array:
        """Return the points (n_particles, 2) [m] of a lattice that are in the fluid."""

    def n_particles(self, particle_spacing: float) -> int:
        """Return the number of particles with the area of the fluid."""
        return round(self.area / particle_spacing**2)

    def below(self, level: float) -> Domain:
        """Return the part whose particles fill it up to a height [m], by default the domain."""
        return self

    @abstractmethod
    def ghosts(self, particle_spacing: float, n_layers: int) -> Walls:
        """Return the ghosts of walls at rest: points within some layers of the fluid's edge."""

    def n_ghosts(self, particle_spacing: float, n_layers: int) -> int:
        """Return the number of ghosts."""
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
