"""Errors from products with a basis, and the fit of estimates to them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sphrom.reduction.columns import columns
from sphrom.reduction.error_calibration import (
    FieldColumns,
    FieldProducts,
    accumulated,
    calibrate,
    compared_snapshots,
)
from sphrom.reduction.trial_basis import reconstruct

TIME = np.linspace(1.0, 5.0, 201)


def products_of(setting) -> tuple[FieldProducts, np.ndarray, np.ndarray]:
    """Return the products of the scene's states, their q (n, n_points) and their velocities."""
    points, basis = setting.points, setting.basis
    density = basis.inner_product.density_fluctuation(setting.states[:, 0])
    q, velocity = points.density_scale * density, setting.states[:, 1:].transpose(0, 2, 1)
    field_columns = FieldColumns(basis, columns(basis, points))
    projections, squares = field_columns.products(q, velocity)
    return FieldProducts(field_columns.gram, projections[None], squares[None]), q, velocity


def rms(setting, field: np.ndarray) -> np.ndarray:
    """Return root mean squares (n,) over the points of (n, n_points, ...), as the basis weighs."""
    squares = np.sum(field.reshape(*field.shape[:2], -1) ** 2, axis=2)
    return np.sqrt(squares @ setting.weights / setting.weights.sum())


@pytest.mark.parametrize("name", ["periodic", "lid", "centred", "raw", "raw, centred and forced"])
@pytest.mark.parametrize("kept", [[0, 1, 2, 3, 4], [0, 2]])
def test_errors_are_those_at_the_points(settings, name: str, kept: list[int]) -> None:
    setting = settings[name]
    products, q, velocity = products_of(setting)
    coordinates = np.random.default_rng(0).standard_normal((len(q), 5))
    coordinates[:, [k for k in range(5) if k not in kept]] = 0.0
    density, flow = reconstruct(setting.basis, coordinates)
    found = setting.points.density_scale * density
    share = setting.weights / setting.weights.sum()
    found, q = (field - (field @ share)[:, None] for field in (found, q))
    some = products.only(np.array(kept), 5)
    np.testing.assert_allclose(
        some.errors(0, coordinates[:, kept]),
        np.stack((rms(setting, flow - velocity), rms(setting, found - q)), axis=1),
        rtol=1e-9,
        atol=1e-9,
    )
    np.testing.assert_allclose(
        some.sizes(coordinates[:, kept]),
        np.stack((rms(setting, flow), rms(setting, found)), axis=1),
        rtol=1e-9,
        atol=1e-9,
    )


def test_the_integral_decays_as_it_should() -> None:
    """Against the solution of dE/dt = r - lambda E for a residual that is linear in time."""
    rate, time = 0.7, TIME - TIME[0]
    residual = 2.0 + 3.0 * time
    expected = 3.0 * time / rate + (2.0 - 3.0 / rate) * (1.0 - np.exp(-rate * time)) / rate
    np.testing.assert_allclose(accumulated(TIME, residual, rate), expected, atol=1e-12)
    assert accumulated(TIME, residual, rate)[0] == 0.0


def test_constants_and_rate_are_found_again() -> None:
    """Errors that are as the estimate has it are estimated exactly, at any parameter."""
    rates = np.geomspace(0.3 / 4.0, 200 / 4.0, 15)
    residuals = [2.0 + np.sin(k * TIME) ** 2 for k in (3.0, 5.0)]
    compared = compared_snapshots(len(TIME))
    constants = np.array([0.3, 7.0])
    errors = [
        accumulated(TIME, residual, rates[6])[compared][:, None] * constants
        for residual in residuals
    ]
    found = calibrate(TIME, residuals, errors, compared)
    assert found is not None
    assert found.decay_rate == pytest.approx(rates[6])
    np.testing.assert_allclose(found.constants, constants)
    np.testing.assert_allclose(found.factors, 1.0)
    other = 1.0 + 0.1 * TIME
    expected = accumulated(TIME, other, rates[6])[:, None] * constants
    np.testing.assert_allclose(found.errors(TIME, other), expected)


def test_what_scatters_is_within_the_factor() -> None:
    random, residual = np.random.default_rng(1), np.full_like(TIME, 2.0)
    scatter = np.exp(0.5 * random.standard_normal((len(TIME), 2)))
    errors = scatter * accumulated(TIME, residual, 3.0)[:, None]
    found = calibrate(TIME, [residual], [errors], np.arange(len(TIME)))
    assert found is not None
    # 95 % of a normal distribution lie within 1.96 times its standard deviation.
    np.testing.assert_allclose(np.log(found.factors), 1.96 * 0.5, rtol=0.25)
    late = TIME - TIME[0] >= 0.4
    ratios = np.log(errors[late] / found.errors(TIME, residual)[late])
    np.testing.assert_allclose(ratios.mean(axis=0), 0.0, atol=1e-12)


def test_runs_that_diverged_count_as_far_as_they_went() -> None:
    residual = np.full_like(TIME, 2.0)
    errors = 0.1 * accumulated(TIME, residual, 1.0)[:, None] * np.ones(2)
    broken, gone = residual.copy(), errors.copy()
    broken[120:] = gone[120:] = math.nan
    found = calibrate(TIME, [residual, broken], [errors, gone], np.arange(len(TIME)))
    assert found is not None
    assert np.isfinite(found.constants).all()
    broken[5:] = math.nan
    assert calibrate(TIME, [broken], [errors], np.arange(len(TIME))) is None


def test_without_errors_there_is_nothing_to_fit() -> None:
    compared = compared_snapshots(len(TIME))
    nothing = np.zeros((len(compared), 2))
    assert calibrate(TIME, [np.ones_like(TIME)], [nothing], compared) is None
    assert calibrate(TIME, [np.zeros_like(TIME)], [nothing + 1.0], compared) is None


@pytest.mark.parametrize(("n_snapshots", "n_compared"), [(1, 1), (2, 2), (150, 150), (1001, 101)])
def test_about_a_hundred_snapshots_are_compared(n_snapshots: int, n_compared: int) -> None:
    compared = compared_snapshots(n_snapshots)
    assert len(compared) == n_compared
    assert compared[0] == 0
    assert compared[-1] < n_snapshots
