"""Monomials, rates and steps of polynomial systems, against direct sums."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import pytest

from sphrom.kernels import polynomial
from sphrom.sph.time_loop import runge_kutta_step

RANDOM = np.random.default_rng(0)
TIME_STEP = 0.07


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
    coordinates = RANDOM.standard_normal(n_modes)
    expected = monomials(coordinates, degree)
    out = np.full(expected.size, np.nan)
    polynomial.fill_monomials(coordinates, degree, out)
    assert np.allclose(out, expected, rtol=1e-14)


def test_rates_use_leading_columns_and_powers_of_the_amplitude() -> None:
    values = monomials(RANDOM.standard_normal(3), 2)
    coefficients = RANDOM.standard_normal((3, 3, values.size))
    used = np.array([values.size, 4, 1])
    out = np.empty(3)
    polynomial.evaluate(coefficients, used, -1.5, values, out)
    rows = [c[:, :n] @ values[:n] for c, n in zip(coefficients, used, strict=True)]
    assert np.allclose(out, rows[0] - 1.5 * rows[1] + 2.25 * rows[2], rtol=1e-13)


class System:
    """A random damped system of three unknowns, and scratch memory for it."""

    def __init__(self, degree: int, seed: int, n_powers: int = 1) -> None:
        random = np.random.default_rng(seed)
        self.degree = degree
        self.start = random.standard_normal(3)
        width = monomials(self.start, degree).size
        self.coefficients = 0.3 * random.standard_normal((n_powers, 3, width))
        self.coefficients[0, :, 1:4] -= 2.0 * np.eye(3)
        self.used = np.full(n_powers, width)

    def rates(self, state: np.ndarray, amplitude: float) -> np.ndarray:
        powers = [c @ monomials(state, self.degree) for c in self.coefficients]
        return sum(amplitude**p * rates for p, rates in enumerate(powers))

    def scratch(self) -> tuple[np.ndarray, np.ndarray]:
        return np.empty(self.coefficients.shape[2]), np.empty((5, 3))


@pytest.mark.parametrize("degree", [2, 3])
def test_steps_are_those_of_runge_kutta(degree: int) -> None:
    system, out = System(degree, 1), np.full((4, 3), np.nan)
    out[0] = system.start
    steps = polynomial.integrate(
        system.coefficients, system.used, np.zeros(3), TIME_STEP, 15, degree, 1e10,
        *system.scratch(), out,
    )  # fmt: skip
    assert steps == 15
    state = system.start
    for step in range(15):
        state = runge_kutta_step(lambda a, t: system.rates(a, 0.0), state, 0.0, TIME_STEP)
        if (step + 1) % 5 == 0:
            assert np.allclose(out[(step + 1) // 5], state, rtol=1e-12)
    assert np.linalg.norm(out[0] - out[-1]) > 0.1


def test_amplitudes_are_those_of_the_substeps() -> None:
    system, out = System(2, 2, n_powers=3), np.empty((3, 3))
    out[0] = system.start
    amplitudes = np.sin(np.arange(2 * 8 + 1))
    polynomial.integrate(
        system.coefficients, system.used, amplitudes, TIME_STEP, 8, 2, 1e10, *system.scratch(), out
    )
    state = system.start
    for step in range(8):
        # Time is counted in half steps.
        state = runge_kutta_step(
            lambda a, t: system.rates(a, amplitudes[round(2.0 * t / TIME_STEP)]),
            state,
            step * TIME_STEP,
            TIME_STEP,
        )
    assert np.allclose(out[-1], state, rtol=1e-12)


@pytest.mark.parametrize("bad", [np.nan, 1e200])
def test_a_divergent_system_stops_where_it_is(bad: float) -> None:
    system, out = System(2, 1), np.full((4, 3), 7.0)
    system.coefficients[0, :, -1] = bad
    out[0] = system.start
    steps = polynomial.integrate(
        system.coefficients,
        system.used,
        np.zeros(3),
        TIME_STEP,
        15,
        2,
        1e10,
        *system.scratch(),
        out,
    )
    assert steps == 0
    assert np.all(out[1:] == 7.0)
