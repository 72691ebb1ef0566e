"""How wide the narrowest places between walls of any shape are.

Walls are across from each other at two kinds of places. Where they face each other, within 20
degrees, as in a channel, on either side of a thin plate, or in a slot that is closed at its end.
And where their distance is least, at any angle, as from a corner to a wall that slants.

At a corner the width between its two sides vanishes, however fine the particles are. So where sides
that face each other meet, it is the width of the mouth between them that counts.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Mask = NDArray[np.bool_]

FACING = math.radians(20.0)
"""How far walls may be from parallel, and face each other."""
SHARPEST = math.radians(2.0)
"""Sides that meet at less touch each other: they are no corner."""
STRAIGHT, BENT = math.radians(1.0), math.radians(5.0)
"""Sides that bend apart by an angle between these open like those of a round body: no mouth."""
ROUNDING = 1e-7
"""Sines of angles below are zero."""
SAME = 1e-9
"""Shorter distances, over the outline's size, are zero."""
N_RAYS = 500
"""Rays that are looked at at once."""
WITHIN = 0.8
"""A mouth is as wide as was found if it is so much narrower than what was looked at."""


@dataclass(frozen=True, eq=False)
class Edges:
    """The straight edges of outlines, with what is measured on their left."""

    start: Array
    """(n_edges, 2) [m], along one outline after the other."""
    first: Indices
    """(n_edges,) the first edge of the outline that each is of."""
    number: Indices
    """(n_edges,) how many edges that outline has."""
    is_wall: Mask
    """(n_edges,) whether each is a wall, and doesn't only close an outline."""

    @classmethod
    def of(cls, rings: list[Array], is_wall: Callable[[Array], Mask]) -> Edges:
        """Return the edges of rings of corners (n_corners, 2) [m], the first of them not repeated.

        `is_wall` says which places (n, 2) [m], in the middle of edges, are of walls.
        """
        number = np.array([len(ring) for ring in rings])
        first = np.cumsum(number) - number
        middle = [0.5 * (ring + np.roll(ring, -1, axis=0)) for ring in rings]
        return cls(
            np.concatenate(rings),
            np.repeat(first, number),
            np.repeat(number, number),
            is_wall(np.concatenate(middle)),
        )

    @cached_property
    def after(self) -> Indices:
        """(n_edges,) the edge that starts where each ends."""
        return np.asarray(self.first + (np.arange(len(self.start)) + 1 - self.first) % self.number)

    @cached_property
    def before(self) -> Indices:
        """(n_edges,) the edge that ends where each starts."""
        return np.asarray(self.first + (np.arange(len(self.start)) - 1 - self.first) % self.number)

    @cached_property
    def end(self) -> Array:
        """(n_edges, 2) [m]."""
        return self.start[self.after]

    @cached_property
    def length(self) -> Array:
        """(n_edges,) [m]."""
        return np.asarray(np.hypot(*(self.end - self.start).T))

    @cached_property
    def tangent(self) -> Array:
        """(n_edges, 2)."""
        return (self.end - self.start) / self.length[:, None]

    @cached_property
    def normal(self) -> Array:
        """(n_edges, 2), to the left."""
        return np.stack((-self.tangent[:, 1], self.tangent[:, 0]), axis=1)

    @cached_property
    def tree(self) -> shapely.STRtree:
        """The edges, to be searched."""
        return shapely.STRtree(shapely.linestrings(np.stack((self.start, self.end), axis=1)))

    @cached_property
    def turn(self) -> Array:
        """(n_edges,) the angle to the left at the end of each [rad]."""
        one, other = self.tangent, self.tangent[self.after]
        return np.asarray(np.arctan2(_cross(one, other), _dot(one, other)))

    @cached_property
    def is_sharp(self) -> Mask:
        """(n_edges,) whether sides that face each other meet at the end of each."""
        angle = math.pi - self.turn
        return np.asarray((angle > SHARPEST) & (angle < FACING))

    def mouths(self, one: Indices, other: Indices) -> Indices:
        """Return the sharp corners (2, n) between some edges, -1 where there is none.

        One of the two ways along the outline from edge to edge turns there, and hardly elsewhere.
        """
        turned = np.concatenate(([0.0], np.cumsum(np.where(self.is_sharp, 0.0, np.abs(self.turn)))))
        sharp = np.concatenate(([0], np.cumsum(self.is_sharp)))
        corners = np.append(np.flatnonzero(self.is_sharp), -1)
        low, high = np.minimum(one, other), np.maximum(one, other)
        start, end = self.first[one], self.first[one] + self.number[one]
        inner = turned[high] - turned[low], sharp[high] - sharp[low], sharp[low]
        before = np.where(sharp[low] > sharp[start], sharp[start], sharp[high])
        around = (
            turned[end] - turned[start] - inner[0],
            sharp[end] - sharp[start] - inner[1],
            before,
        )
        found = np.full((2, len(one)), -1)
        for row, (angle, number, place) in zip(found, (inner, around), strict=True):
            meet = (self.first[one] == self.first[other]) & (number == 1) & (angle < FACING)
            row[meet] = corners[place[meet]]
        return found


def least_width(edges: Edges, lower: Array, upper: Array, spacing: float) -> float:
    """Return the least width [m] on the left of some walls, infinite where none is across.

    Parameters
    ----------
    lower, upper : corners (2,) of the box from whose walls widths are measured [m].
    spacing : of the places along walls where those that face them are looked for, at most [m].
    """
    if not edges.is_wall.any():
        return math.inf
    largest = 2.0 * float(np.hypot(*np.ptp(edges.start, axis=0)))
    reach = spacing
    while reach < 2.0 * largest:
        found = _facing(edges, lower, upper, spacing, reach)
        found = min(found, _nearest(edges, lower, upper, min(found, reach)))
        if found <= reach:
            return found
        reach *= 2.0
    return math.inf


def _facing(edges: Edges, lower: Array, upper: Array, spacing: float, reach: float) -> float:
    """Return the least distance [m] of walls that face each other, if it is within reach."""
    place, which = _spread(edges, spacing)
    inside = np.all((place >= lower) & (place <= upper), axis=1)
    place, which = place[inside], which[inside]
    mouth, opens = np.zeros(len(edges.start)), np.zeros(len(edges.start), dtype=bool)
    least = math.inf
    for few in np.array_split(np.arange(len(place)), 1 + len(place) // N_RAYS):
        ray, met, distance = _first_met(edges, place[few], edges.normal[which[few]], reach)
        source = which[few][ray]
        apart = np.arccos(np.clip(-_dot(edges.normal[source], edges.normal[met]), -1.0, 1.0))
        corners, facing = edges.mouths(source, met), apart < FACING
        alone = facing & np.all(corners < 0, axis=0)
        least = min(least, float(distance[alone].min(initial=math.inf)))
        for corner in corners:
            between = facing & (corner >= 0)
            np.maximum.at(mouth, corner[between], distance[between])
            wider = (corner >= 0) & (apart < FACING + BENT)
            wider &= apart > math.pi - edges.turn[corner] + STRAIGHT
            opens[corner[wider]] = True
    mouths = mouth[(mouth > 0.0) & (mouth < WITHIN * reach) & ~opens]
    return min(least, float(mouths.min(initial=math.inf)))


def _first_met(
    edges: Edges, place: Array, way: Array, reach: Array | float
) -> tuple[Indices, Indices, Array]:
    """Return rays that meet walls within reach, the edges that they meet first, and how far [m]."""
    reach = np.broadcast_to(reach, len(place))
    ends = np.stack((place, place + reach[:, None] * way), axis=1)
    ray, met = edges.tree.query(shapely.linestrings(ends))
    along = edges.end[met] - edges.start[met]
    offset, across = edges.start[met] - place[ray], _cross(way[ray], along)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = _cross(offset, along) / across
        share = _cross(offset, way[ray]) / across
    least = SAME * float(np.abs(edges.start).max())
    hit = (share >= 0.0) & (share <= 1.0) & (distance > least) & (distance <= reach[ray])
    ray, met, distance = ray[hit], met[hit], distance[hit]
    order = np.lexsort((distance, ray))
    ray, met, distance = ray[order], met[order], distance[order]
    is_first = np.concatenate(([True], ray[1:] != ray[:-1]))[: len(ray)] & edges.is_wall[met]
    return ray[is_first], met[is_first], distance[is_first]


def _spread(edges: Edges, spacing: float) -> tuple[Array, Indices]:
    """Return places (n, 2) along walls, at most so far apart [m], and the edges they are on."""
    number = np.where(edges.is_wall, np.ceil(edges.length / spacing), 0).astype(int)
    which = np.repeat(np.arange(len(number)), number)
    count = np.arange(len(which)) - np.repeat(np.cumsum(number) - number, number)
    share = (count + 0.5) / number[which]
    return edges.start[which] + share[:, None] * (edges.end - edges.start)[which], which


def _nearest(edges: Edges, lower: Array, upper: Array, reach: float) -> float:
    """Return the least distance [m] of a corner from another wall that no step along them lessens.

    Of two outlines that are nearest to each other one has a corner there.
    """
    is_wall = edges.is_wall & edges.is_wall[edges.after]
    inside = np.all((edges.end >= lower) & (edges.end <= upper), axis=1)
    blunt = np.flatnonzero(is_wall & inside & (edges.turn < ROUNDING))
    least = math.inf
    for few in np.array_split(blunt, 1 + len(blunt) // N_RAYS):
        points = shapely.points(edges.end[few])
        found = edges.tree.query(points, predicate="dwithin", distance=min(reach, least))
        one, way, distance = _across(edges, few[found[0]], found[1])
        free = _is_free(edges, edges.end[one], way, distance)
        least = min(least, float(distance[free].min(initial=math.inf)))
    return least


def _across(edges: Edges, one: Indices, other: Indices) -> tuple[Indices, Array, Array]:
    """Return the corners, as edges that end there, that no step brings nearer to another edge.

    With the way (n, 2) and the distance (n,) [m] to the other edge.
    """
    share = np.clip(
        _dot(edges.end[one] - edges.start[other], edges.tangent[other]), 0.0, edges.length[other]
    )
    offset = edges.start[other] + share[:, None] * edges.tangent[other] - edges.end[one]
    distance = np.hypot(offset[:, 0], offset[:, 1])
    kept = edges.is_wall[other] & (distance > SAME * float(np.abs(edges.start).max()))
    kept &= _is_normal(edges, one, edges.after[one], offset, ROUNDING * distance)
    one, other, share, distance = one[kept], other[kept], share[kept], distance[kept]
    way = offset[kept] / distance[:, None]
    # The ends of the other edge may be corners too.
    before = edges.before[other]
    kept = _dot(way, edges.normal[other]) < 0.0
    kept &= (share > 0.0) | _is_normal(edges, before, other, -way, ROUNDING)
    at_end = share >= edges.length[other]
    kept &= ~at_end | _is_normal(edges, other, edges.after[other], -way, ROUNDING)
    return one[kept], way[kept], distance[kept]


def _is_normal(
    edges: Edges, before: Indices, after: Indices, way: Array, slack: Array | float
) -> Mask:
    """Whether ways (n, 2) from corners lead to the left, and no step along edges follows them."""
    blocked = _dot(way, edges.tangent[before]) >= -slack
    blocked &= _dot(way, edges.tangent[after]) <= slack
    return np.asarray(blocked & (_dot(way, edges.normal[before] + edges.normal[after]) > 0.0))


def _is_free(edges: Edges, start: Array, way: Array, distance: Array) -> Mask:
    """Whether no wall is met before so far from some places [m]."""
    aside = ROUNDING * distance
    blocked, *_ = _first_met(edges, start + aside[:, None] * way, way, distance - 3.0 * aside)
    free = np.ones(len(start), dtype=bool)
    free[blocked] = False
    return free


def _cross(one: Array, other: Array) -> Array:
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])


def _dot(one: Array, other: Array) -> Array:
    return np.asarray(one[..., 0] * other[..., 0] + one[..., 1] * other[..., 1])
