"""The cell-linked list finds every pair, whatever the positions, cells and reach.

Blocks hold every target once, and their lists everything that a target may see.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sphrom.kernels import blocks
from sphrom.kernels.cells import Grid, Search, range_in_row, rows_within, sort_by_cell
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import Discretization
from sphrom.sph.neighbourhood import MOVE_RATIO, Neighbourhood

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


def sorted_places(position: np.ndarray, width: float, height: float):
    grid = grid_over(position, width, height)
    order, cell_start = sort_by_cell(position[0], position[1], grid)
    return np.ascontiguousarray(position[:, order]), grid, cell_start


def found(x: float, y: float, search: Search) -> set[int]:
    first, last = plain(rows_within)(y, y, search)
    ranges = [plain(range_in_row)(x, y, row, search) for row in range(first, last)]
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


@given(coordinates, sizes, sizes, st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(0.0, 2.5))
def test_every_pair_within_reach_is_found(position, width, height, x, y, reach) -> None:
    """Of the sources, and of a place anywhere: no index leaves the list."""
    place, grid, cell_start = sorted_places(position, width, height)
    for asking in (*place.T, (x, y)):
        distance = np.hypot(*(place - np.reshape(asking, (2, 1))))
        candidates = found(*asking, Search(*grid, cell_start, reach, 1.0))
        assert set(np.flatnonzero(distance < reach * (1.0 - 1e-12))) <= candidates
        assert candidates <= set(range(place.shape[1]))


@given(coordinates, sizes, sizes, st.integers(1, 5))
def test_every_target_is_in_one_block_of_one_row(position, width, height, every) -> None:
    place, grid, cell_start = sorted_places(position, width, height)
    targets = np.arange(0, place.shape[1], every)
    start = blocks.split_targets(targets, grid, cell_start)
    assert start[0] == 0
    assert start[-1] == targets.size
    assert np.all(np.diff(start) > 0)
    rows = ((place[1, targets] - grid.y_origin) / height).astype(int)
    columns = ((place[0, targets] - grid.x_origin) / width).astype(int)
    for low, high in pairwise(start):
        assert np.ptp(rows[low:high]) == 0
        assert np.ptp(columns[low:high]) < blocks.BLOCK_COLUMNS


@settings(max_examples=50)
@given(coordinates, sizes, sizes, st.floats(0.01, 2.5))
def test_a_list_holds_all_that_is_near_and_nothing_twice(position, width, height, reach) -> None:
    place, grid, cell_start = sorted_places(position, width, height)
    source = np.vstack((place, np.arange(1.0, place.shape[1] + 1.0)))
    targets = np.arange(place.shape[1])
    start = blocks.split_targets(targets, grid, cell_start)
    search = Search(*grid, cell_start, reach, 1.0)
    longest = blocks.longest_list(place, targets, start, search, 0.0)
    near = np.full((3, longest), np.nan)
    for low, high in pairwise(start):
        here = targets[low:high]
        length = blocks.list_candidates(source, here, search, near)
        assert length <= longest
        assert length % blocks.VECTOR == 0
        names = near[2, :length].astype(int)
        real = names > 0
        assert np.all(np.bincount(names[real]) <= 1)
        from_first = place[:, names[real] - 1] - place[:, here[:1]]
        assert np.array_equal(near[:2, :length][:, real], from_first)
        for j in here:
            offset = near[:2, :length] - (place[:, j] - place[:, here[0]])[:, None]
            distance = np.hypot(*offset)
            assert np.all(distance[~real] > reach)
            within = np.flatnonzero(
                np.hypot(*(place - place[:, j : j + 1])) < reach * (1.0 - 1e-12)
            )
            assert set(within) <= set(names[real] - 1)


@pytest.mark.parametrize("kind", ["even", "clumped"])
def test_no_list_is_longer_than_foreseen_wherever_particles_move(kind: str) -> None:
    """Up to the move at which the list is built anew."""
    spacing = 0.1
    random = np.random.default_rng(0)
    position = random.uniform(0.0, 1.0, (2, 200)) ** (1 if kind == "even" else 3)
    box = BoxDomain((0, 0), (1, 1), (True, True))
    neighbourhood = Neighbourhood(box, Discretization(spacing, 0.2), n_fields=2)
    neighbourhood.update(position)
    near = neighbourhood.sources
    longest = 0
    for seed in range(5):
        angle = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 200)
        step = 0.9999 * MOVE_RATIO * spacing * np.stack((np.cos(angle), np.sin(angle)))
        neighbourhood.update(position + step)
        assert neighbourhood.sources is near
        source = (position + step)[:, near.particle] + near.image
        candidates = np.empty((2, 20000))
        start = neighbourhood.block_start
        for low, high in pairwise(start):
            here = near.targets[low:high]
            length = blocks.list_candidates(source, here, neighbourhood.search, candidates)
            longest = max(longest, length)
    assert 0 < longest <= neighbourhood.scratch.shape[2]


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_what_a_target_may_come_near_to_is_foreseen_on_every_side(axis: int, side: float) -> None:
    """Sources that lie in a heap beyond its reach, but not beyond its reach and its move."""
    reach, limit = 1.0, 0.2
    position = np.zeros((2, 50))
    position[axis, 1:] = side * (reach + 0.9 * limit)
    place, grid, cell_start = sorted_places(position, 0.01, 0.01)
    (target,) = np.flatnonzero(place[axis] == 0.0)
    arguments = np.array([target]), np.array([0, 1]), Search(*grid, cell_start, reach, 1.0)
    still, moving = (blocks.longest_list(place, *arguments, m) for m in (0.0, limit))
    assert still < 50 <= moving
