"""Probe points: where they stand and in which order."""

from __future__ import annotations

import numpy as np

from sphrom.metrics.measures import grid_points, spread


def test_points_are_spread_over_intervals_by_their_lengths() -> None:
    np.testing.assert_allclose(
        spread([(0.0, 1.0), (3.0, 4.0), (5.0, 7.0)], 8),
        [0.25, 0.75, 3.25, 3.75, 5.25, 5.75, 6.25, 6.75],
    )


def test_grid_runs_by_rows_from_below() -> None:
    points = grid_points((0.0, 0.0), (3.0, 1.0), (2, 3)).reshape(2, 3, 2)
    np.testing.assert_allclose(points[..., 0], [[0.5, 1.5, 2.5]] * 2)
    np.testing.assert_allclose(points[..., 1], [[0.25] * 3, [0.75] * 3])
