"""The cell-linked list (Alg. 3.2): particles sorted by cell, so that a row of cells is contiguous.

Cells are much smaller than the support. A particle's neighbours in one row of cells are then one
contiguous range of the sorted sources, over which the compiler can vectorise, and few candidates
are outside the support. Sources are the particles themselves and their periodic images.

Cells are numbered row by row, and `cell_start[c]` is the first sorted source of cell c.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sphrom.kernels.jit import serial, term


class Grid(NamedTuple):
    """The cells, in [m]; only scalars, so that compiled threads can share it."""

    x_origin: float
    y_origin: float
    cell_width: float
    cell_height: float
    n_columns: int
    n_rows: int


@serial
def sort_by_cell(
    x: NDArray[np.float64], y: NDArray[np.float64], grid: Grid
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the order (n_sources,) that sorts sources by cell, and `cell_start` (n_cells + 1,).

    The counting sort is stable: sources of one cell keep their order.
    """
    n_columns = grid.n_columns
    n_rows = grid.n_rows
    cell = np.empty(x.size, np.int64)
    cell_start = np.zeros(n_columns * n_rows + 1, np.int64)
    for k in range(x.size):
        column = min(max(int((x[k] - grid.x_origin) / grid.cell_width), 0), n_columns - 1)
        row = min(max(int((y[k] - grid.y_origin) / grid.cell_height), 0), n_rows - 1)
        cell[k] = row * n_columns + column
        cell_start[cell[k] + 1] += 1
    for c in range(n_columns * n_rows):
        cell_start[c + 1] += cell_start[c]
    following = cell_start[:-1].copy()
    order = np.empty(x.size, np.int64)
    for k in range(x.size):
        order[following[cell[k]]] = k
        following[cell[k]] += 1
    return order, cell_start


class Search(NamedTuple):
    """The cells with the sources in them, and how far to search.

    It repeats the fields of the grid, because compiled threads can share no records of records.
    """

    x_origin: float
    y_origin: float
    cell_width: float
    cell_height: float
    n_columns: int
    n_rows: int
    cell_start: NDArray[np.int64]
    reach: float
    """[m]"""
    inverse_length: float
    """1/h [1/m]."""


@term
def rows_within(south: float, north: float, search: Search) -> tuple[int, int]:
    """Return the first row of cells within reach of a range of y, and one past the last."""
    first = math.floor((south - search.reach - search.y_origin) / search.cell_height)
    last = math.floor((north + search.reach - search.y_origin) / search.cell_height)
    return max(first, 0), min(last + 1, search.n_rows)


class Box(NamedTuple):
    """The least and the largest x and y [m]."""

    west: float
    east: float
    south: float
    north: float


@term
def range_beside_box(box: Box, row: int, search: Search) -> tuple[int, int]:
    """Return the range of sorted sources in a row of cells that may lie within reach of a box."""
    low = search.y_origin + row * search.cell_height
    gap = max(0.0, max(low - box.north, box.south - low - search.cell_height))
    half = math.sqrt(max(search.reach * search.reach - gap * gap, 0.0))
    first = math.floor((box.west - half - search.x_origin) / search.cell_width)
    last = math.floor((box.east + half - search.x_origin) / search.cell_width)
    base = row * search.n_columns
    # A position may be beyond the sources on either side.
    first = min(max(first, 0), search.n_columns)
    last = min(max(last, -1), search.n_columns - 1)
    return search.cell_start[base + first], search.cell_start[base + last + 1]


@term
def range_in_row(x: float, y: float, row: int, search: Search) -> tuple[int, int]:
    """Return the range of sorted sources in a row of cells that may lie within reach of (x, y)."""
    return range_beside_box(Box(x, x, y, y), row, search)
