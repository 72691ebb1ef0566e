"""Jacobians at many states are those at one, to the last bit: steps follow from them."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.reduction.polynomial_model import step_limit, step_limits
from sphrom.reduction.reduced_rates import LEAST_SHARE, Polynomial, stability_limits


@pytest.mark.parametrize("n_modes", [1, 3, 5, 8, 10])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_they_are_bitwise_the_same(n_modes, degree):
    random = np.random.default_rng(n_modes)
    tensors = tuple(random.standard_normal((n_modes,) * (d + 1)) for d in range(degree + 1))
    rates = Polynomial((tensors, tensors[:2]))
    states = random.standard_normal((13, n_modes))
    expected = np.stack([rates.jacobian(state, 0.3) for state in states])
    assert rates.jacobians(states, 0.3).tobytes() == expected.tobytes()


def test_limits_of_many_systems_are_those_of_each():
    random = np.random.default_rng(0)
    systems = []
    for _ in range(5):
        tensors = (random.standard_normal(4), random.standard_normal((4, 4)) - 3.0 * np.eye(4))
        systems.append((Polynomial((tensors,)), random.standard_normal((7, 4)), 0.0))
    still = Polynomial(((np.zeros(4), np.zeros((4, 4))),))
    limits = step_limits([*systems, (still, np.zeros((7, 4)), 0.0)])
    assert limits[:-1] == [step_limit(*system) for system in systems]
    assert limits[-1] == np.inf


def test_rays_leave_the_region_of_stability_at_about_one_distance():
    """So that of eigenvalues of a size only the largest set the step's limit."""
    angles = np.linspace(0.5 * np.pi, np.pi, 20_001)
    rays = np.exp(1j * angles)
    rays.real = np.minimum(rays.real, 0.0)
    limits = stability_limits(rays)
    assert limits.min() > 2.61
    assert limits.max() < 2.97
    assert limits.min() / limits.max() > LEAST_SHARE
