"""Domains with walls of any shape: a box, periodic along some axes, minus named solids.

Solids are polygons; round shapes are polygons with many corners. Fluid is the rest of the box. Its
outline is stored as straight segments, together with those of the solids' periodic images, so that
the time loop evaluates no polygons (`sphrom.kernels.segments`).

Particles start on a lattice, chosen from several shifted ones to fit the walls best. Ghosts are
arranged in rows that follow the fluid's outline at depths of 0.5, 1.5, ... spacings. Each row has a
ghost in each of its corners and is divided evenly between them, so that fluid that slides along a
wall sees the same ghosts everywhere. Ghosts packed without such order make a rough wall: fluid
beside a rotating wall then has an error of 1.4 % of the wall's speed (50 particles across, mostly
in the normal component), compared with 0.2 % beside rows.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.affinity import translate
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array, Indices, Mask
from sphrom.kernels import segments as segment_sweeps
from sphrom.kernels.cells import Grid
from sphrom.sph.domain import ROUNDING, SIDES, Domain, Walls, WallSearch, lattice_points
from sphrom.sph.packing import NEAREST, off_walls
from sphrom.sph.polygons import (
    CORNER,
    digest,
    edges_of,
    joined_areas,
    left_turn,
    outline_of,
    periodic_shifts,
    require_few_crossings,
)

PRECISION = 1e-10
"""Accuracy of corners, relative to the size of the box; finer differences are rounding."""
LEAST = 1e-7
"""The least size of a solid, relative to that of the box."""
N_CELLS = 128
"""Largest number of cells along the box's longer edge, for the lists of segments."""
MARGIN = 8.0
"""Distance that cells extend beyond the box, in cells."""
LISTED = 2.0
"""Distance, in spacings, within which all walls are listed; shifting needs those within 1.5."""
MOST_JOINED = 500
"""Largest number of solids, with periodic images, that are joined into one outline at once."""
LONGEST = 100.0
"""Largest length of all walls, over the box's longer edge; it determines the time of checks."""
TINY = 1e-6
"""Bends of a row that are smaller than this share of the spacing are rounding."""
MITRE_LIMIT = 1.5
"""Limit of mitres: rows around corners are sharp up to about a right angle."""


@dataclass(frozen=True, eq=False, repr=False)
class PolygonDomain(Domain):
    """A box, periodic along some axes, minus solids.

    Along periodic axes solids repeat, and may cross the edge. Sides of the box that are not
    periodic are walls too.

    Parameters
    ----------
    solids : names with their polygons, which may touch but not overlap [m].

    Raises ValueError if a name is that of a side or used twice; if a solid is empty, an invalid
    polygon or outside the box; if two overlap, outlines cross too often, no fluid is left, or walls
    are too long.
    """

    lower: tuple[float, float]
    upper: tuple[float, float]
    periodic: tuple[bool, bool]
    solids: tuple[tuple[str, BaseGeometry], ...]

    def __post_init__(self) -> None:
        sides = {name for names in SIDES[:2] for name in names}
        seen: dict[str, BaseGeometry] = {}
        box = shapely.box(*self.lower, *self.upper)
        shifts = periodic_shifts(self.lengths, self.periodic)
        require_few_crossings(translate(s, *shift) for _, s in self.solids for shift in shifts)
        for name, solid in self.solids:
            shape = shapely.intersection(self._with_images(solid), box)
            if name in sides or name in seen:
                raise ValueError(f"solid {name}: the name is taken")
            if shape.is_empty:
                raise ValueError(f"solid {name}: no part of it is in the box")
            if max(np.ptp(np.reshape(shape.bounds, (2, 2)), axis=0)) < LEAST * max(self.lengths):
                raise ValueError(f"solid {name}: it is too small for the size of the box")
            for other, theirs in seen.items():
                shared = shapely.area(shapely.intersection(shape, theirs))
                if shared > ROUNDING * math.prod(self.lengths):
                    raise ValueError(f"solids {other} and {name} overlap by {shared:.3g} m2")
            seen[name] = shape
        if self.area <= ROUNDING * math.prod(self.lengths):
            raise ValueError("the solids leave nothing for the fluid")
        if (length := shapely.length(self.fluid)) > LONGEST * max(self.lengths):
            raise ValueError(
                f"walls are {length:.3g} m long, more than {LONGEST:g} times the box's longer "
                "edge, so particles can't resolve them; simplify their outlines"
            )

    def __repr__(self) -> str:
        shapes = ", ".join(f"{name}: {digest(shape)}" for name, shape in self.solids)
        return f"PolygonDomain({self.lower}, {self.upper}, {self.periodic}, {{{shapes}}})"

    @cached_property
    def fluid(self) -> BaseGeometry:
        """The region of the fluid in the box."""
        return shapely.intersection(self.fluid_with_images, shapely.box(*self.lower, *self.upper))

    @cached_property
    def separate_areas(self) -> list[float]:
        """The areas [m2] of the parts into which solids divide the fluid, the largest first."""
        areas = joined_areas(self.fluid, self.lengths, self.periodic)
        kept = areas[areas > ROUNDING * math.prod(self.lengths)]
        return sorted(kept.tolist(), reverse=True)

    @property
    def solid_names(self) -> tuple[str, ...]:
        """The name of each solid."""
        return tuple(name for name, _ in self.solids)

    def _with_images(self, shape: BaseGeometry, number: int = 1) -> BaseGeometry:
        """Return a shape with its periodic images, up to `number` boxes away on either side."""
        shifts = periodic_shifts(self.lengths, self.periodic, number)
        return shapely.union_all([translate(shape, *shift) for shift in shifts])

    @cached_property
    def fluid_with_images(self) -> BaseGeometry:
        """The fluid in the box and, along periodic axes, in its images on either side."""
        reach = np.where(self.periodic, self.lengths, 0.0)
        frame = shapely.box(*np.subtract(self.lower, reach), *np.add(self.upper, reach))
        # Where images overlap or solids touch, rounding would leave slivers and tiny edges with
        # arbitrary directions.
        step = 10.0 ** math.floor(math.log10(PRECISION * max(self.lengths)))
        parts = shapely.get_parts(self._images)
        alone = parts[:0]
        if len(parts) > MOST_JOINED:
            # Joining many takes long, so solids that touch no other are not joined.
            parts = parts[shapely.intersects(shapely.box(*shapely.bounds(parts).T), frame)]
            one, other = shapely.STRtree(parts).query(parts, "dwithin", distance=4.0 * step)
            touches = np.isin(np.arange(len(parts)), one[one != other])
            alone, parts = parts[~touches], parts[touches]
        joined = shapely.get_parts(shapely.union_all(parts, grid_size=step))
        solid = shapely.multipolygons(np.concatenate((alone, joined)))
        return shapely.simplify(shapely.difference(frame, solid, grid_size=step), 4.0 * step)

    @cached_property
    def _images(self) -> list[BaseGeometry]:
        """The solids, each with its periodic images up to two boxes away."""
        return [self._with_images(shape, 2) for _, shape in self.solids]

    @cached_property
    def outline(self) -> WallSearch:
        """The walls, listed by cells of the box."""
        return self.wall_search(0.0)

    def wall_search(self, particle_spacing: float) -> WallSearch:
        """Return the search for particles' distances from walls, for use at every substep."""
        width = max(particle_spacing, max(self.lengths) / N_CELLS)
        lower = np.subtract(self.lower, MARGIN * width)
        upper = np.add(self.upper, MARGIN * width)
        return list_by_cell(self._segments[0], lower, upper, width, LISTED * particle_spacing)

    @cached_property
    def _segments(self) -> tuple[Array, Indices]:
        """The segments (n_segments, 6) of all walls, and the wall of each."""
        before, start, end, _ = outline_of(self.fluid_with_images)
        segments = np.hstack((start, end, before))
        wall = self._walls_of(0.5 * (start + end))
        return np.ascontiguousarray(segments[wall >= 0]), wall[wall >= 0]

    def _walls_of(self, place: Array) -> Indices:
        """Return the wall of each point of the outline; -1 where the images end."""
        edges = [*self._sides(), *(np.stack(edges_of([s]), axis=1) for s in self._images)]
        if not edges:
            return np.full(len(place), -1)
        owner = np.repeat(np.arange(len(edges)), [len(ends) for ends in edges])
        tree = shapely.STRtree(shapely.linestrings(np.concatenate(edges)))
        (which, nearest), distance = tree.query_nearest(shapely.points(place), return_distance=True)
        on_wall = distance <= math.sqrt(ROUNDING) * max(self.lengths)
        # Of equally near walls, sides come first, then solids in their order.
        wall = np.full(len(place), len(edges))
        np.minimum.at(wall, which[on_wall], owner[nearest[on_wall]])
        wall[wall == len(edges)] = -1
        return wall

    def _sides(self) -> Iterator[Array]:
        """Yield the ends (1, 2, 2) [m] of each side that is a wall, along all images of the box."""
        ends = np.array([self.lower, self.upper])
        for axis in np.flatnonzero(np.logical_not(self.periodic)):
            for end in ends:
                line = ends + np.array([[-1.0], [1.0]]) * self.lengths
                line[:, axis] = end[axis]
                yield line[None]

    @property
    def polygons(self) -> Sequence[tuple[str, BaseGeometry]]:
        """The solids with their names."""
        return self.solids

    def contains(self, position: Array) -> Mask:
        """Return whether positions (n_points, 2) [m] are in the fluid or on its edge."""
        return self.distance_and_normal(position)[0] >= -ROUNDING * max(self.lengths)

    def distance_and_normal(self, position: Array) -> tuple[Array, Array]:
        """Return signed distances from walls (n_points,) [m] and normals (n_points, 2)."""
        return self._nearest(position)[:2]

    def nearest_wall(self, position: Array) -> Indices:
        """Return the wall (n_points,) nearest to positions (n_points, 2) [m]."""
        return self._segments[1][self._nearest(position)[2]]

    def arms(self, name: str, place: Array) -> Array:
        """Return the vectors (n_points, 2) [m] from the centroid of a solid to places.

        Of the periodic images of a place, the one nearest to the solid counts.
        """
        shape = dict(self.solids).get(name)
        if shape is None:
            return super().arms(name, place)
        images = place + np.array(periodic_shifts(self.lengths, self.periodic))[:, None]
        nearest = np.argmin(shapely.distance(shape, shapely.points(images)), axis=0)
        image = images[nearest, np.arange(len(place))]
        return image - shapely.get_coordinates(shapely.centroid(shape))[0]

    def circulation(self, name: str, velocity: Callable[[Array], Array]) -> float:
        """Return the integral of a solid's velocity along its edge, anticlockwise [m2/s]."""
        if name not in dict(self.solids):
            return super().circulation(name, velocity)
        segments, wall = self._segments
        middle = 0.5 * (segments[:, :2] + segments[:, 2:4])
        inside = np.all((middle >= self.lower) & (middle < self.upper), axis=1)
        of_solid = inside & (wall == self.wall_names.index(name))
        # Segments have the fluid on their left, and the enclosed solid on their right.
        steps = segments[of_solid, 2:4] - segments[of_solid, :2]
        return -float(np.sum(velocity(middle[of_solid]) * steps))

    def _nearest(self, position: Array) -> tuple[Array, Array, Indices]:
        n_points = len(position)
        if not self.has_walls:
            return np.full(n_points, np.inf), np.zeros((n_points, 2)), np.full(n_points, -1)
        return nearest_segments(self.wrap(position), self.outline)

    def fill(self, particle_spacing: float) -> Array:
        """Return the right number of points (n_particles, 2) [m] to fill the fluid.

        They are the points of a lattice that are deepest in the fluid, moved away from walls.
        """
        number = self.n_particles(particle_spacing)
        points, distance = fitted_lattice(self, particle_spacing, number)
        # Points of equal depth, up to rounding, are chosen in their order.
        depth = np.rint(distance / (math.sqrt(ROUNDING) * particle_spacing))
        deepest = np.argsort(-depth, kind="stable")[:number]
        return off_walls(points[np.sort(deepest)], self, NEAREST * particle_spacing)

    def below(self, level: float) -> PolygonDomain:
        """Return the part of the domain under a ceiling at a height [m]."""
        lower = self.lower
        upper = (self.upper[0], level)
        box = shapely.box(*lower, *upper)
        least = LEAST * max(self.lengths)
        inside = {name: shapely.intersection(self._with_images(s), box) for name, s in self.solids}
        kept = {name for name, part in inside.items() if part.area > least**2}
        return replace(self, upper=upper, solids=tuple(s for s in self.solids if s[0] in kept))

    def ghosts(self, particle_spacing: float, n_layers: int) -> Walls:
        """Return points (n_ghosts, 2) [m] in rows behind walls."""
        beyond = np.where(self.periodic, 0.0, 2.0 * n_layers * particle_spacing)
        frame = shapely.box(*np.subtract(self.lower, beyond), *np.add(self.upper, beyond))
        position = ghost_rows(self.fluid_with_images, frame, particle_spacing, n_layers)
        return Walls(position, np.zeros_like(position), self.nearest_wall(position), None)


def list_by_cell(
    segments: Array, lower: Array, upper: Array, cell_width: float, reach: float
) -> WallSearch:
    """Return walls with lists of the relevant segments in each cell of a grid over a box.

    A cell's list contains the segments that are nearest to any point in it, and all within a reach.

    Parameters
    ----------
    segments : (n_segments, 6), laid out as in `sphrom.kernels.segments` [m].
    lower, upper : the box's corners (2,) [m].
    cell_width, reach : width of cells, and distance within which all segments are listed [m].
    """
    n_columns, n_rows = np.ceil((upper - lower) / cell_width).astype(int).tolist()
    grid = Grid(float(lower[0]), float(lower[1]), cell_width, cell_width, n_columns, n_rows)
    row, column = np.divmod(np.arange(n_columns * n_rows), n_columns)
    centres = shapely.points(lower + cell_width * (np.stack((column, row), axis=1) + 0.5))
    tree = shapely.STRtree(shapely.linestrings(segments[:, :4].reshape(-1, 2, 2)))
    _, nearest = tree.query_nearest(centres, all_matches=False, return_distance=True)
    radius = math.sqrt(0.5) * cell_width
    limit = np.maximum(nearest + 2.0 * radius, reach + radius) * (1.0 + ROUNDING)
    cell, listed = tree.query(centres, predicate="dwithin", distance=limit)
    order = np.lexsort((listed, cell))
    start = np.searchsorted(cell[order], np.arange(len(centres) + 1))
    return WallSearch(segment_sweeps, (segments, listed[order], start, grid))


def nearest_segments(position: Array, walls: WallSearch) -> tuple[Array, Array, Indices]:
    """Return signed distances (n_points,) [m], normals (n_points, 2) and nearest segments."""
    place = np.ascontiguousarray(position.T)
    out = np.empty((3, len(position)))
    nearest = np.empty(len(position), np.int64)
    walls.kernels.signed_distances(place, *walls.lists, out, nearest)
    return out[0], np.ascontiguousarray(out[1:].T), nearest


def ghost_rows(fluid: BaseGeometry, frame: BaseGeometry, spacing: float, n_layers: int) -> Array:
    """Return points (n_ghosts, 2) [m] in rows behind the outline of the fluid.

    Parameters
    ----------
    fluid : with its images, as far as rows extend beyond the frame.
    frame : the part of the plane in which ghosts are needed: one period of the fluid.
    """
    found = [np.empty((0, 2))]
    lower, upper = np.reshape(shapely.bounds(frame), (2, 2))
    for layer in range(n_layers):
        depth = (layer + 0.5) * spacing
        grown = shapely.buffer(fluid, depth, join_style="mitre", mitre_limit=MITRE_LIMIT)
        grown = shapely.simplify(grown, TINY * spacing)
        for ring in shapely.get_rings(shapely.get_parts(grown)):
            place = shapely.get_coordinates(ring)[:-1]
            along = np.roll(place, -1, axis=0) - place
            turn = left_turn(np.roll(along, 1, axis=0), along)
            corners = np.flatnonzero(np.abs(turn) > CORNER)
            # The frame's lower edges belong to it.
            inside = np.all((place >= lower) & (place < upper), axis=1)
            found.append(place[corners][inside[corners]])
            for stretch in _stretches(place, corners):
                found += [_divided(part, place[corners], spacing) for part in _cut(stretch, frame)]
    return np.concatenate(found)


def _stretches(place: Array, corners: NDArray[np.int64]) -> Iterator[BaseGeometry]:
    """Yield the lines between the corners of a closed line through points (n_points, 2)."""
    if not corners.size:
        yield shapely.linestrings(np.concatenate((place, place[:1])))
    for first, last in zip(corners, np.roll(corners, -1), strict=True):
        steps = (last - first) % len(place) or len(place)
        yield shapely.linestrings(place[(first + np.arange(steps + 1)) % len(place)])


def _cut(line: BaseGeometry, frame: BaseGeometry) -> NDArray[np.object_]:
    """Return the parts of a line within a frame."""
    within = shapely.intersection(line, frame)
    parts = shapely.get_parts(
        shapely.line_merge(within) if isinstance(within, shapely.MultiLineString) else within
    )
    return parts[shapely.length(parts) > 0.0]


def _divided(line: BaseGeometry, corners: Array, spacing: float) -> Array:
    """Return points (n_points, 2) that divide a line evenly, about a spacing apart.

    They are a whole step from an end that is a corner, because there is another point, and half a
    step from an end where the frame cuts the line, or where a closed line begins.
    """
    ends = shapely.get_coordinates(line)[[0, -1]]
    gaps = np.where((ends[:, None] == corners).all(axis=2).any(axis=1), 1.0, 0.5)
    length = float(shapely.length(line))
    number = round(length / spacing - gaps.sum()) + 1
    if number < 1:
        return np.empty((0, 2))
    places = (np.arange(number) + gaps[0]) * (length / (number - 1 + gaps.sum()))
    return shapely.get_coordinates(shapely.line_interpolate_point(line, places))


N_SHIFTS = 64
"""Number of candidate shifts."""
SHIFT = np.array((0.7548776662466927, 0.5698402909980532))
"""Difference of successive shifts, relative to the pitch; its multiples fill a square evenly."""


def pitches(domain: Domain, particle_spacing: float) -> tuple[float, float]:
    """Return the distances of points along x and y [m], whose product is the spacing's square.

    Along periodic axes they divide the period; if both axes are periodic, the product is only
    approximately the square.
    """
    counts = [
        _divisors(length, particle_spacing) if periodic else [None]
        for length, periodic in zip(domain.lengths, domain.periodic, strict=True)
    ]
    square = particle_spacing**2

    def completed(x: float | None, y: float | None) -> tuple[float, float]:
        x = (particle_spacing if y is None else square / y) if x is None else x
        return x, square / x if y is None else y

    pairs = [completed(x, y) for x, y in itertools.product(*counts)]
    return min(pairs, key=lambda p: abs(p[0] * p[1] / square - 1.0) + (p[0] / p[1] - 1.0) ** 2)


def _divisors(length: float, spacing: float) -> list[float]:
    """Return fractions of a period near the spacing [m], the nearest one first."""
    nearest = max(1, round(length / spacing))
    return [length / n for n in (nearest, nearest - 1, nearest + 1) if n > 0]


def fitted_lattice(
    domain: Domain, particle_spacing: float, n_particles: int
) -> tuple[Array, Array]:
    """Return points (n_points, 2) [m], and their signed distances from walls (n_points,) [m].

    They cover the box. The shift is the first with exactly `n_particles` points in the fluid, or
    else the one with the nearest number.
    """
    best = (np.empty((0, 2)), np.empty(0))
    least = math.inf
    for turn in range(N_SHIFTS):
        points = _shifted(domain, particle_spacing, np.mod(0.5 + turn * SHIFT, 1.0))
        distance = domain.distance_and_normal(points)[0]
        missed = abs(int(np.count_nonzero(distance > 0.0)) - n_particles)
        if missed < least:
            best, least = (points, distance), missed
        if missed == 0:
            break
    return best


def _shifted(domain: Domain, particle_spacing: float, shift: Array) -> Array:
    axes = []
    for axis, pitch in enumerate(pitches(domain, particle_spacing)):
        number = domain.lengths[axis] / pitch
        last = round(number) if domain.periodic[axis] else math.ceil(number - shift[axis])
        axes.append(domain.lower[axis] + (np.arange(last) + shift[axis]) * pitch)
    x, y = axes
    return lattice_points(x, y)
