"""Quantiles with intervals, where the truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from sphrom.metrics.draws import fewest_runs, ranks, spread

LEVELS = (0.05, 0.5, 0.95)


def drawn(n_runs: int, seed: int) -> np.ndarray:
    """Outputs of a linear model of two normal parameters: normal (1, 5)."""
    x = np.random.default_rng(seed).standard_normal((n_runs, 2))
    return (1.0 + x @ [3.0, 4.0])[:, None]


def test_quantiles_are_those_of_numpy():
    values = drawn(1000, 1)
    found = spread(values, None, LEVELS).quantiles
    np.testing.assert_allclose(found, np.quantile(values, LEVELS, axis=0), rtol=1e-13)


def test_ranks_are_quantiles_of_the_binomial_distribution():
    for n_runs, level in ((100, 0.05), (777, 0.5), (10_000, 0.95)):
        low, high = stats.binom.ppf([0.025, 0.975], n_runs, level)
        assert ranks(n_runs, level) == (low - 1, high)


def test_intervals_cover_the_truth_as_often_as_they_say():
    """Measured: 95.0 to 96.6 % of 1,000 samples of 200 runs; the mean's and deviation's 94 %."""
    truth = stats.norm(1, 5).ppf(LEVELS)[:, None]
    covered, means, deviations = np.zeros((3, 1)), 0, 0
    for seed in range(1000):
        found = spread(drawn(200, seed), None, LEVELS)
        covered += (found.interval[0] <= truth) & (truth <= found.interval[1])
        means += abs(found.mean[0] - 1.0) <= np.ptp(found.mean_interval) / 2
        low, high = found.deviation_interval[:, 0]
        deviations += low <= 5.0 <= high
    assert np.all((covered >= 940) & (covered <= 980))
    assert 930 <= means <= 970
    assert 915 <= deviations <= 970


@pytest.mark.parametrize("share", [1.0, -1.0, 0.5])
def test_the_models_error_widens_intervals_until_they_hold_the_truth(share):
    """A model that is wrong by as much as it says, or less; of 300 samples of 2,000 runs."""
    truth = stats.norm(1, 5).ppf(LEVELS)[:, None]
    hold, without = 0, 0
    for seed in range(300):
        exact = drawn(2000, seed)
        errors = 0.3 + 0.2 * np.abs(exact)
        found = spread(exact + share * errors, errors, LEVELS)
        hold += bool(np.all((found.interval[0] <= truth) & (truth <= found.interval[1])))
        low, high = found.sampling_interval
        without += bool(np.all((low <= truth) & (truth <= high)))
        assert found.mean_interval[0, 0] <= 1.0 + 3.5 * 5.0 / np.sqrt(2000)
        assert found.deviation_interval[0, 0] <= 5.3
        assert found.deviation_interval[1, 0] >= 4.7
    assert hold >= 0.9 * 300
    assert without <= 3


def test_too_few_runs_have_no_interval():
    fewest = fewest_runs((0.05, 0.5))
    assert fewest == 72
    assert ranks(fewest, 0.05)[0] == 0
    with pytest.raises(ValueError, match=r"71 runs are too few for .* the quantile 0\.05"):
        ranks(71, 0.05)
    assert ranks(72, 0.95)[1] == 71
    with pytest.raises(ValueError, match="too few"):
        spread(drawn(60, 0), None, LEVELS)


def test_a_constant_has_an_interval_of_no_width():
    found = spread(np.full((100, 2), 3.0), None, LEVELS)
    assert np.all(found.interval == 3.0)
    assert np.all(found.deviation_interval == 0.0)
