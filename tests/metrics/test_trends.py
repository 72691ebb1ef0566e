"""Fitted slopes recover the slopes they were made with; kinetic energy by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sphrom.metrics.series import (
    dominant_frequency,
    exponential_rate,
    kinetic_energy,
    order_of_convergence,
    phase_lead,
)


@given(order=st.floats(-3.0, 5.0), constant=st.floats(1e-6, 1e6))
def test_order_of_a_power_law(order: float, constant: float) -> None:
    spacing = np.array([0.04, 0.02, 0.01])
    assert order_of_convergence(spacing, constant * spacing**order) == pytest.approx(
        order, abs=1e-9
    )


@given(rate=st.floats(-50.0, 5.0), constant=st.floats(1e-6, 1e6))
def test_rate_of_an_exponential(rate: float, constant: float) -> None:
    time = np.linspace(0.0, 1.0, 20)
    assert exponential_rate(time, constant * np.exp(rate * time)) == pytest.approx(rate, abs=1e-9)


def test_fits_without_meaning_are_refused() -> None:
    with pytest.raises(ValueError, match="every error positive"):
        order_of_convergence(np.array([0.1, 0.2]), np.array([0.0, 1.0]))
    with pytest.raises(ValueError, match="every value positive"):
        exponential_rate(np.array([0.0, 1.0]), np.array([1.0, np.nan]))
    with pytest.raises(ValueError, match="two different points"):
        order_of_convergence(np.array([0.1, 0.1]), np.array([1.0, 2.0]))
    with pytest.raises(ValueError, match="as many values"):
        order_of_convergence(np.array([0.1, 0.2]), np.array([1.0]))


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


@pytest.mark.parametrize(
    "signal",
    [
        np.zeros(100),
        np.full(100, 3.3),
        np.linspace(0.0, 1.0, 100),
        np.linspace(0.0, 1.0, 100) ** 2,
        np.sin(np.linspace(0.0, 8.0, 100)),
    ],
    ids=["nothing", "constant", "straight", "curved", "less than two periods"],
)
def test_a_record_without_two_periods_has_no_frequency(signal: np.ndarray) -> None:
    with pytest.raises(ValueError, match="no oscillation"):
        dominant_frequency(np.linspace(0.0, 1.0, 100), signal)


@pytest.mark.parametrize(
    ("time", "signal", "message"),
    [
        (np.arange(7.0), np.arange(7.0), "8 samples"),
        (np.arange(20.0) ** 2, np.arange(20.0), "equal intervals"),
        (np.arange(20.0), np.full(20, np.nan), "not finite"),
    ],
)
def test_records_without_a_spectrum_are_refused(
    time: np.ndarray, signal: np.ndarray, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        dominant_frequency(time, signal)


def test_a_phase_that_drifts_is_followed_beyond_half_a_period() -> None:
    """Ahead is positive: a wave that comes early has its crest early."""
    time = 5.0 + np.linspace(0.0, 1.0, 801)
    reference = 3.0 + np.sin(2.0 * np.pi * 4.6 * time + 1.0)
    ahead = 2.0 * np.sin(2.0 * np.pi * 4.6 * (time + 0.1 / 4.6) + 1.0)
    np.testing.assert_allclose(phase_lead(time, ahead, reference, 4.6), 0.1, atol=2e-3)
    np.testing.assert_allclose(phase_lead(time, reference, ahead, 4.6), -0.1, atol=2e-3)
    faster = np.sin(2.0 * np.pi * 5.4 * (time - 5.0) + 2.0 * np.pi * 4.6 * 5.0 + 1.0)
    lead = phase_lead(time, faster, reference, 4.6)
    assert lead[0] == pytest.approx(0.8 * 0.5 / 4.6, abs=0.03)
    assert lead[-1] == pytest.approx(0.8 * (1.0 - 0.5 / 4.6), abs=0.03)


def test_the_first_phase_decides_between_ahead_and_behind() -> None:
    time, frequency = np.linspace(0.0, 1.0, 81), 4.0
    rise = 0.004
    ahead = 0.498 + rise * (np.arange(81) - 9.5)
    signal = np.sin(2.0 * np.pi * (frequency * time + ahead))
    lead = phase_lead(time, signal, np.sin(2.0 * np.pi * frequency * time), frequency)
    assert lead[0] < 0.5 < lead[1]
    assert lead[0] == pytest.approx(0.498, abs=4e-3)


def test_a_phase_without_meaning_is_refused() -> None:
    time = np.linspace(0.0, 1.0, 101)
    with pytest.raises(ValueError, match="a period or more"):
        phase_lead(time, np.sin(time), np.sin(time), 0.5)
    with pytest.raises(ValueError, match="equal intervals"):
        phase_lead(time**2, np.sin(time), np.sin(time), 4.0)
