"""The cell-linked list finds every pair, whatever the positions, cells and reach."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sphrom.kernels.cells import Grid, range_in_row, rows_within, sort_by_cell

coordinates = arrays(
    np.float64, st.tuples(st.just(2), st.integers(1, 40)), elements=st.floats(-1.0, 1.0, width=32)
)
sizes = st.floats(0.05, 3.0)


def plain(function):
    """Return the function as it was before it was compiled: it checks its indices."""
    return getattr(function, "py_func", function)


def grid_over(position: np.ndarray, width: float, height: float) -> Grid:
    low, high = position.min(axis=1), position.max(axis=1)
    columns, rows = ((high - low) / (width, height)).astype(int) + 1
    return Grid(float(low[0]), float(low[1]), width, height, int(columns), int(rows))


def found(x: float, y: float, reach: float, grid: Grid, cell_start: np.ndarray) -> set[int]:
    first, last = plain(rows_within)(y, y, reach, grid)
    ranges = [plain(range_in_row)(x, y, r, reach, grid, cell_start) for r in range(first, last)]
    return {k for low, high in ranges for k in range(low, high)}


@given(coordinates, sizes, sizes)
def test_sorts_by_cell_and_keeps_the_order_within(position, width, height) -> None:
    grid = grid_over(position, width, height)
    order, cell_start = sort_by_cell(position[0], position[1], grid)
    assert sorted(order) == list(range(position.shape[1]))
    assert cell_start[0] == 0
    assert cell_start[-1] == position.shape[1]
    for cell in range(cell_start.size - 1):
        here = order[cell_start[cell] : cell_start[cell + 1]]
        row, column = divmod(cell, grid.n_columns)
        assert np.all(np.diff(here) > 0)
        assert np.all(((position[0, here] - grid.x_origin) / width).astype(int) == column)
        assert np.all(((position[1, here] - grid.y_origin) / height).astype(int) == row)


@given(coordinates, sizes, sizes, st.floats(0.0, 2.5))
def test_every_pair_within_reach_is_found(position, width, height, reach) -> None:
    grid = grid_over(position, width, height)
    order, cell_start = sort_by_cell(position[0], position[1], grid)
    x, y = position[:, order]
    for i in range(x.size):
        near = np.flatnonzero(np.hypot(x - x[i], y - y[i]) < reach * (1.0 - 1e-12))
        assert set(near) <= found(x[i], y[i], reach, grid, cell_start)


@given(coordinates, sizes, sizes, st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(0.0, 2.5))
def test_any_position_may_ask(position, width, height, x, y, reach) -> None:
    """Also one far from all sources, on any side: no index leaves the list."""
    grid = grid_over(position, width, height)
    order, cell_start = sort_by_cell(position[0], position[1], grid)
    distance = np.hypot(position[0, order] - x, position[1, order] - y)
    near = np.flatnonzero(distance < reach * (1.0 - 1e-12))
    candidates = found(x, y, reach, grid, cell_start)
    assert set(near) <= candidates
    assert candidates <= set(range(position.shape[1]))
