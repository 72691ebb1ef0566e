"""What the functional conserves, and what it does not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import Functional

SPACING = 0.0625
SHAPE = (16, 16)
BOX = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
DENSITY = 1000.0
SOUND_SPEED = 10.0


def build(ratio: float = 2.0, *, nu: float = 0.0, **options) -> Functional:
    fluid = Fluid(DENSITY, SOUND_SPEED, nu, 1.0)
    options = {"shifting": False, "diffusion_coefficient": 0.0, **options}
    return Functional(fluid, Discretization(SPACING, ratio * SPACING, **options), BOX)


def momentum_rate(functional: Functional, state: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the sum of m du/dt (2,), and the sum of its absolute values."""
    force = functional.mass * functional(state)[3:]
    return force.sum(axis=1), float(np.abs(force).sum())


@pytest.mark.parametrize("ratio", [1.5, 2.0, 4.0])
@pytest.mark.parametrize("kind", ["jittered", "random"])
@pytest.mark.parametrize("form", ["laplacian", "pair"])
def test_pressure_and_viscosity_conserve_momentum(
    scatter: Callable, ratio: float, kind: str, form: str
) -> None:
    """However volumes and factors differ."""
    state = scatter((0.0, 0.0), SPACING, SHAPE, kind, seed=1)
    functional = build(ratio, nu=0.02, viscosity=form, acoustic_damping=1.0)
    total, size = momentum_rate(functional, state)
    assert np.max(np.abs(total)) < 1e-13 * size


@pytest.mark.parametrize("form", ["laplacian", "pair"])
def test_viscosity_conserves_momentum_and_takes_energy(scatter: Callable, form: str) -> None:
    state = scatter((0.0, 0.0), SPACING, SHAPE, "jittered", seed=2)
    state[2] = 0.0
    functional = build(nu=0.02, viscosity=form)
    total, size = momentum_rate(functional, state)
    assert np.max(np.abs(total)) < 1e-13 * size
    assert np.sum(state[3:] * functional(state)[3:]) < 0.0


def test_diffusion_of_density_without_gradients_conserves_volume_weighted_density(
    scatter: Callable,
) -> None:
    """Eq. 2.10 is antisymmetric in i and j: sum V_i D_i vanishes whatever the particles."""
    state = scatter((0.0, 0.0), SPACING, SHAPE, "jittered", seed=3)
    state[3:] = 0.0
    functional = build(diffusion_coefficient=0.1)
    rate = functional.volume(state[2]) * functional(state)[2]
    assert abs(rate.sum()) < 1e-13 * np.abs(rate).sum()


def test_the_printed_shifting_term_drifts_in_momentum(scatter: Callable) -> None:
    """The last sum of Eq. 2.7 is not antisymmetric: momentum is not conserved, but nearly so.

    Measured: of the absolute forces that shifting adds, 3.0 % are left in the sum here, and 1 to
    7 % over twelve such sets, jittered by 0.3 spacings. In a flow particles are far more even.
    """
    state = scatter((0.0, 0.0), SPACING, SHAPE, "jittered", seed=4)
    state[2] = 0.0
    printed = build(shifting=True, shifting_transport="paper")
    force = printed.mass * (printed(state) - build()(state))[3:]
    drift = np.max(np.abs(force.sum(axis=1))) / np.abs(force).sum()
    assert 1e-3 < drift < 0.045


def acoustic_rates(functional: Functional, state: np.ndarray) -> np.ndarray:
    """Return the rates of (c0 rho'/rho0, u) (3, N)."""
    out = functional(state)[2:]
    out[0] *= SOUND_SPEED / DENSITY
    return out


@pytest.mark.parametrize("ratio", [1.5, 2.0, 4.0])
@pytest.mark.parametrize("kind", ["jittered", "random"])
def test_the_acoustic_operator_is_skew(scatter: Callable, ratio: float, kind: str) -> None:
    """In the acoustic-energy product, to rounding, on any periodic set of particles.

    Amplitudes of 1e-13 leave the linear terms alone: rho' is kept as a fluctuation, so that they
    lose no digits.
    """
    functional = build(ratio)
    scale = 1e-13 * np.array([[DENSITY], [SOUND_SPEED], [SOUND_SPEED]])
    first = scatter((0.0, 0.0), SPACING, SHAPE, kind, seed=5)
    second = first.copy()
    first[2:] *= scale
    second[2:] = scale * np.random.default_rng(6).standard_normal((3, first.shape[1]))
    fields = [state[2:] * [[SOUND_SPEED / DENSITY], [1.0], [1.0]] for state in (first, second)]
    rates = [acoustic_rates(functional, state) for state in (first, second)]
    size = np.linalg.norm(fields[0]) * np.linalg.norm(rates[0])
    assert abs(np.sum(fields[0] * rates[0])) < 1e-12 * size
    assert abs(np.sum(fields[0] * rates[1]) + np.sum(fields[1] * rates[0])) < 1e-12 * size
