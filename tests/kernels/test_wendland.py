"""The kernel: its norm, its support, its gradient; and the terms of pairs that contain it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import fixed_quad, quad
from scipy.special import j0

from sphrom.kernels import pairs
from sphrom.kernels.fields import FluidConstants, RegularityConstants
from sphrom.kernels.wendland import gradient_factor, kernel, laplacian_weight, weigh

LENGTHS = [0.04, 1.0, 13.0]
FLUID = FluidConstants(800.0, 7.0, 0.3, 0.013, 0.4, 1.0)
REGULARITY = RegularityConstants(1.3, 0.6, 0.05, 0.0, 0.5, 0.2, 1.0)


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


@pytest.mark.parametrize(
    ("n_dim", "norm", "shape"), [(2, 1.75 / math.pi, 55 / 84), (3, 1.3125 / math.pi, 33 / 56)]
)
def test_terms_are_those_of_the_equations(n_dim: int, norm: float, shape: float) -> None:
    for vectors in np.random.default_rng(n_dim).uniform(-0.6, 0.6, (20, 2, n_dim)):
        offset, jump = map(tuple, vectors.tolist())
        q = math.hypot(*offset) / 0.7
        value = norm / 0.7**n_dim * (1.0 - 0.5 * q) ** 4 * (2.0 * q + 1.0)
        slope = -5.0 * norm / 0.7 ** (n_dim + 2) * (1.0 - 0.5 * q) ** 3
        along = np.dot(offset, jump)
        found_and_expected = [
            (pairs.kernel_of(offset, 1 / 0.7), value),
            (pairs.slope_weight(offset, 1.2, 1 / 0.7), 1.2 * slope),
            (pairs.shifting_push(offset, REGULARITY, 1 / 0.7), 1 + 0.6 * (0.05 * value) ** 4),
            (pairs.density_exchange(0.3, 0.2, 0.5, FLUID), 0.3 * 0.2 - 0.4 * (0.3 + 0.25)),
            (pairs.push(1.1, FLUID), 49.0 * 1.1),
            (pairs.friction(offset, 0.9, FLUID, 1 / 0.7), 9.36 * (1.0 - shape * q * q)),
            (pairs.pair_friction(offset, jump, FLUID, 1 / 0.7), 240 * along / (q * 0.7) ** 2),
        ]
        for found, expected in found_and_expected:
            assert found == pytest.approx(expected, rel=2e-14)
        assert pairs.extrapolated(jump, 0.3, 0.6) == pytest.approx([1.5 * j for j in jump])
