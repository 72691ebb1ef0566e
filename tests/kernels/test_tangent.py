"""Polynomial systems against direct sums; tangents are the exact derivatives of the steps."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import pytest

from sphrom.kernels.polynomial import evaluate, fill_monomials
from sphrom.kernels.tangent import fill_tangents
from sphrom.reduction.exponential_steps import Change, ExponentialModel, LinearPart
from sphrom.reduction.polynomial_model import OutputTimes
from sphrom.reduction.reduced_operators import Polynomial

N = 4
RANDOM = np.random.default_rng(3)


def monomials(coordinates: np.ndarray, degree: int) -> np.ndarray:
    """All monomials up to a degree, by their indices."""
    found = [
        np.prod(coordinates[list(index)])
        for d in range(degree + 1)
        for index in combinations_with_replacement(range(coordinates.size), d)
    ]
    return np.array(found)


@pytest.mark.parametrize("n_modes", [1, 2, 5])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_monomials_are_in_order(n_modes: int, degree: int) -> None:
    coordinates = RANDOM.normal(size=n_modes)
    expected = monomials(coordinates, degree)
    out = np.full(expected.size, np.nan)
    fill_monomials(coordinates, degree, out)
    assert np.allclose(out, expected, rtol=1e-14)


def test_rates_use_leading_columns_and_powers_of_the_amplitude() -> None:
    values = monomials(RANDOM.normal(size=3), 2)
    coefficients = RANDOM.normal(size=(3, 3, values.size))
    used = np.array([values.size, 4, 1])
    out = np.empty(3)
    evaluate(coefficients, used, -1.5, values, out)
    rows = [c[:, :n] @ values[:n] for c, n in zip(coefficients, used, strict=True)]
    assert np.allclose(out, rows[0] - 1.5 * rows[1] + 2.25 * rows[2], rtol=1e-13)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_monomials_change_along_a_tangent(degree: int) -> None:
    state, along = RANDOM.normal(size=(2, N))
    size = {1: 5, 2: 15, 3: 35}[degree]
    here, changes, ahead, back = np.empty((4, size))
    fill_monomials(state, degree, here)
    fill_tangents(state, along, degree, here, changes)
    fill_monomials(state + 1e-6 * along, degree, ahead)
    fill_monomials(state - 1e-6 * along, degree, back)
    assert changes == pytest.approx((ahead - back) / 2e-6, rel=1e-7, abs=1e-9)


def tensors(degree: int, size: float) -> tuple[np.ndarray, ...]:
    found = [size * RANDOM.normal(size=(N,) * (1 + d)) for d in range(degree + 1)]
    if degree >= 2:
        found[2] = 0.5 * (found[2] + found[2].swapaxes(1, 2))
    return tuple(found)


@pytest.mark.parametrize("n_steps", [3, 8, 20, 60])
@pytest.mark.parametrize("driven", [False, True], ids=["steady", "driven"])
def test_they_are_the_differences_of_runs(n_steps: int, driven: bool) -> None:
    linear = 5.0 * (a := RANDOM.normal(size=(N, N))) - 5.0 * a.T - 0.2 * np.eye(N)
    powers = (tensors(2, 0.3), tensors(1, 0.2)) if driven else (tensors(2, 0.3),)
    rates = Polynomial(powers).plus(Polynomial(((np.zeros(N), linear),)))
    changed = Polynomial((tensors(2, 0.2), tensors(1, 0.2)) if driven else (tensors(2, 0.2),))
    start, start_change = 0.3 * RANDOM.normal(size=(2, N))
    times = OutputTimes(0.1, 21)

    def amplitude(p: float):
        return (lambda t: np.sin(2.0 * t) * (1.0 + p)) if driven else None

    def run(p: float) -> np.ndarray:
        system = ExponentialModel(rates.plus(changed, p), LinearPart(linear))
        begin = (start + p * start_change)[None]
        return system.run(n_steps, begin, times, amplitude(p)).coordinates

    change = Change(changed, start_change, amplitude(0.0))
    still = Change(changed.scaled(0.0), start_change)
    system = ExponentialModel(rates, LinearPart(linear))
    found, (first, second) = system.tangents(n_steps, start, times, [change, still], amplitude(0.0))
    assert np.allclose(found, run(0.0), rtol=1e-12, atol=0.0)
    h = 1e-4
    wide, narrow = ((run(s) - run(-s)) / (2.0 * s) for s in (2.0 * h, h))
    expected = (4.0 * narrow - wide) / 3.0
    assert np.abs(first - expected).max() < 1e-8 * np.abs(expected).max()
    assert not np.allclose(first, second)
