"""Walls of any shape as chains of straight segments, listed by cell, the fluid on their left."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from sphrom.kernels import segments as segment_sweeps
from sphrom.kernels.cells import Grid
from sphrom.sph.domain import WallSearch

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FACING = -math.cos(math.radians(20.0))
"""Two walls face each other when the product of their normals is below: within 20 degrees."""
N_BLOCK_PAIRS = 2_000_000
"""Pairs of rays and segments that are looked at at once."""
SAME = 1e-9
"""A ray doesn't end within so much of the outline's size: it starts there."""


@dataclass(frozen=True)
class Outline(WallSearch):
    """The segments of all walls, and lists of those that matter in each cell of a grid."""

    segments: Array
    """(n_segments, 6), as `sphrom.kernels.segments` has them [m]."""
    wall: Indices
    """(n_segments,) the wall that each is of."""
    listed: Indices
    start: Indices
    grid: Grid

    @property
    def kernels(self) -> ModuleType:
        """Those of segments."""
        return segment_sweeps

    @property
    def lists(self) -> tuple[Array, Indices, Indices, Grid]:
        """The segments, and the lists of those in each cell."""
        return self.segments, self.listed, self.start, self.grid

    def nearest(self, position: Array) -> tuple[Array, Array, Indices]:
        """Return signed distances (n_points,) [m], normals (n_points, 2) and nearest segments."""
        place = np.ascontiguousarray(position.T)
        out, nearest = np.empty((3, len(position))), np.empty(len(position), np.int64)
        segment_sweeps.signed_distances(place, *self.lists, out, nearest)
        return out[0], np.ascontiguousarray(out[1:].T), nearest


def list_by_cell(
    segments: Array, wall: Indices, lower: Array, upper: Array, cell_width: float, reach: float
) -> Outline:
    """Return an outline whose cells cover a box.

    Parameters
    ----------
    lower, upper : the box's corners (2,) [m].
    cell_width, reach : of the cells, and from within which all segments are listed [m].
    """
    n_columns, n_rows = np.ceil((upper - lower) / cell_width).astype(int)
    grid = Grid(
        float(lower[0]), float(lower[1]), cell_width, cell_width, int(n_columns), int(n_rows)
    )
    return Outline(segments, wall, *segment_sweeps.list_segments(segments, grid, reach), grid)


def chain(corners: Array) -> Array:
    """Return the segments (n_corners, 6) of a closed chain of corners (n_corners, 2) [m]."""
    before, after = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0)
    return np.hstack((corners, after, before))


def least_width(segments: Array, place: Array, normal: Array) -> float:
    """Return the least distance [m] at which walls face each other, infinite where none do.

    Parameters
    ----------
    place, normal : points (n_points, 2) of walls [m], and unit vectors away from them, into the
        fluid or into the solid, along which to look for the wall on the other side.
    """
    n_blocks = 1 + len(place) * len(segments) // N_BLOCK_PAIRS
    blocks = zip(np.array_split(place, n_blocks), np.array_split(normal, n_blocks), strict=True)
    return min(_shortest_ray(segments, *block) for block in blocks)


def _shortest_ray(segments: Array, place: Array, way: Array) -> float:
    along = segments[:, 2:4] - segments[:, :2]
    tangent = along / np.hypot(*along.T)[:, None]
    offset = segments[:, :2] - place[:, None]
    across = _cross(way[:, None], along)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance, share = _cross(offset, along) / across, _cross(offset, way[:, None]) / across
    met = (share >= 0.0) & (share <= 1.0) & (distance > SAME * np.max(np.abs(segments)))
    distance = np.where(met, distance, np.inf)
    first = np.argmin(distance, axis=1)
    # A ray into the solid meets a wall from behind: it is the way that tells the sides apart.
    facing = np.abs(_cross(way, tangent[first])) > -FACING
    return float(np.min(distance[np.arange(len(place)), first][facing], initial=np.inf))


def _cross(one: Array, other: Array) -> Array:
    return np.asarray(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])


def spread(segments: Array, longest: float) -> tuple[Array, Array]:
    """Return points (n_points, 2) along segments, at most so far apart [m], and normals there."""
    along = segments[:, 2:4] - segments[:, :2]
    length = np.hypot(*along.T)
    number = np.ceil(length / longest).astype(int)
    which = np.repeat(np.arange(len(segments)), number)
    count = np.arange(len(which)) - np.repeat(np.cumsum(number) - number, number)
    share = (count + 0.5) / number[which]
    tangent = along / length[:, None]
    normal = np.stack((-tangent[:, 1], tangent[:, 0]), axis=1)
    return segments[which, :2] + share[:, None] * along[which], normal[which]
