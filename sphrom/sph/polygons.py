"""Polygons in a box that is periodic along some axes: their connections and least widths.

Two walls face each other if a circle touches them at two opposite points and contains no other
wall: in a channel, on either side of a plate, or between a corner and a wall. The diameter is the
width. At a corner the width between its two sides vanishes for any resolution, and does not count.
Three more widths count: the end of a slot or plate with nearly parallel sides, the mouth between
straight sides that meet at a sharp corner, and the largest circle within a solid.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Callable, Iterable

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.affinity import translate
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array, Indices, Mask

Lengths = tuple[float, ...]
"""Lengths of the box along x and y [m]."""
Periodic = tuple[bool, ...]

ROUNDING = 1e-9
"""Tolerance for equal lengths up to rounding, relative to the size of the box."""
MOST_CROSSINGS = 1e5
"""Largest number of crossings between combined shapes; this many take a second."""
N_EDGES = 50
"""Number of edges whose crossings are counted."""
N_CORNERS = 256
"""Number of corners of a circle's polygon; its error is 4e-5 of the radius."""
FACING = math.radians(20.0)
"""Largest angle between sides that face each other."""
LEAST_TURN = math.radians(45.0)
"""Smallest turn from a side to the end of a slot or plate."""
TOUCHING = math.radians(2.0)
"""Sides that meet at a smaller angle touch each other."""
CORNER = math.radians(20.0)
SHARPEST = math.radians(120.0)
"""The smallest turn of an outline at a corner, and the largest that counts."""
N_PLACES = 64
"""Least number of places, per longer edge of the box, from which facing walls are searched."""
SLACK = 1e-7
"""Smaller cosines are zero, and so are smaller lengths over the size of the box."""
SHARE_NEAR = 4.0
"""Share of edges within reach of a corner, times the size of the outline over the reach."""
N_PAIRS = 500_000
"""Number of pairs of a place and an edge that are evaluated at once."""


def disc(centre: tuple[float, float], radius: float) -> BaseGeometry:
    """Return a circle as a polygon of the same area."""
    turns = np.linspace(0.0, 2.0 * math.pi, N_CORNERS, endpoint=False)
    step = 2.0 * math.pi / N_CORNERS
    corner = radius * math.sqrt(step / math.sin(step))
    directions = np.stack((np.cos(turns), np.sin(turns)), axis=1)
    return shapely.Polygon(np.array(centre) + corner * directions)


def digest(shape: BaseGeometry) -> str:
    """Return a digest of a shape that depends on its last bit."""
    return hashlib.sha256(shapely.to_wkb(shape)).hexdigest()[:16]


def edges_of(shapes: Iterable[BaseGeometry]) -> tuple[Array, Array]:
    """Return the start and end points of the edges of shapes, each (n_edges, 2) [m]."""
    rings = shapely.get_rings(shapely.get_parts(list(shapes)))
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    within = ring[1:] == ring[:-1]
    return corners[:-1][within], corners[1:][within]


def jutting_corners(shape: BaseGeometry, reach: float) -> tuple[Array, Array]:
    """Return corners (n_corners, 2) [m] that jut into a shape, and their sharpness (n_corners,).

    Sharpness is tan^2 of half the turn: 1 at a right angle, at most 3. The turn is measured between
    points of the outline a distance `reach` before and after the corner, so that finer rounding
    does not hide corners, and jags do not count as corners.
    """
    places, turns = [np.empty((0, 2))], [np.empty(0)]
    for ring in shapely.get_rings(shapely.orient_polygons(shapely.get_parts(shape))):
        line = np.tile(shapely.get_coordinates(ring)[:-1], (3, 1))
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))))
        once = slice(len(line) // 3, 2 * len(line) // 3)
        before, after = (
            np.stack([np.interp(along[once] + step, along, axis) for axis in line.T], axis=1)
            for step in (-reach, reach)
        )
        a, b = (line[once] - before).T
        c, d = (after - line[once]).T
        places.append(line[once])
        # The shape is on the left; the outline of a jutting corner turns right.
        turns.append(np.arctan2(b * c - a * d, a * c + b * d))
    place = np.concatenate(places)
    turn = np.concatenate(turns)
    juts = turn > CORNER
    return place[juts], np.tan(0.5 * np.minimum(turn[juts], SHARPEST)) ** 2


def require_few_crossings(shapes: Iterable[BaseGeometry]) -> None:
    """Raise ValueError if edges cross so often that combining the shapes would take long.

    The number is estimated from a few edges.
    """
    every = np.array(list(shapes), dtype=object)
    one, other = shapely.STRtree(every).query(every)
    # Shapes apart from all others do not cross any.
    ends = np.stack(edges_of(every[np.unique(one[one != other])]), axis=1)
    edges = shapely.linestrings(ends)
    chosen = np.random.default_rng(0).permutation(edges)[:N_EDGES]
    crossed, _ = shapely.STRtree(edges).query(chosen, predicate="crosses")
    crossings = 0.5 * len(crossed) * len(edges) / max(1, len(chosen))
    if crossings > MOST_CROSSINGS:
        raise ValueError(f"outlines cross about {crossings:.0e} times; simplify them")


def periodic_shifts(
    lengths: Lengths, periodic: Periodic, number: int = 1
) -> list[tuple[float, float]]:
    """Return the translations [m] to periodic images, up to `number` boxes away on either side."""
    turns = (range(-number, number + 1) if repeats else (0,) for repeats in periodic)
    width, height = lengths
    return [(i * width, j * height) for i, j in itertools.product(*turns)]


def joined_areas(shape: BaseGeometry, lengths: Lengths, periodic: Periodic) -> Array:
    """Return the areas [m2] of a shape's separate parts; periodic edges connect some."""
    # Few commands need this module, and importing it takes long.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    parts = shapely.get_parts(shape)
    pairs = [_joined_across(axis, parts, lengths) for axis in range(2) if periodic[axis]]
    one, other = np.concatenate([np.empty((2, 0), np.int64), *pairs], axis=1)
    graph = coo_array((np.ones(one.size), (one, other)), shape=(len(parts), len(parts)))
    number, part_of = connected_components(graph, directed=False)
    return np.bincount(part_of, shapely.area(parts), minlength=number).astype(np.float64)


def connects_images(fluid: BaseGeometry, lengths: Lengths, axis: int) -> bool:
    """Return whether fluid that leaves a periodic box along an axis can come back at its start.

    `fluid` contains the images on either side [m]. A part of it that overlaps with itself one
    period further contains a path from a place to the image of this place.
    """
    shift = [length if i == axis else 0.0 for i, length in enumerate(lengths)]
    shared = (part.intersection(translate(part, *shift)) for part in shapely.get_parts(fluid))
    return any(overlap.area > ROUNDING * lengths[0] * lengths[1] for overlap in shared)


def _joined_across(axis: int, parts: NDArray[np.object_], lengths: Lengths) -> Indices:
    """Return the pairs of parts (2, n_pairs) that continue in each other past a periodic edge."""
    shift = [length if i == axis else 0.0 for i, length in enumerate(lengths)]
    moved = np.array([translate(part, *shift) for part in parts])
    here, there = shapely.STRtree(parts).query(moved, predicate="intersects")
    shared = shapely.length(shapely.intersection(moved[here], parts[there]))
    wide = shared > ROUNDING * max(lengths)
    return np.stack((here[wide], there[wide]))


def least_widths(
    fluid: BaseGeometry, is_wall: Callable[[Array], Mask], lower: Array, upper: Array
) -> tuple[float, float]:
    """Return the least widths [m] of the fluid and of the solid, infinite if there is none.

    Parameters
    ----------
    is_wall : whether midpoints (n, 2) [m] of edges of the fluid are on walls.
    lower, upper : corners (2,) of the box in which widths are measured [m].
    """
    size = float(np.max(upper - lower))
    slack = SLACK * size

    def within(place: Array) -> Mask:
        return np.all((place >= lower - slack) & (place <= upper + slack), axis=1)

    edges = outline_of(fluid)
    wall = is_wall(0.5 * (edges[1] + edges[2])) & within(0.5 * (edges[1] + edges[2]))
    widths = _ends(edges, wall, 1), _ends(edges, wall, -1)
    holes = [hole for part in shapely.get_parts(fluid) for hole in part.interiors]
    radii = shapely.maximum_inscribed_circle(shapely.polygons(np.array(holes, object)), 1e-3 * size)
    least_gap = float(widths[0].min(initial=math.inf))
    least_solid = float(np.min((*widths[1], *(2.0 * shapely.length(radii))), initial=math.inf))
    cut = outline_of(shapely.segmentize(fluid, size / N_PLACES))
    cut_wall = is_wall(0.5 * (cut[1] + cut[2]))
    # Small widths are searched first, because of thousands of edges few are near each other.
    reach = size / N_PLACES
    while True:
        middle, width = _circles(cut, cut_wall, within, slack, reach)
        in_fluid = shapely.contains_xy(fluid, middle)
        least_gap = min(least_gap, float(width[in_fluid].min(initial=math.inf)))
        least_solid = min(least_solid, float(width[~in_fluid].min(initial=math.inf)))
        if max(least_gap, least_solid) <= reach or reach > 2.0 * size:
            return least_gap, least_solid
        reach *= 2.0


def outline_of(fluid: BaseGeometry) -> Array:
    """Return the ends of edges, and those of the edges before and after (4, n_edges, 2) [m].

    The fluid is on the left of edges.
    """
    parts = shapely.orient_polygons(shapely.get_parts(fluid))
    rings = [shapely.get_coordinates(ring)[:-1] for ring in shapely.get_rings(parts)]
    rolled = [[np.roll(ring, shift, axis=0) for shift in (1, 0, -1, -2)] for ring in rings]
    return np.concatenate([np.stack(ring) for ring in rolled], axis=1)


def _circles(
    edges: Array, wall: Mask, within: Callable[[Array], Mask], slack: float, reach: float
) -> tuple[Array, Array]:
    """Return centres and diameters of empty circles that touch a corner and a wall.

    Circles with diameters larger than the reach may be missing.
    """
    _, start, end, following = edges
    along, after = end - start, following - end
    length = np.hypot(*along.T)
    corners = np.flatnonzero(wall & within(end))
    tree = shapely.STRtree(shapely.linestrings(np.stack((start, end), axis=1)))
    middles, widths = [np.empty((0, 2))], [np.empty(0)]
    share = min(1.0, SHARE_NEAR * reach / float(np.max(np.ptp(end, axis=0))))
    n_pairs = len(corners) * len(start) * share
    for batch in np.array_split(corners, 1 + int(n_pairs) // N_PAIRS):
        found = tree.query(shapely.points(end[batch]), predicate="dwithin", distance=reach)
        one, other = batch[found[0]], found[1]
        place = np.clip(_dot(end[one] - start[other], along[other]) / length[other] ** 2, 0.0, 1.0)
        across = start[other] + place[:, None] * along[other] - end[one]
        width = np.hypot(*across.T)
        # Neither of the corner's own sides leads into the circle.
        free = wall[other] & (width > slack)
        free &= _dot(across, along[one]) >= -SLACK * width * length[one]
        free &= _dot(across, after[one]) <= SLACK * width * np.hypot(*after[one].T)
        middle, diameter = end[one][free] + 0.5 * across[free], width[free]
        _, nearest = tree.query_nearest(
            shapely.points(middle), all_matches=False, return_distance=True
        )
        alone = within(middle) & (nearest >= (0.5 - SLACK) * diameter)
        middles.append(middle[alone])
        widths.append(diameter[alone])
    return np.concatenate(middles), np.concatenate(widths)


def _ends(edges: Array, wall: Mask, side: int) -> Array:
    """Return the widths [m] of ends and mouths of the fluid if `side` is 1, of solids if -1."""
    before, along, after = np.diff(edges, axis=0)
    behind = left_turn(before, along)
    ahead = left_turn(along, after)
    length = np.hypot(*along.T)
    ends = wall & (np.minimum(side * behind, side * ahead) > LEAST_TURN)
    ends &= np.abs(np.abs(behind + ahead) - math.pi) < FACING
    widths = [length[ends]]
    for turn, far, neighbour in ((ahead, behind, after), (behind, ahead, before)):
        angle = math.pi - side * turn
        mouth = wall & (angle < FACING) & (length <= np.hypot(*neighbour.T))
        mouth &= (np.abs(far) > FACING) | (angle < TOUCHING)
        widths.append((2.0 * length * np.sin(0.5 * angle))[mouth])
    return np.concatenate(widths)


def left_turn(one: Array, other: Array) -> Array:
    """Return the left turns from vectors (n, 2) to others [rad]."""
    cross = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    return np.arctan2(cross, _dot(one, other))


def _dot(one: Array, other: Array) -> Array:
    return one[..., 0] * other[..., 0] + one[..., 1] * other[..., 1]
