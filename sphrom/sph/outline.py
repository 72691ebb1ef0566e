"""Walls of any shape as chains of straight segments, listed by cell, the fluid on their left."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from sphrom.kernels import segments as segment_sweeps
from sphrom.kernels.cells import Grid
from sphrom.sph.domain import WallSearch

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


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
