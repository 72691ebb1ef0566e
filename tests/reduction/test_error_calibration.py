"""Estimates from residuals and changes that are given."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sphrom.metrics.series import hat
from sphrom.reduction.error_calibration import (
    ErrorCalibration,
    accumulated,
    calibrate_errors,
    field_of,
    output_errors,
)
from sphrom.reduction.held_out import UnheldShares

TIME = np.linspace(0.0, 2.0, 41)
RATE = (len(TIME) - 1) / TIME[-1]
"""One of those that are tried."""
PLACES = np.log([[100.0], [200.0]])
SHARES = UnheldShares(parameters=np.array([0.5, 0.1]), time=np.array([[0.3, 0.2], [0.5, 0.1]]))
CONSTANTS = np.array([[2.0, 1.0], [4.0, 3.0]])
RESIDUALS = np.stack([1.0 + TIME, 2.0 - 0.5 * TIME])


def runs() -> np.ndarray:
    """Return two runs of two coordinates, one of which changes with time."""
    return np.stack([np.stack([k + TIME, np.full(41, 5.0)], axis=1) for k in (1.0, 2.0)])


def fitted(shift: float = 0.0) -> ErrorCalibration:
    errors = CONSTANTS[:, None] * accumulated(TIME, RESIDUALS, np.full(2, RATE))[..., None]
    errors[:, 1::2] *= np.exp(shift)
    errors[:, ::2] *= np.exp(-shift)
    found = calibrate_errors(TIME, runs(), RESIDUALS, errors, np.arange(41), PLACES, SHARES)
    assert found is not None
    return found


@pytest.mark.parametrize("rate", [0.3, 7.0])
def test_a_residual_accumulates_as_its_decaying_integral(rate: float) -> None:
    """E(t) is the integral of exp(-rate (t - s)) r(s), r linear between snapshots."""
    time, residual = np.array([0.0, 0.2, 0.5, 1.1]), np.array([1.0, 3.0, 2.0, 5.0])
    expected = []
    for end in time:
        s = np.linspace(0.0, end, 20001)
        expected.append(np.trapezoid(np.exp(-rate * (end - s)) * np.interp(s, time, residual), s))
    np.testing.assert_allclose(accumulated(time, residual, rate), expected, rtol=1e-6)
    many = accumulated(time, np.stack([residual, 2.0 * residual]), np.array([rate, rate]))
    np.testing.assert_allclose(many, [expected, 2.0 * np.array(expected)], rtol=1e-6)


def test_each_run_has_its_constants_and_the_others_make_the_factors() -> None:
    found = fitted()
    assert found.decay_rate == pytest.approx(RATE)
    np.testing.assert_allclose(found.constants, CONSTANTS, rtol=1e-9)
    np.testing.assert_allclose(found.factors, [2.0, 3.0], rtol=1e-9)
    assert (fitted(0.2).factors > found.factors).all()


def test_constants_are_interpolated_inside_and_widened_outside() -> None:
    found = fitted()
    middle = found.at(np.log([np.sqrt(100.0 * 200.0)]))
    np.testing.assert_allclose(middle.constants, [np.sqrt(8.0), np.sqrt(3.0)], rtol=1e-6)
    np.testing.assert_allclose(middle.expected, runs().mean(axis=0), rtol=1e-6)
    np.testing.assert_array_equal(middle.factors, found.factors)
    for reynolds, nearest in ((50.0, 0), (400.0, 1), (4000.0, 1)):
        outside = found.at(np.log([reynolds]))
        assert outside.factors is None
        np.testing.assert_allclose(outside.constants, CONSTANTS[nearest] * [2.0, 3.0], rtol=1e-4)


def test_changes_count_by_what_is_not_held_of_them() -> None:
    local = fitted().at(np.log([400.0]))
    state = runs()[1] + np.array([0.0, 3.0])
    found = local.errors(TIME, RESIDUALS[1], state)
    known = local.errors(TIME, RESIDUALS[1], runs()[1])
    np.testing.assert_allclose(
        found**2 - known**2, np.tile((3.0 * SHARES.parameters) ** 2, (41, 1)), rtol=1e-4
    )
    assert local.extrapolates(41)


def test_beyond_the_trained_time_the_change_since_then_counts() -> None:
    local = fitted().at(PLACES[0])
    longer = np.linspace(0.0, 4.0, 81)
    state = np.stack([1.0 + longer, np.full(81, 5.0)], axis=1)
    changes = local.changes(state)
    np.testing.assert_allclose(changes[:, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(changes[:, 1], np.maximum(longer - 2.0, 0.0), atol=1e-12)
    assert local.extrapolates(81)
    assert not local.extrapolates(41)
    residual = np.ones(81)
    known = accumulated(longer, residual, RATE)[-1] * CONSTANTS[0]
    growth = np.sqrt(50.0 / 34.0)  # over the largest trained state
    expected = np.sqrt(known**2 + (2.0 * growth**2 * SHARES.time[0]) ** 2)
    np.testing.assert_allclose(local.errors(longer, residual, state)[-1], expected, rtol=1e-9)
    state[:, 0] = 1.0 + np.minimum(longer, 4.0 - longer)
    slower = local.errors(longer, residual, state)[-1]
    np.testing.assert_allclose(slower, np.sqrt(known**2 + (2.0 * SHARES.time[0]) ** 2), rtol=1e-9)


def test_of_what_takes_any_time_all_of_the_change_counts() -> None:
    local, share = fitted().at(PLACES[0]), SHARES.time[0]
    steady = local.steady_errors(1.0, np.array([4.0, 2.0]), 1.0)
    known, moved = CONSTANTS[0] / RATE, 4.0 * SHARES.parameters
    later = np.array([3.0, 3.0 * share[1] / share[0]])
    np.testing.assert_allclose(steady, np.sqrt(known**2 + moved**2 + later**2), rtol=1e-9)
    still = replace(local, of_time=np.zeros(2))
    np.testing.assert_allclose(still.steady_errors(0.0, np.zeros(2), 1.0), [1.0, 1.0], rtol=1e-9)


def test_what_later_times_leave_out_is_interpolated_between_runs() -> None:
    found = fitted()
    middle = found.at(np.log([np.sqrt(100.0 * 200.0)]))
    np.testing.assert_allclose(middle.of_time, SHARES.time.mean(axis=0), rtol=1e-6)
    np.testing.assert_allclose(found.at(np.log([400.0])).of_time, SHARES.time[1], rtol=1e-6)


def test_runs_that_diverged_are_left_out() -> None:
    some = runs()
    some[1, 30:] = np.nan
    residuals = RESIDUALS.copy()
    residuals[1, 30:] = np.nan
    errors = np.ones((2, 41, 2))
    found = calibrate_errors(TIME, some, residuals, errors, np.arange(41), PLACES, SHARES)
    assert found is not None
    assert len(found.constants) == len(found.places) == 1
    np.testing.assert_array_equal(found.shares.time, SHARES.time[:1])
    some[0, 30:] = np.nan
    assert calibrate_errors(TIME, some, residuals, errors, np.arange(41), PLACES, SHARES) is None


def test_an_output_is_as_far_off_as_its_field_beside_noise() -> None:
    """In training runs its error is three times that of the field, and the basis misses 4."""
    noise = np.random.default_rng(0).choice((-0.1, 0.1), (2, 500, 2))
    differences = np.concatenate((noise + np.array([0.6, 0.0]), np.full((1, 500, 2), np.nan)))
    fields = np.full((3, 500), 0.2)
    found = output_errors(differences, fields, np.array([4.0, 0.0]), hat(10))
    field = np.full((2, 750), 0.2)
    field[:, 500:] = 0.6
    errors = found.at(field)
    np.testing.assert_allclose(errors[:, 250], [[np.hypot(0.1, 1.0), 0.1]] * 2, rtol=0.1)
    np.testing.assert_allclose(errors[:, -1, 0], 3.0 * errors[:, 499, 0], rtol=1e-2)
    exact = output_errors(0.0 * noise, 0.0 * fields[:2], np.zeros(2), hat(10))
    np.testing.assert_array_equal(exact.at(field), 0.0)


def test_flows_and_loads_depend_on_the_velocity() -> None:
    assert [field_of(q) for q in ("flow_rate", "force", "pressure_integral")] == [0, 0, 1]
