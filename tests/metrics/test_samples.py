"""Probe points: where they stand and in which order."""

from __future__ import annotations

import numpy as np

from sphrom.metrics.grids import Slices, grid_points, spread


def test_points_are_spread_over_intervals_by_their_lengths() -> None:
    np.testing.assert_allclose(
        spread([(0.0, 1.0), (3.0, 4.0), (5.0, 7.0)], 8),
        [0.25, 0.75, 3.25, 3.75, 5.25, 5.75, 6.25, 6.75],
    )


def test_grid_runs_by_rows_from_below() -> None:
    points = grid_points((0.0, 0.0), (3.0, 1.0), (2, 3)).reshape(2, 3, 2)
    np.testing.assert_allclose(points[..., 0], [[0.5, 1.5, 2.5]] * 2)
    np.testing.assert_allclose(points[..., 1], [[0.25] * 3, [0.75] * 3])


def test_a_grid_in_space_runs_along_x_first_and_z_last() -> None:
    points = grid_points((0.0, 0.0, 1.0), (3.0, 1.0, 5.0), (2, 1, 3)).reshape(2, 1, 3, 3)
    np.testing.assert_allclose(points[1, 0, :, 0], [0.5, 1.5, 2.5])
    np.testing.assert_allclose(points[:, 0, 2], [[2.5, 0.5, 2.0], [2.5, 0.5, 4.0]])


def test_slices_lie_side_by_side() -> None:
    slices = Slices((0.0, -1.0, 2.0), (2.0, 1.0, 3.0))
    np.testing.assert_allclose(slices.extent, (0.0, 3.12, -1.0, 2.12))
    shown = np.array([[0.5, 0.25], [2.62, 0.25], [0.5, 1.37], [2.06, 0.25], [2.62, 1.37]])
    expected = [[0.5, 0.25, 2.5], [1.0, 0.25, 2.5], [0.5, 0.0, 2.25], [np.nan] * 3, [np.nan] * 3]
    np.testing.assert_allclose(slices.places(shown), expected)
    places, numbers = slices.ticks(0)
    np.testing.assert_allclose(places, [0.0, 1.0, 2.12, 2.62, 3.12])
    assert numbers == ["0", "1", "2", "2.5", "3"]
