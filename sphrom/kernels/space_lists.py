"""Cells and lists of candidates in three dimensions: layers of rows of cells (see `blocks`).

Cells are numbered row by row and layer by layer. A row of cells is contiguous, as in a plane, so
blocks are the targets in a few neighbouring cells of one row.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.kernels.blocks import FAR, VECTOR, copy_range
from sphrom.kernels.jit import serial, term


class SpaceGrid(NamedTuple):
    """The cells of a three-dimensional box."""

    origin: Array
    """(3,) [m]."""
    size: Array
    """(3,) edges of a cell [m]."""
    shape: Indices
    """(3,) numbers of cells."""

    @classmethod
    def around(cls, place: Array, size: Array) -> SpaceGrid:
        """Return the cells of a size (3,) [m] that contain places (3, n_sources) [m]."""
        origin = place.min(axis=1)
        extent = place.max(axis=1) - origin
        return cls(origin, size, (extent / size).astype(np.int64) + 1)


class SpaceSearch(NamedTuple):
    """The cells with the sources in them, and how far to search (compare `cells.Search`)."""

    origin: Array
    size: Array
    shape: Indices
    cell_start: Indices
    """(n_cells + 1,) the first source of each cell."""
    reach: float
    """[m]"""
    inverse_length: float
    """1/h [1/m]."""


@serial
def sort_by_space_cell(place: Array, grid: SpaceGrid) -> tuple[Indices, Indices]:
    """Return the stable order (n_sources,) of sources by cell, and `cell_start` (n_cells + 1,)."""
    n_sources = place.shape[1]
    cell = np.empty(n_sources, np.int64)
    cell_start = np.zeros(grid.shape[0] * grid.shape[1] * grid.shape[2] + 1, np.int64)
    for k in range(n_sources):
        number = 0
        for axis in range(2, -1, -1):
            along = int((place[axis, k] - grid.origin[axis]) / grid.size[axis])
            along = min(max(along, 0), grid.shape[axis] - 1)
            number = number * grid.shape[axis] + along
        cell[k] = number
        cell_start[number + 1] += 1
    for c in range(cell_start.size - 1):
        cell_start[c + 1] += cell_start[c]
    following = cell_start[:-1].copy()
    order = np.empty(n_sources, np.int64)
    for k in range(n_sources):
        order[following[cell[k]]] = k
        following[cell[k]] += 1
    return order, cell_start


@term
def range_of(source: Array, axis: int, targets: Indices) -> tuple[float, float]:
    """Return the least and the largest coordinate of some targets along an axis [m]."""
    low = source[axis, targets[0]]
    high = low
    for t in range(1, targets.size):
        place = source[axis, targets[t]]
        low = min(low, place)
        high = max(high, place)
    return low, high


@term
def cells_within(low: float, high: float, axis: int, search: SpaceSearch) -> tuple[int, int]:
    """Return the first cell along an axis within reach of a range, and one past the last."""
    first = math.floor((low - search.reach - search.origin[axis]) / search.size[axis])
    last = math.floor((high + search.reach - search.origin[axis]) / search.size[axis])
    return max(first, 0), min(last + 1, search.shape[axis])


@term
def gap_to(low: float, high: float, number: int, axis: int, search: SpaceSearch) -> float:
    """Return the distance [m] of a range from the cells with a number along an axis."""
    begin = search.origin[axis] + number * search.size[axis]
    return max(0.0, max(begin - high, low - begin - search.size[axis]))


@term
def sources_in_row(
    west: float, east: float, square: float, row: int, layer: int, search: SpaceSearch
) -> tuple[int, int]:
    """Return the range of sources in a row of cells that may lie within reach of a range of x.

    `square` is the squared distance of the row from the places [m2].
    """
    left = search.reach * search.reach - square
    if left <= 0.0:
        return 0, 0
    half = math.sqrt(left)
    first = math.floor((west - half - search.origin[0]) / search.size[0])
    last = math.floor((east + half - search.origin[0]) / search.size[0])
    base = (layer * search.shape[1] + row) * search.shape[0]
    low = search.cell_start[base + min(max(first, 0), search.shape[0])]
    return low, search.cell_start[base + min(max(last, -1), search.shape[0] - 1) + 1]


@term
def list_space_candidates(
    source: Array, targets: Indices, search: SpaceSearch, candidates: Array
) -> int:
    """Copy the sources that may be within reach of a block's targets to a list; return its length.

    Parameters
    ----------
    source : (>= n_fields, n_sources) sorted by cell; rows x, y, z [m], then others.
    targets : the targets of the block.
    candidates : (n_fields, longest list) the list; with no columns, only count.
    """
    west, east = range_of(source, 0, targets)
    south, north = range_of(source, 1, targets)
    back, front = range_of(source, 2, targets)
    first_row, last_row = cells_within(south, north, 1, search)
    first_layer, last_layer = cells_within(back, front, 2, search)
    n = 0
    for layer in range(first_layer, last_layer):
        behind = gap_to(back, front, layer, 2, search)
        for row in range(first_row, last_row):
            below = gap_to(south, north, row, 1, search)
            square = below * below + behind * behind
            low, high = sources_in_row(west, east, square, row, layer, search)
            if high > low:
                end = n + high - low
                if candidates.shape[1] > 0:
                    for f in range(candidates.shape[0]):
                        origin = source[f, targets[0]] if f < 3 else 0.0
                        copy_range(source[f, low:high], candidates[f, n:end], origin)
                n = end
    full = (n + VECTOR - 1) // VECTOR * VECTOR
    if candidates.shape[1] > 0:
        for k in range(n, full):
            for f in range(candidates.shape[0]):
                candidates[f, k] = 0.0
            candidates[0, k] = FAR * (search.reach + east - west)
    return full


@serial
def longest_space_list(
    place: Array, targets: Indices, block_start: Indices, search: SpaceSearch
) -> tuple[int, int]:
    """Return the length of the longest list, and the number of candidates of all targets."""
    nothing = np.empty((1, 0))
    longest = 0
    total = 0
    for b in range(block_start.size - 1):
        here = targets[block_start[b] : block_start[b + 1]]
        n = list_space_candidates(place, here, search, nothing)
        longest = max(longest, n)
        total += n * here.size
    return longest, total
