"""The kernel: its norm, its support, its gradient."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import fixed_quad, quad
from scipy.special import j0

from sphrom.kernels.wendland import gradient_factor, kernel, laplacian_weight, weigh

LENGTHS = [0.04, 1.0, 13.0]


@pytest.mark.parametrize("length", LENGTHS)
def test_integrates_to_one(length: float) -> None:
    ring, _ = quad(lambda r: 2.0 * np.pi * r * kernel(r, 1.0 / length), 0.0, 2.0 * length)
    assert ring == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("length", LENGTHS)
def test_gradient_factor_is_the_slope_over_the_distance(length: float) -> None:
    step = 1e-6 * length
    for distance in np.linspace(0.01, 2.2, 23) * length:
        ends = [kernel(distance + sign * step, 1.0 / length) for sign in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / (2.0 * step)
        factor = gradient_factor(distance, 1.0 / length)
        assert factor * distance == pytest.approx(slope, rel=1e-6, abs=1e-8 / length**3)


def test_gradient_factor_is_finite_at_the_centre() -> None:
    """No division by the distance: a particle is its own neighbour without a guard."""
    assert gradient_factor(0.0, 1.0) == pytest.approx(-35.0 / (4.0 * np.pi))


@pytest.mark.parametrize("length", LENGTHS)
def test_the_fourth_moment_of_the_laplacian_vanishes(length: float) -> None:
    """The second doesn't, nor the weights' transform anywhere but at zero: it has one sign."""

    def moment(power: int) -> float:
        def ring(r: float) -> float:
            weight = laplacian_weight(r * r, 1.0 / length)
            return r ** (power + 1) * gradient_factor(r, 1.0 / length) * weight

        total, _ = fixed_quad(np.vectorize(ring), 0.0, 2.0 * length, n=40)
        return float(total)

    assert abs(moment(4)) < 1e-12 * length**2 * abs(moment(2))
    assert moment(2) < 0.0
    for number in np.geomspace(0.1, 60.0, 80) / length:
        wave, _ = quad(
            lambda r, k=number: (1.0 - j0(k * r)) * r * gradient_factor(r, 1.0 / length)
            * laplacian_weight(r * r, 1.0 / length),
            0.0, 2.0 * length, limit=400,
        )  # fmt: skip
        assert wave < 0.0


def test_weights_are_the_kernel_and_its_factor() -> None:
    distance = np.array([0.0, 0.1, 0.37, 0.8, 0.81])
    values, factors = np.full((2, 5), np.nan)
    weigh(distance, 2.5, values, factors)
    assert np.allclose(values, [kernel(r, 2.5) for r in distance], rtol=1e-13)
    assert np.allclose(factors, [gradient_factor(r, 2.5) for r in distance], rtol=1e-13)
    assert values[-1] == factors[-1] == 0.0
