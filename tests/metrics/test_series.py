"""Series: fitted rates and frequencies, moving averages, kinetic energy by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphrom.metrics.series import (
    dominant_frequency,
    exponential_rate,
    hat,
    kinetic_energy,
    moving_average,
    oscillation,
    oscillation_beside,
    pole_of,
    settled_from,
    shortest_period,
)


@given(rate=st.floats(-50.0, 5.0), constant=st.floats(1e-6, 1e6))
def test_rate_of_an_exponential(rate: float, constant: float) -> None:
    time = np.linspace(0.0, 1.0, 20)
    assert exponential_rate(time, constant * np.exp(rate * time)) == pytest.approx(rate, abs=1e-9)


@pytest.mark.parametrize(
    ("time", "value", "word"),
    [([0.1, 0.2], [1.0, np.nan], "positive"), ([0.1, 0.2], [0.0, 1.0], "positive"),
     ([0.1, 0.1], [1.0, 2.0], "two different"), ([0.1, 0.2], [1.0], "as many")],
)  # fmt: skip
def test_fits_without_meaning_are_refused(time, value, word) -> None:
    with pytest.raises(ValueError, match=word):
        exponential_rate(np.array(time), np.array(value))


def test_kinetic_energy_of_snapshots() -> None:
    velocity = np.array([[[3.0, 4.0], [0.0, 2.0]], [[0.0, 0.0], [1.0, 0.0]]])
    np.testing.assert_allclose(kinetic_energy(velocity, 2.0), [29.0, 1.0])
    np.testing.assert_allclose(kinetic_energy(velocity, np.array([2.0, 4.0])), [33.0, 2.0])


@given(
    frequency=st.floats(4.0, 5.0),
    phase=st.floats(0.0, 2.0 * np.pi),
    trend=st.floats(-3.0, 3.0),
    n_samples=st.integers(60, 300),
)
def test_frequency_of_a_record_of_some_periods(
    frequency: float, phase: float, trend: float, n_samples: int
) -> None:
    """Whatever the phase and the trend, to far less than the one period that a record resolves."""
    time = 5.0 + np.linspace(0.0, 1.0, n_samples)
    signal = 2.0 + trend * time + np.sin(2.0 * np.pi * frequency * time + phase)
    assert dominant_frequency(time, signal) == pytest.approx(frequency, rel=2e-3)


def test_the_strongest_of_several_frequencies_is_found_beneath_noise() -> None:
    time = np.linspace(0.0, 1.0, 201)
    noise = 0.1 * np.random.default_rng(0).normal(size=time.size)
    harmonics = np.sin(29.2 * time) + 0.4 * np.sin(58.4 * time + 1.0)
    assert dominant_frequency(time, harmonics + noise) == pytest.approx(
        29.2 / 2.0 / np.pi, rel=5e-3
    )


TIME = np.linspace(0.0, 1.0, 100)


@pytest.mark.parametrize(
    ("time", "signal", "word"),
    [
        (TIME, np.full(100, 3.3), "no oscillation"),
        (TIME, TIME**2, "no oscillation"),
        (TIME, np.sin(8.0 * TIME), "no oscillation"),
        (np.arange(7.0), np.arange(7.0), "samples"),
        (np.arange(20.0) ** 2, np.arange(20.0), "samples"),
        (np.arange(20.0), np.full(20, np.nan), "samples"),
    ],
    ids=["constant", "curved", "less than two periods", "short", "uneven", "not finite"],
)
def test_a_record_without_two_periods_or_a_spectrum_has_no_frequency(time, signal, word) -> None:
    with pytest.raises(ValueError, match=word):
        dominant_frequency(time, signal)


@pytest.mark.parametrize("period", [8.0, 4.0, 8.0 / 3.0])
def test_oscillations_that_fit_into_half_the_hat_are_lost(period):
    wave = np.cos(2.0 * np.pi * np.arange(100) / period + 0.3)
    np.testing.assert_allclose(moving_average(wave, hat(8)), 0.0, atol=1e-12)


def test_averages_are_those_of_numpy_for_any_shape():
    values = np.random.default_rng(1).random((12, 3, 2))
    expected = np.convolve(values[:, 1, 0], hat(3), "valid")
    np.testing.assert_allclose(moving_average(values, hat(3))[:, 1, 0], expected)


def wave(time, frequency, growth=0.0):
    """Return a signal of amplitude 0.7 about 1.2, with harmonics and growth over time."""
    turns = 2.0 * np.pi * frequency * (time - time[0])
    harmonics = 0.3 * np.cos(2.0 * turns + 2.0) + 0.1 * np.cos(3.0 * turns)
    return 1.2 + 0.7 * np.exp(growth * (time - time[0])) * np.cos(turns + 1.0) + harmonics


@given(st.floats(0.2, 5.0), st.floats(3.2, 30.0), st.integers(12, 90))
def test_figures_of_an_oscillation_with_harmonics(frequency, n_periods, per_period) -> None:
    time = 3.0 + np.arange(0.0, n_periods / frequency, 1.0 / (frequency * per_period))
    found = oscillation(time, wave(time, frequency))
    assert found["frequency"] == pytest.approx(frequency, rel=1e-5)
    assert (found["amplitude"], found["mean"]) == pytest.approx((0.7, 1.2), rel=1e-4)
    assert max(found["frequency_scatter"] / frequency, found["amplitude_scatter"]) < 1e-3


def test_an_oscillation_that_grows_or_is_noisy() -> None:
    """Growth changes no frequency; noise changes it by far less than the scatter of a period."""
    time = np.linspace(0.0, 20.0, 401)
    grown = oscillation(time, wave(time, 1.0, growth=0.05))
    sizes = 0.7 * np.exp(0.05 * np.linspace(1.0, 19.0, 1000))
    figures = [grown[name] for name in ("frequency", "amplitude", "amplitude_scatter")]
    assert figures == pytest.approx([1.0, sizes.mean(), sizes.std()], rel=2e-3)
    noise = 0.1 * np.random.default_rng(2).normal(size=401)
    found = oscillation(time, wave(time, 1.0) + noise)
    assert found["frequency"] == pytest.approx(1.0, abs=1e-3)
    assert 1e-3 < found["frequency_scatter"] < 0.02


@pytest.mark.parametrize("signal", [np.full(100, 3.3), TIME, np.exp(-TIME), np.sin(15.0 * TIME)])
def test_a_record_without_three_periods_has_a_mean_alone(signal) -> None:
    assert oscillation(TIME, signal) == {"mean": signal.mean()}
    full = np.sin(40.0 * TIME)
    error = abs(signal.mean() - oscillation(TIME, full)["mean"])
    found = oscillation_beside(TIME, signal, full)
    assert found == {"mean": signal.mean(), "mean_error": pytest.approx(error)}


@pytest.mark.parametrize(
    ("driving", "end"),
    [
        (np.minimum(TIME, 0.5), 0.5),
        (1.0 - np.exp(-20.0 * TIME), np.log(1000.0) / 20.0),
        (np.minimum(TIME, 0.5) * [[1.0], [2.0]], 0.5),
        (np.ones(100), 0.0),  # starts at once
        (0.0 * TIME, 0.0),
        (TIME, 0.0),  # never keeps its value
        (1.0 + np.sin(40.0 * TIME), 0.0),
        (np.exp(-20.0 * TIME), 0.0),  # falls
    ],
)
def test_the_end_of_a_gradual_start(driving, end) -> None:
    assert settled_from(TIME, np.atleast_2d(driving)) == pytest.approx(end, abs=0.011)


@pytest.mark.parametrize("mean", [TIME**2, np.exp(-3.0 * TIME), np.tanh(2.0 * TIME)])
def test_a_mean_that_changes_by_more_hides_no_oscillation(mean) -> None:
    found = oscillation(TIME, mean + 0.02 * np.sin(60.0 * TIME))
    figures = found["frequency"], found["amplitude"]
    assert figures == pytest.approx((30.0 / np.pi, 0.02), rel=1e-2)


def test_errors_of_an_oscillation_and_its_phase_at_the_end() -> None:
    time = np.linspace(0.0, 50.0, 2001)
    found = oscillation_beside(time, 1.1 * wave(time, 0.98), wave(time, 1.0))
    errors = [found[f"{name}_error"] for name in ("frequency", "amplitude")]
    assert errors == pytest.approx([2.0, 10.0], rel=1e-3)
    # A period before the end it is 2 % of 49 periods behind.
    assert found["phase_error"] == pytest.approx(-360.0 * 0.02 * 49.0, abs=0.5)


@pytest.mark.parametrize("rate", [20.0, 659.7, 3e4, 1e6])
def test_the_shortest_period_of_oscillations(rate: float) -> None:
    period = 2.0 * np.pi / rate
    for signal, shortest in (
        (lambda t: 0.1 * np.cos(rate * t), period),
        (lambda t: np.cos(rate * t) ** 2, 0.5 * period),
        (lambda t: np.where(np.sin(rate * t) > 0.0, 1.0, -1.0), period),
        (lambda t: np.sin(t) + 0.2 * np.sin(rate * t), period),
        (lambda t: np.stack((0.0 * t, np.sin(rate * t))), period),
    ):
        assert shortest_period(signal, 4.0) == pytest.approx(shortest, rel=0.02)
    # A burst at the start, and one somewhere that is not too short.
    assert shortest_period(lambda t: np.where(t < 5.0 * period, np.cos(rate * t), 0.0), 4.0) < (
        1.1 * period
    )


def test_what_is_no_oscillation() -> None:
    for signal in (
        np.zeros_like,
        np.exp,
        lambda t: np.where(t < 1.0, 0.0, 1.0),
        lambda t: np.where(np.abs(t - 1.0) < 0.01, 1.0, 0.0),
        lambda t: np.minimum(t, 1.0),
        lambda t: 1.0 + 1e-4 * np.sin(1e4 * t),
    ):
        assert shortest_period(signal, 4.0) == np.inf


def test_poles_between_samples() -> None:
    times = np.linspace(0.0, 4.0, 4097)
    for pole in (1.0, np.pi, 1.23456789, 4.0):
        assert pole_of(lambda t, at=pole: 1.0 / (t - at), times) == pytest.approx(pole)
        assert pole_of(lambda t, at=pole: (t - at) ** -2.0, times) == pytest.approx(pole)
    assert pole_of(lambda t: np.log(t - 1.0), times) == 0.0
    for signal in (np.zeros_like, np.cos, lambda t: 1.0 / ((t - 1.234) ** 2 + 1e-5)):
        assert pole_of(signal, times) is None
