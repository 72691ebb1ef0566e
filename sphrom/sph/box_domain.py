"""Domains with axis-parallel walls: a box, or the part of it that rectangles cover."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from sphrom.sph.domain import ROUNDING, Domain, GhostLayers, WallSearch

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

WHOLE_TOLERANCE = 1e-6
"""How far a wall may be from the lattice, over the particle spacing."""
SIDES = (("left", "right"), ("bottom", "top"))
"""Names of the walls at the lower and upper ends of each axis."""
INNER = "solid"
"""Name of the solid within the box."""


@dataclass(frozen=True)
class BoxDomain(Domain):
    """An axis-parallel box, periodic along the axes that say so; lengths in [m].

    Fluid fills the box, or the rectangles in it, which may share edges but not overlap. Where an
    axis isn't periodic, and where rectangles end, there are walls.
    """

    lower: tuple[float, float]
    upper: tuple[float, float]
    periodic: tuple[bool, bool]
    rectangles: tuple[Rectangle, ...] = ()

    @property
    def parts(self) -> tuple[Rectangle, ...]:
        """The rectangles that fluid fills."""
        return self.rectangles or (Rectangle(self.lower, self.upper),)

    @property
    def area(self) -> float:
        """The area that fluid fills [m2]."""
        return sum(part.area for part in self.parts)

    @property
    def fills_box(self) -> bool:
        """Whether fluid fills the whole box: no rectangles are given."""
        return not self.rectangles

    @property
    def wall_names(self) -> tuple[str, ...]:
        """The sides of the box that aren't periodic, then what is solid within the box."""
        sides = [
            name
            for names, periodic in zip(SIDES, self.periodic, strict=True)
            for name in names
            if not periodic
        ]
        return (*sides, INNER) if self.rectangles else tuple(sides)

    @property
    def narrowest_gap(self) -> float:
        """The least width of the rectangles that fluid fills [m]."""
        return min(part.upper[axis] - part.lower[axis] for part in self.parts for axis in range(2))

    @property
    def thinnest_solid(self) -> float:
        """The least width of the solid between fluid and fluid along an axis [m]."""
        return min(
            (
                solid.upper[axis] - solid.lower[axis]
                for axis in range(2)
                for solid in self._solids_along(axis)
                if self._has_fluid_at_both_ends(solid, axis)
            ),
            default=math.inf,
        )

    def _has_fluid_at_both_ends(self, solid: Rectangle, axis: int) -> bool:
        middle = 0.5 * np.add(solid.lower, solid.upper)
        beyond = np.array([middle, middle])
        slack = ROUNDING * max(self.lengths)
        beyond[:, axis] = solid.lower[axis] - slack, solid.upper[axis] + slack
        return bool(self.contains(beyond).all())

    def contains(self, position: Array) -> Mask:
        """Return which positions (n_points, 2) [m] lie in the fluid, once wrapped."""
        wrapped = self.wrap(position)
        inside = np.zeros(len(wrapped), dtype=np.bool_)
        for part in self.parts:
            inside |= part.contains(wrapped)
        return inside

    def wall_distance(self, position: Array) -> Array:
        """Return the distance (n_points,) [m] of positions (n_points, 2) [m] to a wall."""
        return nearest(self.wrap(position), self.solids)[0]

    def fluid_distance(self, position: Array) -> Array:
        """Return the distance (n_points,) [m] of positions (n_points, 2) [m] to the fluid."""
        return nearest(self.wrap(position), self._fluid_images())[0]

    def distance_and_normal(self, position: Array) -> tuple[Array, Array]:
        """Return signed distances from walls (n_points,) [m] and normals (n_points, 2)."""
        wrapped = self.wrap(position)
        fluid, from_wall = nearest(wrapped, self.solids)
        solid, to_fluid = nearest(wrapped, self._fluid_images())
        distance = np.where(solid > 0.0, -solid, fluid)
        # From the wall into the fluid, on either side of it.
        way = np.where((solid > 0.0)[:, None], to_fluid, -from_wall)
        length = np.hypot(*way.T)
        normal = np.divide(way, length[:, None], out=np.zeros_like(way), where=length[:, None] > 0)
        if (on_wall := (distance == 0.0)).any():
            normal[on_wall] = self._normals_on_walls(wrapped[on_wall])
        return distance, normal

    def _normals_on_walls(self, place: Array) -> Array:
        """Return the normals (n_points, 2) at points of walls: the mean one at a corner."""
        step = math.sqrt(ROUNDING) * min(self.lengths)
        turns = np.linspace(0.0, 2.0 * math.pi, 32, endpoint=False) + math.pi / 32
        around = np.stack((np.cos(turns), np.sin(turns)), axis=1)
        in_fluid = [self.contains(place + step * direction) for direction in around]
        way = np.array(in_fluid, dtype=float).T @ around
        return np.asarray(way / np.linalg.norm(way, axis=1, keepdims=True))

    def _fluid_images(self) -> list[Rectangle]:
        """Return the rectangles that fluid fills, with their images on either side of the box."""
        images = (
            (-n, 0.0, n) if p else (0.0,) for n, p in zip(self.lengths, self.periodic, strict=True)
        )
        shifts = itertools.product(*images)
        return [shifted(part, s) for part, s in itertools.product(self.parts, tuple(shifts))]

    @property
    def solids(self) -> list[Rectangle]:
        """Rectangles that cover the solid: all around the box, where an axis isn't periodic.

        Each is as long along x as it may be: where two met within a floor or a ceiling, or behind
        the corner of a box, the further one would look like a corner that juts into the fluid.
        """
        return self._solids_along(0)

    def _solids_along(self, axis: int) -> list[Rectangle]:
        """Return rectangles that cover the solid, each as long along an axis as it may be."""
        along, across = self._cuts(axis), self._cuts(1 - axis)
        middles = 0.5 * np.add(along[1:], along[:-1])
        found = []
        for low, high in itertools.pairwise(across):
            others = np.full_like(middles, 0.5 * (low + high))
            centres = np.stack((middles, others) if axis == 0 else (others, middles), axis=1)
            ends = np.flatnonzero(np.diff(np.pad(~self.contains(centres), 1))).reshape(-1, 2)
            for first, last in ends:
                corners = (along[first], low), (along[last], high)
                found.append(Rectangle(*(c if axis == 0 else c[::-1] for c in corners)))
        return found

    def _cuts(self, axis: int) -> list[float]:
        """Return where the fluid may end along an axis, images beside the box among them."""
        low, high, length = self.lower[axis], self.upper[axis], self.lengths[axis]
        edges = (edge[axis] for part in self.parts for edge in (part.lower, part.upper))
        # Along a periodic axis the nearest wall may be an image; else the box's edge is one.
        images = (-length, 0.0, length) if self.periodic[axis] else (0.0,)
        cuts = {bound + image for bound in (low, high, *edges) for image in images}
        return sorted(cuts | {low - length, high + length})

    def wall_search(self, particle_spacing: float) -> RectangleSearch:
        """Return what finds particles' distances from walls at every substep."""
        return RectangleSearch(np.array([(*s.lower, *s.upper) for s in self.solids]))

    def sections(self, x: float) -> list[tuple[float, float]]:
        """Return the intervals [m] of the vertical line at x that are in the fluid, from below."""
        slack = ROUNDING * max(self.lengths)
        spans: list[tuple[float, float]] = []
        for part in sorted(self.parts, key=lambda part: part.lower[1]):
            (left, low), (right, high) = part.lower, part.upper
            middle = np.array([[x, 0.5 * (low + high)]])
            if not left <= x <= right or self.wall_distance(middle)[0] <= slack:
                continue
            if spans and low <= spans[-1][1] + slack:
                below = spans.pop()
                low, high = below[0], max(below[1], high)
            spans.append((low, high))
        return spans

    def fluid_share(self, edges: Sequence[Array]) -> Array:
        """Return the share of fluid (n_rows, n_columns) in cells between edges along x and y."""
        share = np.zeros((len(edges[1]) - 1, len(edges[0]) - 1))
        for part in self.parts:
            along_x, along_y = (
                overlap(edges[axis], part.lower[axis], part.upper[axis]) for axis in range(2)
            )
            share += np.outer(along_y, along_x)
        share[share < ROUNDING] = 0.0
        return share

    def fits_lattice(self, particle_spacing: float) -> bool:
        """Whether all walls lie between the points of a lattice."""
        corners = (corner for part in self.parts for corner in (part.lower, part.upper))
        places = [
            (c[axis] - self.lower[axis]) / particle_spacing for c in corners for axis in range(2)
        ]
        return all(abs(place - round(place)) < WHOLE_TOLERANCE for place in places)

    def fill(self, particle_spacing: float) -> Array:
        """Return the cell centres (n_particles, 2) [m] of a square lattice, those in the fluid."""
        axes = [
            low + (np.arange(round(length / particle_spacing)) + 0.5) * particle_spacing
            for low, length in zip(self.lower, self.lengths, strict=True)
        ]
        x, y = np.meshgrid(*axes)
        points = np.stack((x.ravel(), y.ravel()), axis=1)
        return points[self.contains(points)] if self.has_walls else points

    def n_particles(self, particle_spacing: float) -> int:
        """Return how many points of the lattice lie in the fluid."""
        blocks = self._blocks(particle_spacing)
        return sum((right - left) * (up - low) for left, low, right, up in blocks)

    def ghosts(self, particle_spacing: float, n_layers: int) -> GhostLayers:
        """Return the lattice points (n_ghosts, 2) [m] within some layers of the fluid."""
        axes = [self._lattice_axis(axis, particle_spacing, n_layers) for axis in range(2)]
        x, y = np.meshgrid(*axes)
        position = np.stack((x.ravel(), y.ravel()), axis=1)
        fluid = self.contains(position).reshape(x.shape)
        beside, above = (self._dilated(fluid, axis, n_layers) for axis in range(2))
        ghost = (self._dilated(beside, 1, n_layers) & ~fluid).ravel()
        # A ghost behind a corner that faces no wall belongs to both walls that meet there.
        corner = ~(beside | above)
        axes_behind = np.stack(((beside | corner).ravel(), (above | corner).ravel()), axis=1)
        place = position[ghost]
        return GhostLayers(place, self.nearest_wall(place), axes_behind[ghost].astype(np.float64))

    def n_ghosts(self, particle_spacing: float, n_layers: int) -> int:
        """Return how many lattice points lie within some layers of the fluid."""
        if not self.has_walls:
            return 0
        across, up = (0 if periodic else n_layers for periodic in self.periodic)
        ends = block(self.lower, self.upper, particle_spacing)
        grown = [
            (
                max(left - n_layers, ends[0] - across),
                max(lower - n_layers, ends[1] - up),
                min(right + n_layers, ends[2] + across),
                min(upper + n_layers, ends[3] + up),
            )
            for left, lower, right, upper in self._blocks(particle_spacing)
        ]
        return covered(grown) - self.n_particles(particle_spacing)

    def nearest_wall(self, position: Array) -> Indices:
        """Return the wall (n_points,) nearest to positions in the solid; corners are the sides'."""
        names, place = self.wall_names, self.wrap(position)
        wall = np.full(len(place), len(names) - 1, dtype=np.int64)
        for axis in (1, 0):
            if not self.periodic[axis]:
                low, high = (names.index(name) for name in SIDES[axis])
                wall[place[:, axis] < self.lower[axis]] = low
                wall[place[:, axis] > self.upper[axis]] = high
        return wall

    def _blocks(self, particle_spacing: float) -> list[Block]:
        return [block(part.lower, part.upper, particle_spacing) for part in self.parts]

    def _lattice_axis(self, axis: int, spacing: float, n_layers: int) -> Array:
        extra = 0 if self.periodic[axis] else n_layers
        n_points = round(self.lengths[axis] / spacing) + 2 * extra
        points = np.arange(n_points, dtype=np.float64) + 0.5 - extra
        return self.lower[axis] + spacing * points

    def _dilated(self, mask: Mask, axis: int, n_layers: int) -> Mask:
        """Return where a mask (ny, nx) holds within some layers along an axis (0 is x)."""
        # Ghosts are counted before particles run, and seldom: loading it takes longer.
        from scipy import ndimage

        mode = "wrap" if self.periodic[axis] else "constant"
        return np.asarray(
            ndimage.maximum_filter1d(mask, 2 * n_layers + 1, axis=1 - axis, mode=mode, cval=0)
        )


@dataclass(frozen=True)
class RectangleSearch(WallSearch):
    """Distances from solid rectangles."""

    solids: Array
    """(n_solids, 4) lower and upper corners, x before y [m]."""

    @property
    def kernels(self) -> ModuleType:
        """Those of rectangles."""
        # Domains are known without compiled code.
        from sphrom.kernels import rectangles

        return rectangles

    @property
    def lists(self) -> tuple[Array]:
        """The rectangles."""
        return (self.solids,)


Block = tuple[int, int, int, int]
"""Left, lower, right and upper edges of a rectangle, in particle spacings."""


@dataclass(frozen=True)
class Rectangle:
    """An axis-parallel rectangle; lengths in [m]."""

    lower: tuple[float, float]
    upper: tuple[float, float]

    @property
    def area(self) -> float:
        """The rectangle's area [m2]."""
        return (self.upper[0] - self.lower[0]) * (self.upper[1] - self.lower[1])

    def contains(self, position: Array) -> NDArray[np.bool_]:
        """Return which positions (n_points, 2) [m] lie in it, its edges among them."""
        inside = (position >= self.lower) & (position <= self.upper)
        return np.asarray(inside.all(axis=1))


def nearest(position: Array, rectangles: Iterable[Rectangle]) -> tuple[Array, Array]:
    """Return distances (n_points,) to the nearest of some rectangles, and ways there (n, 2) [m]."""
    least = np.full(len(position), np.inf)
    way = np.zeros_like(position)
    for rectangle in rectangles:
        gaps = np.clip(position, rectangle.lower, rectangle.upper) - position
        distance = np.hypot(*gaps.T)
        way[distance < least] = gaps[distance < least]
        np.minimum(least, distance, out=least)
    return least, way


def shifted(rectangle: Rectangle, shift: Sequence[float]) -> Rectangle:
    """Return a rectangle moved by a shift (2,) [m]."""
    (left, low), (right, high) = rectangle.lower, rectangle.upper
    along, up = shift
    return Rectangle((left + along, low + up), (right + along, high + up))


def overlap(edges: Array, low: float, high: float) -> Array:
    """Return the share (n_cells,) of each interval between edges that [low, high] covers."""
    length = np.minimum(edges[1:], high) - np.maximum(edges[:-1], low)
    return np.asarray(np.maximum(length, 0.0) / np.diff(edges))


def block(lower: Sequence[float], upper: Sequence[float], spacing: float) -> Block:
    """Return the edges of a rectangle, rounded to particle spacings [m]."""
    left, low, right, up = (round(edge / spacing) for edge in (*lower, *upper))
    return left, low, right, up


def covered(blocks: list[Block]) -> int:
    """Return the area that blocks cover, whether they overlap or not."""
    columns = sorted({edge for b in blocks for edge in (b[0], b[2])})
    return sum(
        (right - left) * _length([(b[1], b[3]) for b in blocks if b[0] <= left and right <= b[2]])
        for left, right in itertools.pairwise(columns)
    )


def _length(intervals: list[tuple[int, int]]) -> int:
    """Return the length that intervals cover."""
    total, reached = 0, min((low for low, _ in intervals), default=0)
    for low, high in sorted(intervals):
        total += max(0, high - max(low, reached))
        reached = max(reached, high)
    return total
