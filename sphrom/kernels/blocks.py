"""Blocks of neighbouring targets, which share one list of candidates.

The targets of a few neighbouring cells of one row are a block. What may lie within reach of any of
them is copied side by side once, row of cells after row of cells, and each target then sums over
the whole list in one long loop. A loop for each row of cells is only a
few vectors long, and what surrounds it costs as much again: with lists the whole right-hand side is
1.5 to 1.7 times faster.

The list's length is a multiple of a vector's, filled up with a source beyond all supports, so that
no loop has a scalar rest. Positions in the list are relative to the block's first target.
"""

from __future__ import annotations

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.kernels.cells import Grid, range_beside_box, rows_within
from sphrom.kernels.jit import serial, term

BLOCK_COLUMNS = 4
"""Cells of a row whose targets are a block: the fastest of those tried."""
VECTOR = 8
"""A list's length is a multiple of it: the doubles in a vector of 512 bits."""
N_CHUNKS = 64
"""Blocks are shared out in as many parts; each has its own memory for a list."""
FAR = 4.0
"""Where the sources lie that fill up a list, over the reach and the block's size."""


@serial
def split_targets(targets: Indices, grid: Grid, cell_start: Indices) -> Indices:
    """Return where blocks begin among the targets, which are sorted, and their end."""
    start = np.empty(targets.size + 1, np.int64)
    n_blocks = 0
    t = 0
    for row in range(grid.n_rows):
        for column in range(0, grid.n_columns, BLOCK_COLUMNS):
            last = min(column + BLOCK_COLUMNS, grid.n_columns)
            end = cell_start[row * grid.n_columns + last]
            if t < targets.size and targets[t] < end:
                start[n_blocks] = t
                n_blocks += 1
            while t < targets.size and targets[t] < end:
                t += 1
    start[n_blocks] = targets.size
    return start[: n_blocks + 1].copy()


@term
def box_of(source: Array, targets: Indices) -> tuple[float, float, float, float]:
    """Return the least and the largest x, and y, of some targets [m]."""
    west = east = source[0, targets[0]]
    south = north = source[1, targets[0]]
    for t in range(1, targets.size):
        j = targets[t]
        west = min(west, source[0, j])
        east = max(east, source[0, j])
        south = min(south, source[1, j])
        north = max(north, source[1, j])
    return west, east, south, north


@serial
def longest_list(
    place: Array, targets: Indices, block_start: Indices, grid: Grid, cell_start: Indices,
    reach: float, move_limit: float,
) -> int:
    """Return the length that no list exceeds while no target has moved beyond a limit [m].

    `place` (2, n_sources) is where sources were when they were sorted, `reach` is the largest.
    """
    longest = 0
    for b in range(block_start.size - 1):
        west, east, south, north = box_of(place, targets[block_start[b] : block_start[b + 1]])
        west -= move_limit
        east += move_limit
        south -= move_limit
        north += move_limit
        total = 0
        first, last = rows_within(south, north, reach, grid)
        for row in range(first, last):
            low, high = range_beside_box(west, east, south, north, row, reach, grid, cell_start)
            total += max(high - low, 0)
        longest = max(longest, total)
    return (longest + VECTOR - 1) // VECTOR * VECTOR


@term
def copy_range(values: Array, target: Array, origin: float) -> None:
    """Copy a range of a field, less its origin."""
    for k in range(values.size):
        target[k] = values[k] - origin


@term
def list_candidates(
    source: Array, targets: Indices, grid: Grid, cell_start: Indices, reach: float,
    candidates: Array,
) -> int:
    """Copy what may lie within reach of a block's targets to a list, and return its length.

    Parameters
    ----------
    source : (>= n_fields, n_sources) sorted by cell; rows x, y [m], then others.
    targets : the block's.
    candidates : (n_fields, longest list) its rows are the first ones of `source`.
    """
    x_origin = source[0, targets[0]]
    y_origin = source[1, targets[0]]
    west, east, south, north = box_of(source, targets)
    n = 0
    first, last = rows_within(south, north, reach, grid)
    for row in range(first, last):
        low, high = range_beside_box(west, east, south, north, row, reach, grid, cell_start)
        if high > low:
            end = n + high - low
            copy_range(source[0, low:high], candidates[0, n:end], x_origin)
            copy_range(source[1, low:high], candidates[1, n:end], y_origin)
            for f in range(2, candidates.shape[0]):
                copy_range(source[f, low:high], candidates[f, n:end], 0.0)
            n = end
    full = (n + VECTOR - 1) // VECTOR * VECTOR
    for k in range(n, full):
        for f in range(candidates.shape[0]):
            candidates[f, k] = 0.0
        candidates[0, k] = FAR * (reach + east - west)
    return full
