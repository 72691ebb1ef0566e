"""Calibration of forces with those that training runs recorded: known errors, and none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sphrom.reduction.reduced_measures import (
    ForceRecord,
    ReducedForce,
    calibrate_force,
    correction_terms,
)

N_MODES, N_SNAPSHOTS = 3, 40
RANDOM = np.random.default_rng(4)
FORCE = ReducedForce(
    pressure=RANDOM.standard_normal((3, 2 + N_MODES)),
    viscous=RANDOM.standard_normal((3, 2 + N_MODES)),
    walls=RANDOM.standard_normal(3),
    body_force=RANDOM.standard_normal((3, 2 + N_MODES)),
)
MATRIX = 0.3 * RANDOM.standard_normal((2, 2, 3, 3 + N_MODES))
"""Of an error and of how it changes with the viscosity."""
Wrong = Callable[[ForceRecord], np.ndarray]


def affine(record: ForceRecord) -> np.ndarray:
    """Return an error (n_snapshots, 2, 3) of the form that a calibration has, about nu = 0.02."""
    terms = correction_terms(record.coordinates, record.wall_speed, record.amplitude)
    matrix = MATRIX[0] + (record.kinematic_viscosity / 0.02 - 1.0) * MATRIX[1]
    return np.einsum("st,plt->spl", terms, matrix)


def a_run(viscosity: float, wrong: Wrong, size: float = 1.0) -> ForceRecord:
    """Return a run whose recorded loads are those of the force, and an error."""
    time = np.linspace(0.0, 1.0, N_SNAPSHOTS)
    phase = np.arange(1, N_MODES + 1) + 10.0 * viscosity
    states = size * np.sin(np.outer(time, phase) + phase) / np.arange(1, N_MODES + 1)
    mean, speed, amplitude = 0.1 * time, 1.0 + np.cos(2.0 * time), np.sin(3.0 * time)
    record = ForceRecord(np.empty(0), states, mean, viscosity, speed, amplitude)
    loads = FORCE.at(states, mean, viscosity, speed, amplitude) + wrong(record)
    return ForceRecord(loads, states, mean, viscosity, speed, amplitude)


def error_of(force: ReducedForce, run: ForceRecord) -> float:
    """Return the norm of the error of a force in a run."""
    about = run.kinematic_viscosity, run.wall_speed, run.amplitude
    found = force.at(run.coordinates, run.mean_density_fluctuation, *about)
    return float(np.linalg.norm(found - run.loads))


@pytest.mark.parametrize("viscosities", [(0.02,), (0.01, 0.03), (0.01, 0.015, 0.03)])
def test_an_error_that_is_linear_in_the_state_goes_also_between(viscosities) -> None:
    force = calibrate_force(FORCE, [a_run(v, affine) for v in viscosities])
    unseen = a_run(0.02, affine)
    assert error_of(force, unseen) < 0.1 * error_of(FORCE, unseen)


def test_a_force_that_is_right_stays_as_it_is() -> None:
    """Noise says nothing about snapshots that were left out."""
    noise = np.random.default_rng(1)
    runs = [
        a_run(v, lambda run: 0.01 * noise.choice((-1.0, 1.0), (len(run.coordinates), 2, 3)))
        for v in (0.01, 0.03)
    ]
    correction = calibrate_force(FORCE, runs).correction
    assert correction is not None
    unchanged = ~correction.mean.any(axis=-1) & ~correction.slope.any(axis=-1)
    assert unchanged.sum() >= 5


def test_a_correction_that_a_run_between_contradicts_is_not_made() -> None:
    def wrong(run: ForceRecord) -> np.ndarray:
        sign = -0.5 if run.kinematic_viscosity == 0.02 else 1.0
        return np.full((len(run.coordinates), 2, 3), sign)

    correction = calibrate_force(FORCE, [a_run(v, wrong) for v in (0.01, 0.02, 0.03)]).correction
    assert correction is not None
    assert not correction.mean.any()
    assert not correction.slope.any()


def test_a_wrong_component_leaves_the_others_alone() -> None:
    def wrong(run: ForceRecord) -> np.ndarray:
        found = np.zeros((len(run.coordinates), 2, 3))
        found[:, 1, 0] = 0.2 * run.coordinates[:, 0]
        return found

    force = calibrate_force(FORCE, [a_run(v, wrong) for v in (0.01, 0.03)])
    unseen, correction = a_run(0.02, wrong), force.correction
    assert error_of(force, unseen) < 0.1 * error_of(FORCE, unseen)
    assert correction is not None
    # Of rounding, a correction may be made too.
    others = np.ones((2, 3), dtype=bool)
    others[1, 0] = False
    assert np.abs(correction.mean[others]).max() < 1e-12


def test_a_single_snapshot_says_nothing() -> None:
    run = a_run(0.02, affine)
    first = ForceRecord(
        run.loads[:1], run.coordinates[:1], np.zeros(1), 0.02, np.ones(1), np.zeros(1)
    )
    assert calibrate_force(FORCE, [first]) is FORCE
    assert calibrate_force(FORCE, []) is FORCE
