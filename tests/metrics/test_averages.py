"""Moving averages: what they keep, and what they take out."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.metrics.series import hat, moving_average


@pytest.mark.parametrize("n_half", [1, 2, 7])
def test_a_hat_is_symmetric_and_sums_up_to_one(n_half):
    weights = hat(n_half)
    assert weights.shape == (2 * n_half - 1,)
    assert weights.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(weights, weights[::-1])
    assert weights.argmax() == n_half - 1


def test_straight_lines_are_kept():
    values = np.stack([np.arange(20.0), 3.0 - 2.0 * np.arange(20.0)], axis=1)
    np.testing.assert_allclose(moving_average(values, hat(4)), values[3:-3])


@pytest.mark.parametrize("period", [8.0, 4.0, 8.0 / 3.0])
def test_oscillations_that_fit_into_half_the_hat_are_lost(period):
    wave = np.cos(2.0 * np.pi * np.arange(100) / period + 0.3)
    np.testing.assert_allclose(moving_average(wave, hat(8)), 0.0, atol=1e-12)


def test_averages_are_those_of_numpy_for_any_shape():
    values = np.random.default_rng(1).random((12, 3, 2))
    found = moving_average(values, hat(3))
    assert found.shape == (8, 3, 2)
    expected = np.convolve(values[:, 1, 0], hat(3), "valid")
    np.testing.assert_allclose(found[:, 1, 0], expected)


def test_series_shorter_than_the_weights_are_refused():
    with pytest.raises(ValueError, match="window"):
        moving_average(np.zeros(4), hat(3))
