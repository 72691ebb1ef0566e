"""Blocks of neighbouring targets with a common list of candidates.

A block consists of the targets in a few neighbouring cells of one row. All sources that may be
within reach of any of them are copied once into a contiguous list, row of cells by row of cells,
and each target sums over the whole list in one long loop. A loop per row of cells would be only a
few vectors long, with as much overhead again: with lists the whole right-hand side is 1.5 to 1.7
times faster.

The length of the list is a multiple of the vector length, so that no loop has a scalar remainder;
it is padded with a source beyond all supports. Positions are relative to the block's first target,
so that a list in single precision keeps the digits of offsets.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.kernels.cells import Box, Grid, Search, range_beside_box, rows_within
from sphrom.kernels.jit import serial, term

BLOCK_COLUMNS = 4
"""Number of cells of a row whose targets form a block: the fastest of several tried."""
VECTOR = 8
"""Lengths of lists are multiples of this number: the doubles in a vector of 512 bits."""
N_CHUNKS = 64
"""Number of parts into which blocks are divided; each has its own memory for a list."""
FAR = 4.0
"""Position of the padding sources of a list, over the reach and the block's size."""


class Blocks(NamedTuple):
    """The particles among the sources, in blocks, and the memory for their lists."""

    particle: Indices
    """(n_sources,) the particle of each source; several sources may be its images."""
    targets: Indices
    """(n_particles,) the sources that are particles, in sorted order."""
    start: Indices
    """(n_blocks + 1,) the first target of each block."""
    scratch: Array
    """(N_CHUNKS, n_fields, longest list), in the precision of sums over pairs."""


@serial
def split_targets(targets: Indices, grid: Grid, cell_start: Indices) -> Indices:
    """Return the first target of each block in the sorted targets, and the end of the last."""
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
def box_of(source: Array, targets: Indices) -> Box:
    """Return the box around some targets."""
    west = east = source[0, targets[0]]
    south = north = source[1, targets[0]]
    for t in range(1, targets.size):
        j = targets[t]
        west = min(west, source[0, j])
        east = max(east, source[0, j])
        south = min(south, source[1, j])
        north = max(north, source[1, j])
    return Box(west, east, south, north)


@serial
def longest_list(
    place: Array, targets: Indices, block_start: Indices, search: Search, move_limit: float
) -> int:
    """Return a bound for the length of lists while no target has moved beyond a limit [m].

    `place` (2, n_sources) are the positions when sources were sorted; the reach is the largest.
    """
    longest = 0
    for b in range(block_start.size - 1):
        box = box_of(place, targets[block_start[b] : block_start[b + 1]])
        box = Box(
            box.west - move_limit,
            box.east + move_limit,
            box.south - move_limit,
            box.north + move_limit,
        )
        total = 0
        first, last = rows_within(box.south, box.north, search)
        for row in range(first, last):
            low, high = range_beside_box(box, row, search)
            total += max(high - low, 0)
        longest = max(longest, total)
    most = 2 * VECTOR  # of single precision
    return (longest + most - 1) // most * most


@term
def copy_range(values: Array, target: Array, origin: float) -> None:
    """Copy a range of a field, minus its origin."""
    for k in range(values.size):
        target[k] = values[k] - origin


@term
def list_candidates(source: Array, targets: Indices, search: Search, candidates: Array) -> int:
    """Copy the sources that may be within reach of a block's targets to a list; return its length.

    Parameters
    ----------
    source : (>= n_fields, n_sources) sorted by cell; rows x, y [m], then others.
    targets : the targets of the block.
    candidates : (n_fields, longest list) the list; its rows are the first ones of `source`.
    """
    x_origin = source[0, targets[0]]
    y_origin = source[1, targets[0]]
    box = box_of(source, targets)
    n = 0
    first, last = rows_within(box.south, box.north, search)
    for row in range(first, last):
        low, high = range_beside_box(box, row, search)
        if high > low:
            end = n + high - low
            copy_range(source[0, low:high], candidates[0, n:end], x_origin)
            copy_range(source[1, low:high], candidates[1, n:end], y_origin)
            for f in range(2, candidates.shape[0]):
                copy_range(source[f, low:high], candidates[f, n:end], 0.0)
            n = end
    vector = VECTOR * source.itemsize // candidates.itemsize
    full = (n + vector - 1) // vector * vector
    for k in range(n, full):
        for f in range(candidates.shape[0]):
            candidates[f, k] = 0.0
        candidates[0, k] = FAR * (search.reach + box.east - box.west)
    return full
