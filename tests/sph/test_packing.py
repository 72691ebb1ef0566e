"""Packing: even particles that fill the box."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import Discretization
from sphrom.sph.packing import KernelGradientSum, pack

BOX = BoxDomain((0.0, -0.5), (1.0, 0.25), (True, True))
SPACING = 0.0625
FINE = Discretization(SPACING, 2.0 * SPACING)


@pytest.mark.parametrize("ratio", [1.5, 2.0, 4.0])
@pytest.mark.parametrize("kind", ["jittered", "random"])
def test_the_gradient_sum_equals_the_sum_over_all_pairs(
    brute_force: type, scatter: Callable, ratio: float, kind: str
) -> None:
    position = scatter(BOX.lower, SPACING, (16, 12), kind, seed=1)[:2]
    sums = brute_force(position.T, BOX.lengths, (True, True), ratio * SPACING, SPACING)
    expected = sums.kernel_gradient_sum(np.full(position.shape[1], SPACING**2)).T
    push = KernelGradientSum(BOX, Discretization(SPACING, ratio * SPACING))
    # Of the sum's terms, not of the sum, which vanishes where particles are even.
    assert np.max(np.abs(push(position) - expected)) < 1e-12 / SPACING
    assert np.max(np.abs(expected)) > 0.01 / SPACING


def test_a_lattice_fills_the_box_and_has_no_push() -> None:
    points = BOX.fill(SPACING)
    assert points.shape == (16 * 12, 2)
    assert np.allclose(points.min(axis=0), np.array(BOX.lower) + 0.5 * SPACING)
    assert np.allclose(points.max(axis=0), np.array(BOX.upper) - 0.5 * SPACING)
    gradient = KernelGradientSum(BOX, FINE)(np.ascontiguousarray(points.T))
    assert np.max(np.abs(gradient)) < 1e-11


@pytest.mark.parametrize("ratio", [2.0, 4.0])
def test_packing_evens_particles_out_and_is_no_lattice(ratio: float) -> None:
    steps = []
    discretization = Discretization(SPACING, ratio * SPACING)
    packing = pack(BOX, discretization, tolerance=1e-4, advance=steps.append)
    assert packing.residual[-1] <= 1e-4
    assert packing.residual[0] > 50.0 * packing.residual[-1]
    assert len(steps) == len(packing.residual) - 1
    assert packing.position.shape == (16 * 12, 2)
    assert np.all(packing.position >= BOX.lower)
    assert np.all(packing.position < BOX.upper)
    gradient = KernelGradientSum(BOX, discretization)(np.ascontiguousarray(packing.position.T))
    residual = SPACING * np.mean(np.linalg.norm(gradient, axis=0))
    assert residual == pytest.approx(packing.residual[-1], rel=1e-6)
    from_lattice = np.abs(packing.position - BOX.fill(SPACING))
    assert np.median(from_lattice) > 0.02 * SPACING
