"""Terms of pairs against numpy: the same functions in two and three dimensions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sphrom.kernels import pairs
from sphrom.kernels.fields import FluidConstants, RegularityConstants

LENGTH = 0.7
FLUID = FluidConstants(800.0, 7.0, 0.3, 0.013, 0.4, 1.0)
REGULARITY = RegularityConstants(1.3, 0.6, 0.05, 0.0, 0.5, 0.2, 1.0)


@pytest.mark.parametrize(
    ("n_dim", "norm", "shape"), [(2, 1.75 / math.pi, 55 / 84), (3, 1.3125 / math.pi, 33 / 56)]
)
def test_terms_are_those_of_the_equations(n_dim: int, norm: float, shape: float) -> None:
    for vectors in np.random.default_rng(n_dim).uniform(-0.6, 0.6, (20, 2, n_dim)):
        offset, jump = map(tuple, vectors.tolist())
        q = math.hypot(*offset) / LENGTH
        kernel = norm / LENGTH**n_dim * (1.0 - 0.5 * q) ** 4 * (2.0 * q + 1.0)
        slope = -5.0 * norm / LENGTH ** (n_dim + 2) * (1.0 - 0.5 * q) ** 3
        along = np.dot(offset, jump)
        found_and_expected = [
            (pairs.kernel_of(offset, 1 / LENGTH), kernel),
            (pairs.slope_weight(offset, 1.2, 1 / LENGTH), 1.2 * slope),
            (pairs.shifting_push(offset, REGULARITY, 1 / LENGTH), 1 + 0.6 * (0.05 * kernel) ** 4),
            (pairs.density_exchange(0.3, 0.2, 0.5, FLUID), 0.3 * 0.2 - 0.4 * (0.3 + 0.25)),
            (pairs.push(1.1, FLUID), 49.0 * 1.1),
            (pairs.friction(offset, 0.9, FLUID, 1 / LENGTH), 9.36 * (1.0 - shape * q * q)),
            (pairs.pair_friction(offset, jump, FLUID, 1 / LENGTH), 240 * along / (q * LENGTH) ** 2),
        ]
        for found, expected in found_and_expected:
            assert found == pytest.approx(expected, rel=4e-15)
        assert pairs.extrapolated(jump, 0.3, 0.6) == pytest.approx([1.5 * j for j in jump])
