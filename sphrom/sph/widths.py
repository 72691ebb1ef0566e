"""How wide the narrowest places of the fluid, and of the solid, are between walls of any shape.

Walls are across from each other where a circle touches them at two opposite points and holds no
other wall: in a channel, on either side of a plate, or between a corner and a wall. Its diameter is
the width. At a corner the width between its two sides vanishes, however fine the particles are, and
doesn't count. Three more widths do: the end of a slot or plate whose sides hardly narrow, the mouth
between straight sides that meet at a sharp corner, and the largest circle within a solid.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

FACING = math.radians(20.0)
"""How far sides may be from parallel, and face each other."""
LEAST_TURN = math.radians(45.0)
"""Of a side into the end of a slot or plate."""
TOUCHING = math.radians(2.0)
"""Sides that meet at less touch each other."""
N_PLACES = 64
"""Places along the box's longer edge from which walls across are looked for, at least."""
ROUNDING = 1e-7
"""Cosines below are zero, and so are lengths, over the size of the box."""
SHARE_NEAR = 4.0
"""Edges within reach of a corner over all, times the size of the outline over the reach."""
N_PAIRS = 500_000
"""Pairs of a place and an edge that are looked at at once."""


def least_widths(
    fluid: BaseGeometry, is_wall: Callable[[Array], Mask], lower: Array, upper: Array
) -> tuple[float, float]:
    """Return the least widths [m] of the fluid and of the solid, infinite where there is none.

    Parameters
    ----------
    is_wall : says which places (n, 2) [m], in the middle of edges of the fluid, are of walls.
    lower, upper : corners (2,) of the box in which widths are measured [m].
    """
    size = float(np.max(upper - lower))
    slack = ROUNDING * size

    def within(place: Array) -> Mask:
        return np.asarray(np.all((place >= lower - slack) & (place <= upper + slack), axis=1))

    edges = _edges(fluid)
    wall = is_wall(0.5 * (edges[1] + edges[2])) & within(0.5 * (edges[1] + edges[2]))
    ends = _ends(edges, wall, 1), _ends(edges, wall, -1)
    holes = [hole for part in shapely.get_parts(fluid) for hole in part.interiors]
    radii = shapely.maximum_inscribed_circle(shapely.polygons(np.array(holes, object)), 1e-3 * size)
    least_gap = float(ends[0].min(initial=math.inf))
    least_solid = float(np.min((*ends[1], *(2.0 * shapely.length(radii))), initial=math.inf))
    cut = _edges(shapely.segmentize(fluid, size / N_PLACES))
    cut_wall = is_wall(0.5 * (cut[1] + cut[2]))
    # The least widths are sought near by first: of thousands of edges, few are near each other.
    reach = size / N_PLACES
    while True:
        middle, width = _circles(cut, cut_wall, within, slack, reach)
        in_fluid = shapely.contains_xy(fluid, middle)
        least_gap = min(least_gap, float(width[in_fluid].min(initial=math.inf)))
        least_solid = min(least_solid, float(width[~in_fluid].min(initial=math.inf)))
        if max(least_gap, least_solid) <= reach or reach > 2.0 * size:
            return least_gap, least_solid
        reach *= 2.0


def _edges(fluid: BaseGeometry) -> Array:
    """Return the ends of edges, and those of the edges before and after (4, n_edges, 2) [m].

    The fluid is on the left.
    """
    parts = shapely.orient_polygons(shapely.get_parts(fluid))
    rings = [shapely.get_coordinates(ring)[:-1] for ring in shapely.get_rings(parts)]
    rolled = [[np.roll(ring, shift, axis=0) for shift in (1, 0, -1, -2)] for ring in rings]
    return np.concatenate([np.stack(ring) for ring in rolled], axis=1)


def _circles(
    edges: Array, wall: Mask, within: Callable[[Array], Mask], slack: float, reach: float
) -> tuple[Array, Array]:
    """Return circles that touch a corner and a wall, and hold no other: centres and diameters.

    Those with a diameter beyond a reach may be missing.
    """
    _, start, end, following = edges
    along, after = end - start, following - end
    length = np.hypot(*along.T)
    corners = np.flatnonzero(wall & within(end))
    tree = shapely.STRtree(shapely.linestrings(np.stack((start, end), axis=1)))
    middles, widths = [np.empty((0, 2))], [np.empty(0)]
    share = min(1.0, SHARE_NEAR * reach / float(np.max(np.ptp(end, axis=0))))
    n_pairs = len(corners) * len(start) * share
    for few in np.array_split(corners, 1 + int(n_pairs) // N_PAIRS):
        near = tree.query(shapely.points(end[few]), predicate="dwithin", distance=reach)
        one, other = few[near[0]], near[1]
        place = np.clip(_dot(end[one] - start[other], along[other]) / length[other] ** 2, 0.0, 1.0)
        way = start[other] + place[:, None] * along[other] - end[one]
        width = np.hypot(*way.T)
        # No step along the corner's own sides leads into the circle.
        free = wall[other] & (width > slack)
        free &= _dot(way, along[one]) >= -ROUNDING * width * length[one]
        free &= _dot(way, after[one]) <= ROUNDING * width * np.hypot(*after[one].T)
        middle, diameter = end[one][free] + 0.5 * way[free], width[free]
        _, nearest = tree.query_nearest(
            shapely.points(middle), all_matches=False, return_distance=True
        )
        alone = within(middle) & (nearest >= (0.5 - ROUNDING) * diameter)
        middles.append(middle[alone])
        widths.append(diameter[alone])
    return np.concatenate(middles), np.concatenate(widths)


def _ends(edges: Array, wall: Mask, side: int) -> Array:
    """Return the widths [m] of ends and mouths of the fluid if `side` is 1, of solids if -1."""
    before, along, after = np.diff(edges, axis=0)
    behind, ahead = _turn(before, along), _turn(along, after)
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


def _turn(one: Array, other: Array) -> Array:
    """Return the angles to the left from ways (n, 2) to others [rad]."""
    cross = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    return np.asarray(np.arctan2(cross, _dot(one, other)))


def _dot(one: Array, other: Array) -> Array:
    return np.asarray(one[..., 0] * other[..., 0] + one[..., 1] * other[..., 1])
