"""Least squares with errors of a model: estimates, intervals, and what isn't determined."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.metrics.estimation import (
    SAME,
    Weights,
    history_variance,
    minima,
    nearly_as_good,
    uncertainty,
    undetermined_shares,
)

TIME = np.linspace(0.0, 1.0, 30)
TRUTH = np.array([0.3, 0.6])
NOISE = np.full(30, 0.01)
NOTHING = np.zeros((0, 30))
STARTS = [np.array([0.1, 0.9]), np.array([0.8, 0.2])]


def decay(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return an exponential with an amplitude, and its derivatives."""
    rate, amplitude = 1.0 + 3.0 * place[0], 0.5 + place[1]
    shape = np.exp(-rate * TIME)
    return amplitude * shape, np.stack([-3.0 * TIME * amplitude * shape, shape], axis=1)


def test_data_without_noise_give_the_parameters_from_every_start():
    found = minima(decay, decay(TRUTH)[0], Weights(NOISE, NOTHING), STARTS)
    assert len(found) == 1
    assert found[0].place == pytest.approx(TRUTH, abs=1e-8)
    assert (found[0].n_starts, found[0].converged, found[0].at_bound.any()) == (2, True, False)
    assert found[0].chi_square < 1e-10


@pytest.mark.parametrize("n_samples", [0, 3])
def test_weights_are_the_inverse_root_of_the_covariance(n_samples):
    rng = np.random.default_rng(0)
    samples, deviation = rng.normal(size=(n_samples, 30)), rng.uniform(0.1, 1.0, 30)
    whole = np.diag(deviation**2) + samples.T @ samples / max(1, n_samples)
    root = Weights(deviation, samples)(np.eye(30))
    assert root.T @ root == pytest.approx(np.linalg.inv(whole), rel=1e-9, abs=1e-9)
    slopes = decay(TRUTH)[1]
    inverse = np.linalg.inv(whole)
    expected = np.linalg.solve(slopes.T @ inverse @ slopes, slopes.T @ inverse)
    assert Weights(deviation, samples).gain(slopes) == pytest.approx(expected, rel=1e-8, abs=1e-10)


def test_the_chi_square_of_model_errors_is_that_of_each_by_the_others() -> None:
    rng, n = np.random.default_rng(3), 3
    deviation, samples = rng.uniform(0.5, 2.0, 8), rng.standard_normal((n, 8))
    each = []
    for k in range(n):
        others = np.delete(samples, k, axis=0)
        covariance = np.diag(deviation**2) + others.T @ others / (n - 1)
        each.append(samples[k] @ np.linalg.solve(covariance, samples[k]))
    assert Weights(deviation, samples).expected == pytest.approx(np.mean(each), rel=1e-9)
    assert Weights(deviation, samples[:0]).expected == 0.0


def test_intervals_by_noise_cover_the_truth():
    rng, weights = np.random.default_rng(1), Weights(NOISE, NOTHING)
    inside, chi_squares = np.zeros(2), []
    for _ in range(300):
        data = decay(TRUTH)[0] + NOISE * rng.normal(size=30)
        (found,) = minima(decay, data, weights, [TRUTH])
        known = uncertainty(found.derivatives, weights)
        inside += np.abs(found.place - TRUTH) <= known.half_width
        chi_squares.append(found.chi_square)
    assert inside / 300 == pytest.approx(0.95, abs=0.04)  # 0.95 and 0.96
    assert np.mean(chi_squares) == pytest.approx(28.0, rel=0.05)


def test_intervals_cover_with_errors_of_the_model_and_do_not_without():
    """Errors have two shapes over time, of random sizes; five samples of them are known."""
    rng = np.random.default_rng(2)
    shapes = 0.05 * np.stack([np.sin(4.0 * TIME), TIME**2])
    inside, alone = np.zeros(2), np.zeros(2)
    for _ in range(300):
        samples = rng.normal(size=(5, 2)) @ shapes
        data = decay(TRUTH)[0] + rng.normal(size=2) @ shapes + NOISE * rng.normal(size=30)
        for weights, count in ((Weights(NOISE, samples), inside), (Weights(NOISE, NOTHING), alone)):
            (found,) = minima(decay, data, weights, [TRUTH])
            known = uncertainty(found.derivatives, weights)
            count += np.abs(found.place - TRUTH) <= known.half_width
    assert (inside / 300 >= 0.90).all()
    assert (alone / 300 <= 0.7).all()


def test_a_sample_is_judged_by_weights_that_do_not_know_it():
    samples = np.stack([np.sin(4.0 * TIME), np.cos(4.0 * TIME)])
    weights = Weights(NOISE, samples)
    known = uncertainty(decay(TRUTH)[1], weights)
    for k, other in ((0, 1), (1, 0)):
        gain = Weights(NOISE, samples[[other]]).gain(decay(TRUTH)[1])
        assert known.biases[k] == pytest.approx(gain @ samples[k], rel=1e-9)
    assert known.model == pytest.approx(known.biases.T @ known.biases / 2, rel=1e-12)


def ratio(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values that the sum of both places determines, and nothing else."""
    return (place[0] + place[1]) * TIME, np.stack([TIME, TIME], axis=1)


def test_a_combination_that_the_data_do_not_determine_is_found():
    weights = Weights(NOISE, NOTHING)
    found = minima(ratio, ratio(TRUTH)[0], weights, STARTS)[0]
    known = uncertainty(found.derivatives, weights)
    assert found.place.sum() == pytest.approx(0.9, abs=1e-6)
    assert known.undetermined == pytest.approx(np.array([[0.5, -0.5], [-0.5, 0.5]]), rel=1e-6)
    assert np.diag(known.covariance) == pytest.approx(0.5, rel=2e-2)
    assert known.correlation[0, 1] == pytest.approx(-1.0, abs=1e-3)


def test_a_parameter_without_effect_has_the_width_of_its_range():
    slopes = np.stack([TIME, np.zeros(30)], axis=1)
    known = uncertainty(slopes, Weights(NOISE, NOTHING))
    assert known.covariance[1, 1] == 1.0
    assert known.undetermined == pytest.approx(np.diag([0.0, 1.0]))


def curve(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return values that determine x0 + x1^2 only: equally good fits lie on a parabola."""
    return (place[0] + place[1] ** 2) * TIME, np.stack([TIME, 2.0 * place[1] * TIME], axis=1)


@pytest.mark.parametrize("seed", range(3))
def test_rounding_decides_nothing_among_equally_good_fits(seed):
    """The fits are exact, so that their order by chi^2 is one of rounding errors."""
    weights = Weights(NOISE, NOTHING)
    starts = [np.array(place) for place in ((0.1, 0.9), (0.8, 0.2), (0.4, 0.4), (0.3, 0.02))]
    expected = minima(curve, curve(TRUTH)[0], weights, starts)
    data = curve(TRUTH)[0] + 1e-9 * np.random.default_rng(seed).normal(size=30)
    found = minima(curve, data, weights, starts)
    assert len(found) == len(expected) == len(nearly_as_good(found)) == 4
    for one, other in zip(found, expected, strict=True):
        assert one.place == pytest.approx(other.place, abs=1e-6)
    shares = undetermined_shares(found, weights)
    assert shares == pytest.approx(undetermined_shares(expected, weights), abs=1e-6)
    assert 0.05 < shares[0] < 0.95


def test_a_worse_fit_counts_by_its_likelihood():
    """Two isolated minima: the better one is first, and a start beside it adds to it."""

    def fold(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = place[0] - 0.5
        return (x**2 + 0.005 * x) * np.ones(30), np.full((30, 1), 2.0 * x + 0.005)

    data = np.full(30, 0.0425)
    starts = [np.array([0.2]), np.array([0.9]), np.array([0.9 + 0.1 * SAME])]
    weights = Weights(NOISE, NOTHING)
    found = minima(fold, data, weights, starts)
    assert [each.n_starts for each in found] == [1, 2]
    assert len(nearly_as_good(found)) == 2
    assert undetermined_shares(found, weights) == pytest.approx([0.0])


def test_an_estimate_beyond_the_box_is_on_its_bound():
    data, _ = decay(np.array([0.5, 1.2]))
    found = minima(decay, data, Weights(NOISE, NOTHING), STARTS)[0]
    assert list(found.at_bound) == [False, True]


def test_places_without_values_are_avoided():
    def partly(place: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        return None if place[0] > 0.5 else decay(place)

    found = minima(partly, decay(TRUTH)[0], Weights(NOISE, NOTHING), STARTS)
    assert [each.n_starts for each in found] == [1]
    assert found[0].place == pytest.approx(TRUTH, abs=1e-7)
    assert minima(lambda place: None, TIME, Weights(NOISE, NOTHING), STARTS) == []


def test_the_variance_of_histories_has_what_the_fit_could_not_take_up():
    _, slopes = decay(TRUTH)
    samples = 0.1 * np.stack([slopes[:, 0], np.sin(9.0 * TIME)])
    known = uncertainty(slopes, Weights(NOISE, NOTHING))
    by_noise = history_variance(slopes, known, NOTHING)
    assert by_noise.max() < NOISE[0] ** 2
    known = uncertainty(slopes, Weights(NOISE, samples))
    whole = history_variance(slopes, known, samples)
    assert whole[5] > 1e-4
    assert (whole >= history_variance(slopes, known, samples[:0]) - 1e-15).all()
