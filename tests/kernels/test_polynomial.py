"""Monomials and rates of polynomial systems, against direct sums."""

from __future__ import annotations

from itertools import combinations_with_replacement

import numpy as np
import pytest

from sphrom.kernels import polynomial

RANDOM = np.random.default_rng(0)


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
