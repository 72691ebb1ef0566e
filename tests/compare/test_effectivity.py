"""Estimates against errors that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sphrom.compare.comparison_tables import estimate_row
from sphrom.metrics.measures import Samples
from sphrom.store.stored_run import probes_of

TIMES = np.linspace(0.0, 2.0, 21)
NAMES = {"compared": "fast", "parameters": "reynolds=1", "role": "predicted"}


class _Run(dict):
    """What is read of a run's artifact."""

    read = dict.__getitem__
    where = "inside"

    def text(self, name: str) -> str:
        assert name == "error_estimate/training"
        return self.where


@pytest.fixture(scope="module")
def probes(case_of):
    return probes_of(case_of("taylor-green", compare={"grid": 10, "line_points": 5}))


def _samples(probes) -> Samples:
    """A speed of 2 m/s everywhere, and a pressure of 10 Pa, either way."""
    n = len(probes.all)
    pressure = np.zeros(n)
    pressure[probes.on_grid] = np.resize([-10.0, 10.0], 100)
    velocity = np.tile([1.2, 1.6], (len(TIMES), n, 1))
    return Samples(TIMES, velocity, np.tile(pressure, (len(TIMES), 1)))


def _estimates(velocity: np.ndarray, pressure: np.ndarray) -> _Run:
    return _Run({"error_estimate/velocity": velocity, "error_estimate/pressure": pressure})


def test_effectivity_is_estimate_over_error(probes) -> None:
    reference = _samples(probes)
    # Off by 0.1 m/s; by a tenth of the pressure, and by a mean that doesn't count.
    run = Samples(
        TIMES, reference.velocity + np.array([0.06, 0.08]), 1.1 * reference.pressure + 50.0
    )
    estimates = _estimates(np.linspace(0.1, 0.3, 21), np.full(21, 0.5))
    found = estimate_row(estimates, run, reference, probes, from_time=1.0, **NAMES)
    assert (found.compared, found.role) == ("fast", "predicted")
    figures = {
        "velocity_error": 5.0,
        "pressure_error": 10.0,
        "pressure_estimate": 5.0,
        "velocity_estimate": 50.0 * np.sqrt(np.mean(np.linspace(0.2, 0.3, 11) ** 2)),
        "velocity_effectivity_min": 2.0,
        "velocity_effectivity_mean": 2.5,
        "velocity_effectivity_max": 3.0,
        "pressure_effectivity_mean": 0.5,
    }
    for name, expected in figures.items():
        assert found.figures[name] == pytest.approx(expected), name


def test_the_start_is_left_out_and_a_run_outside_of_training_is_extrapolated(probes) -> None:
    reference = _samples(probes)
    run = replace(reference, velocity=reference.velocity + 0.1, pressure=1.1 * reference.pressure)
    estimates = _estimates(np.where(TIMES < 0.19, 100.0, 0.1), np.full(21, 0.5))
    estimates.where = "outside"
    found = estimate_row(estimates, run, reference, probes, from_time=0.0, **NAMES)
    assert found.figures["velocity_effectivity_max"] < 1.0
    assert found.role == "extrapolated"


def test_without_estimates_or_errors_there_is_no_row(probes) -> None:
    reference = _samples(probes)
    assert estimate_row(_Run(), reference, reference, probes, from_time=0.0, **NAMES) is None
    exact = _estimates(np.ones(21), np.ones(21))
    assert estimate_row(exact, reference, reference, probes, from_time=0.0, **NAMES) is None
