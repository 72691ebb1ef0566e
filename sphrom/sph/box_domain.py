"""Domains with axis-parallel walls: a box, or the part of it that rectangles cover."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array, Indices, Mask
from sphrom.sph.domain import (
    ROUNDING,
    SIDES,
    WHOLE_TOLERANCE,
    Domain,
    Walls,
    WallSearch,
    lattice_points,
)
from sphrom.sph.polygons import periodic_shifts

MOST_UNEVEN = 5e-3
"""Largest difference of the spacings along x and y, over one: at 0.24 %, the pressure at rest, the
level and the frequency of a tank change by less than 1e-3 (`tests/pipeline/test_own_sides.py`)."""
INNER = "solid"
"""Name of the solid within the box."""


@dataclass(frozen=True)
class BoxDomain(Domain):
    """An axis-parallel box, periodic along some axes; lengths in [m].

    Fluid fills the box, or the rectangles in it, which may share edges but not overlap. There are
    walls at the ends of axes that are not periodic, and at the edges of rectangles.
    """

    lower: tuple[float, float]
    upper: tuple[float, float]
    periodic: tuple[bool, bool]
    rectangles: tuple[Rectangle, ...] = ()
    level: float | None = None
    """Height at which a row of particles ends, below the ceiling; None is the ceiling's [m]."""

    @property
    def parts(self) -> tuple[Rectangle, ...]:
        """The rectangles filled with fluid."""
        return self.rectangles or (Rectangle(self.lower, self.upper),)

    @property
    def area(self) -> float:
        """The area of the fluid [m2]."""
        return sum(part.area for part in self.parts)

    @cached_property
    def fluid(self) -> BaseGeometry:
        """The region of the fluid in the box."""
        return shapely.union_all([part.polygon for part in self.parts])

    @property
    def fluid_with_images(self) -> BaseGeometry:
        """The fluid in the box and, along periodic axes, in its images on either side."""
        return shapely.union_all([part.polygon for part in self._fluid_images()])

    @property
    def solid_names(self) -> tuple[str, ...]:
        """The solid inside the box has one name."""
        return (INNER,) if self.rectangles else ()

    def contains(self, position: Array) -> Mask:
        """Return whether positions (n_points, 2) [m] are in the fluid, after wrapping."""
        wrapped = self.wrap(position)
        inside = np.zeros(len(wrapped), dtype=np.bool_)
        for part in self.parts:
            inside |= part.contains(wrapped)
        return inside

    def distance_and_normal(self, position: Array) -> tuple[Array, Array]:
        """Return signed distances from walls (n_points,) [m] and normals (n_points, 2)."""
        wrapped = self.wrap(position)
        fluid, from_wall = nearest(wrapped, self.solids)
        solid, to_fluid = nearest(wrapped, self._fluid_images())
        distance = np.where(solid > 0.0, -solid, fluid)
        # From the wall into the fluid, on both sides of the wall.
        vector = np.where((solid > 0.0)[:, None], to_fluid, -from_wall)
        length = np.hypot(*vector.T)[:, None]
        normal = np.divide(vector, length, out=np.zeros_like(vector), where=length > 0)
        if (on_wall := (distance == 0.0)).any():
            normal[on_wall] = self._normals_on_walls(wrapped[on_wall])
        return distance, normal

    def _normals_on_walls(self, place: Array) -> Array:
        """Return the normals (n_points, 2) at points of walls; at a corner, the mean normal."""
        step = math.sqrt(ROUNDING) * min(self.lengths)
        turns = np.linspace(0.0, 2.0 * math.pi, 32, endpoint=False) + math.pi / 32
        directions = np.stack((np.cos(turns), np.sin(turns)), axis=1)
        in_fluid = [self.contains(place + step * direction) for direction in directions]
        vector = np.array(in_fluid, dtype=float).T @ directions
        return vector / np.linalg.norm(vector, axis=1, keepdims=True)

    def _fluid_images(self) -> list[Rectangle]:
        """Return the rectangles of the fluid, with their images on either side of the box."""
        shifts = periodic_shifts(self.lengths, self.periodic)
        return [part.shifted(*shift) for part, shift in itertools.product(self.parts, shifts)]

    @property
    def solids(self) -> list[Rectangle]:
        """Rectangles that cover the solid, also around the box where an axis is not periodic.

        Each is as long as possible along x. If two met within a floor or a ceiling, or behind the
        corner of a box, the farther one would look like a corner that juts into the fluid.
        """
        x = self._cuts(0)
        middles = 0.5 * np.add(x[1:], x[:-1])
        solids = []
        for low, high in itertools.pairwise(self._cuts(1)):
            centres = np.stack((middles, np.full_like(middles, 0.5 * (low + high))), axis=1)
            ends = np.flatnonzero(np.diff(np.pad(~self.contains(centres), 1))).reshape(-1, 2)
            solids += [Rectangle((x[first], low), (x[last], high)) for first, last in ends]
        return solids

    def _cuts(self, axis: int) -> list[float]:
        """Return the coordinates at which fluid may end along an axis, including images."""
        low, high, length = self.lower[axis], self.upper[axis], self.lengths[axis]
        edges = (edge[axis] for part in self.parts for edge in (part.lower, part.upper))
        # Along a periodic axis the nearest wall may be an image; else the box's edge is a wall.
        images = (-length, 0.0, length) if self.periodic[axis] else (0.0,)
        cuts = {bound + image for bound in (low, high, *edges) for image in images}
        return sorted(cuts | {low - length, high + length})

    def wall_search(self, particle_spacing: float) -> WallSearch:
        """Return the search for particles' distances from walls, for use at every substep."""
        # Domains work without compiled code otherwise.
        from sphrom.kernels import rectangles

        return WallSearch(rectangles, (np.array([(*s.lower, *s.upper) for s in self.solids]),))

    def fits_lattice(self, particle_spacing: float) -> bool:
        """Whether all walls lie between the points of a lattice whose pitches hardly differ."""
        if self.rectangles:
            corners = (corner for part in self.rectangles for corner in (part.lower, part.upper))
            places = np.subtract([*corners], self.lower) / particle_spacing
            return bool(np.all(np.abs(places - np.rint(places)) < WHOLE_TOLERANCE))
        x, y = self.pitches(self.lattice_spacing(particle_spacing))
        return abs(x / y - 1.0) <= MOST_UNEVEN

    @property
    def _filled(self) -> Array:
        """The lengths (2,) [m] that whole numbers of particles fill."""
        top = self.upper[1] if self.level is None else self.level
        return np.array((self.lengths[0], top - self.lower[1]))

    def lattice_spacing(self, particle_spacing: float) -> float:
        """Return the square root of the area per point [m] on the lattice nearest to a spacing."""
        if self._keeps(particle_spacing):
            return particle_spacing
        counts = np.maximum(1.0, np.rint(self._filled / particle_spacing))
        return math.sqrt(float(np.prod(self._filled / counts)))

    def _keeps(self, particle_spacing: float) -> bool:
        """Return whether lattice points are a spacing [m] apart along both axes."""
        number = self._filled / particle_spacing
        return bool(self.rectangles) or np.allclose(number, np.rint(number), 0.0, WHOLE_TOLERANCE)

    def pitches(self, particle_spacing: float) -> tuple[float, float]:
        """Return the distances of lattice points along x and y [m]; their product is its square."""
        if self._keeps(particle_spacing):
            return particle_spacing, particle_spacing
        number = self._filled / particle_spacing
        # Rounded by itself, the number along the longer side could miss by one or more.
        short = int(np.argmin(number))
        counts = np.rint(number)
        counts[1 - short] = round(np.prod(number) / max(1.0, counts[short]))
        x, y = self._filled / np.maximum(1.0, counts)
        return float(x), float(y)

    def fill(self, particle_spacing: float) -> Array:
        """Return the cell centres (n_particles, 2) [m] of a lattice in the fluid."""
        points = lattice_points(*self._axes(particle_spacing, 0))
        return points[self.contains(points)] if self.has_walls else points

    def ghosts(self, particle_spacing: float, n_layers: int) -> Walls:
        """Return the lattice points (n_ghosts, 2) [m] within some layers outside the fluid."""
        x, y = self._axes(particle_spacing, n_layers)
        position = lattice_points(x, y)
        fluid = self.contains(position).reshape(y.size, x.size)
        beside, above = (self._dilated(fluid, axis, n_layers) for axis in range(2))
        ghost = (self._dilated(beside, 1, n_layers) & ~fluid).ravel()
        # A ghost diagonally behind a corner belongs to both walls that meet there.
        corner = ~(beside | above)
        axes_behind = np.stack(((beside | corner).ravel(), (above | corner).ravel()), axis=1)
        place = position[ghost]
        normal = axes_behind[ghost].astype(np.float64)
        return Walls(place, np.zeros_like(place), self.nearest_wall(place), normal)

    def n_ghosts(self, particle_spacing: float, n_layers: int) -> int:
        """Return the number of lattice points outside the fluid, within some layers of it."""
        if not self.rectangles:
            inner, outer = (self._axes(particle_spacing, n) for n in (0, n_layers))
            return math.prod(map(len, outer)) - math.prod(map(len, inner))
        depth = n_layers * particle_spacing
        beyond = np.where(self.periodic, 0.0, depth)
        frame = shapely.box(*np.subtract(self.lower, beyond), *np.add(self.upper, beyond))
        grown = shapely.buffer(self.fluid_with_images, depth, join_style="mitre")
        area = shapely.area(shapely.intersection(grown, frame)) - self.area
        return round(float(area) / particle_spacing**2)

    def nearest_wall(self, position: Array) -> Indices:
        """Return the wall (n_points,) nearest to positions in the solid; sides own the corners."""
        names = self.wall_names
        place = self.wrap(position)
        wall = np.full(len(place), len(names) - 1, dtype=np.int64)
        for axis in (1, 0):
            if not self.periodic[axis]:
                low, high = (names.index(name) for name in SIDES[axis])
                wall[place[:, axis] < self.lower[axis]] = low
                wall[place[:, axis] > self.upper[axis]] = high
        return wall

    def _axes(self, spacing: float, n_layers: int) -> list[Array]:
        """Return x (n_columns,) and y (n_rows,) [m] of a lattice with some layers beyond walls."""
        axes = []
        for axis, pitch in enumerate(self.pitches(spacing)):
            extra = 0 if self.periodic[axis] else n_layers
            number = self.lengths[axis] / pitch
            places = np.arange(round(number) + 2 * extra) + 0.5 - extra
            if abs(rest := number - round(number)) > WHOLE_TOLERANCE and extra:
                places[-extra:] += rest  # rows end at a level, and ghosts begin at the ceiling
            axes.append(np.asarray(self.lower[axis] + pitch * places, dtype=np.float64))
        return axes

    def _dilated(self, mask: Mask, axis: int, n_layers: int) -> Mask:
        """Return a mask (ny, nx) dilated by some layers along an axis (0 is x)."""
        # Ghosts are counted rarely, and importing this module takes longer than the count.
        from scipy import ndimage

        mode = "wrap" if self.periodic[axis] else "constant"
        size = 2 * n_layers + 1
        return ndimage.maximum_filter1d(mask, size, axis=1 - axis, mode=mode, cval=0)


@dataclass(frozen=True)
class Rectangle:
    """An axis-parallel rectangle; lengths in [m]."""

    lower: tuple[float, float]
    upper: tuple[float, float]

    @property
    def area(self) -> float:
        """The rectangle's area [m2]."""
        return (self.upper[0] - self.lower[0]) * (self.upper[1] - self.lower[1])

    @property
    def polygon(self) -> BaseGeometry:
        """The rectangle as a polygon."""
        return shapely.box(*self.lower, *self.upper)

    def shifted(self, x: float, y: float) -> Rectangle:
        """Return the rectangle moved along both axes [m]."""
        left, low = self.lower
        right, high = self.upper
        return Rectangle((left + x, low + y), (right + x, high + y))

    def contains(self, position: Array) -> Mask:
        """Return whether positions (n_points, 2) [m] are in it or on its edges."""
        return np.all((position >= self.lower) & (position <= self.upper), axis=1)


def nearest(position: Array, rectangles: Iterable[Rectangle]) -> tuple[Array, Array]:
    """Return distances (n_points,) and vectors (n_points, 2) to the nearest rectangle [m]."""
    least = np.full(len(position), np.inf)
    vector = np.zeros_like(position)
    for rectangle in rectangles:
        gaps = np.clip(position, rectangle.lower, rectangle.upper) - position
        distance = np.hypot(*gaps.T)
        vector[distance < least] = gaps[distance < least]
        np.minimum(least, distance, out=least)
    return least, vector
