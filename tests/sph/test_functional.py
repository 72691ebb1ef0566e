"""The functional against the printed equations, summed over all pairs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import Functional

SPACING = 0.0625
SHAPE = (16, 14)
LOWER = (-0.3, 0.2)
DOMAIN = BoxDomain(LOWER, (LOWER[0] + 1.0, LOWER[1] + 0.875), (True, True))
FLUID = Fluid(reference_density=800.0, sound_speed=7.0, kinematic_viscosity=0.013, max_speed=0.9)
AS_PRINTED = {
    "shifting_transport": "paper",
    "shifting_as_printed": True,
    "shifting_amplitude": 0.3,
    "viscosity": "pair",
}


def assert_close(actual: np.ndarray, expected: np.ndarray) -> None:
    assert actual.shape == expected.shape
    assert np.max(np.abs(actual - expected)) <= 1e-11 * np.max(np.abs(expected))


def build(ratio: float, domain: Domain = DOMAIN, **options) -> Functional:
    return Functional(FLUID, Discretization(SPACING, ratio * SPACING, **options), domain)


OPTIONS = {
    "default": {"acoustic_damping": 1.0},
    "undamped": {},
    "as printed": AS_PRINTED,
    "printed shifting": {"shifting_transport": "paper", "acoustic_damping": 0.7},
    "pair": {"viscosity": "pair", "acoustic_damping": 0.7},
    "no shifting": {"shifting": False, "viscosity": "pair"},
    "neither": {"shifting": False, "diffusion_coefficient": 0.0},
}


@pytest.mark.parametrize("kind", ["jittered", "random"])
@pytest.mark.parametrize("ratio", [1.5, 2.0, 3.4])
@pytest.mark.parametrize("options", OPTIONS)
def test_equals_the_printed_sums(
    wall_sums: Callable, scatter: Callable, kind: str, ratio: float, options: str
) -> None:
    state = scatter(LOWER, SPACING, SHAPE, kind, seed=int(10 * ratio))
    wall_sums(build(ratio, **OPTIONS[options]), state).check()


@pytest.mark.parametrize("ratio", [1.5, 2.0, 3.4])
@pytest.mark.parametrize("walled", [False, True])
def test_pairs_in_single_precision_are_accurate_to_it(
    scatter: Callable, ratio: float, walled: bool
) -> None:
    """Differences of velocities and densities are rounded at 6e-8 of them, and divided by h."""
    state = scatter(LOWER, SPACING, SHAPE, "jittered", seed=12)
    domain = replace(DOMAIN, periodic=(not walled, not walled))
    found = []
    for precision in ("float64", "float32"):
        sizes = Discretization(SPACING, ratio * SPACING, pair_precision=precision)
        walls = domain.ghosts(SPACING, sizes.n_layers) if walled else None
        functional = Functional(FLUID, sizes, domain, walls=walls)
        rates = functional.evaluate(state[:2], state[2], state[3:], along=2.0 * state[2:])
        assert functional(state).dtype == np.float64
        found.append((functional(state), rates.slopes))
    for double, single in zip(*found, strict=True):
        assert 0.0 < np.max(np.abs(single - double)) < 2e-6 * np.max(np.abs(double))


def test_the_limit_of_the_shifting_velocity_acts_on_some(scatter: Callable) -> None:
    state = scatter(LOWER, SPACING, SHAPE, "random", seed=15)
    rates = build(1.5).evaluate(state[:2], state[2], state[3:])
    speed = np.linalg.norm(rates.shifting_velocity, axis=0)
    limit = 0.5 * FLUID.max_speed
    at_limit = np.isclose(speed, limit, rtol=1e-12)
    assert np.all(speed <= limit * (1.0 + 1e-12))
    assert 0 < at_limit.sum() < speed.size


def test_no_pair_is_missed_while_the_list_is_kept(wall_sums: Callable, scatter: Callable) -> None:
    functional = build(2.0)
    state = scatter(LOWER, SPACING, SHAPE, "jittered", seed=3)
    functional(state)
    built = functional.neighbourhood.sources
    angle = np.random.default_rng(4).uniform(0.0, 2.0 * np.pi, state.shape[1])
    # Two moves, each right up to the limit from where the list was built.
    for turn in (0.0, np.pi):
        moved = state.copy()
        moved[:2] += 0.2999 * SPACING * np.stack((np.cos(angle + turn), np.sin(angle + turn)))
        wall_sums(functional, moved).check()
        assert functional.neighbourhood.sources is built
    moved[0, 0] += 0.7 * SPACING
    wall_sums(functional, moved).check()
    assert functional.neighbourhood.sources is not built


def test_positions_may_be_outside_of_the_box(wall_sums: Callable, scatter: Callable) -> None:
    functional = build(2.0)
    state = scatter(LOWER, SPACING, SHAPE, "jittered", seed=5)
    turns = np.random.default_rng(6).integers(-2, 3, (2, state.shape[1]))
    far = state.copy()
    far[:2] += turns * np.array(DOMAIN.lengths)[:, None]
    wall_sums(functional, far).check()
    assert_close(functional(far), functional(state))


def test_rates_of_the_full_state(scatter: Callable) -> None:
    functional = build(2.0)
    state = scatter(LOWER, SPACING, SHAPE, "jittered")
    before = state.copy()
    rates = functional.evaluate(state[:2], state[2], state[3:])
    out = functional(state)
    assert np.array_equal(out[:2], state[3:] + rates.shifting_velocity)
    assert np.array_equal(out[2], rates.density)
    assert np.array_equal(out[3:], rates.velocity)
    assert np.array_equal(state, before)


@pytest.mark.parametrize("ratio", [1.5, 2.0, 4.0])
def test_advection_equals_the_printed_sums(
    wall_sums: Callable, scatter: Callable, ratio: float
) -> None:
    functional = build(ratio)
    state = scatter(LOWER, SPACING, SHAPE, "random", seed=7)
    density, velocity = wall_sums(functional, state).advection()
    carried = functional.advection(state[:2], state[2], state[3:])
    assert_close(carried[0], density)
    assert_close(carried[1:].T, velocity)


@pytest.mark.parametrize("ratio", [1.5, 2.0, 4.0])
def test_gradients_equal_the_printed_sums(
    brute_force: type, scatter: Callable, ratio: float
) -> None:
    functional = build(ratio)
    state = scatter(LOWER, SPACING, SHAPE, "jittered", seed=8)
    sums = brute_force(state[:2].T, DOMAIN.lengths, (True, True), ratio * SPACING, SPACING)
    volume = functional.volume(state[2])
    rates = functional.evaluate(state[:2], state[2], state[3:], along=2.0 * state[2:])
    gradients = 0.5 * rates.slopes
    for field, gradient in zip(state[2:], gradients.transpose(1, 0, 2), strict=True):
        assert_close(gradient, sums.renormalised_gradient(field, volume))


def test_renormalised_gradients_of_linear_fields_are_exact(scatter: Callable) -> None:
    """On any set of particles (Eq. 2.11), also where the support is cut off."""
    functional = build(2.0, replace(DOMAIN, periodic=(False, False)))
    state = scatter(LOWER, SPACING, SHAPE, "random", seed=9)
    slopes = np.array([[1.0, -2.0], [0.5, 0.25], [0.0, 3.0]])
    along = slopes @ state[:2] + 4.0
    rates = functional.evaluate(state[:2], state[2], state[3:], along=along)
    assert np.max(np.abs(rates.slopes - slopes)) < 1e-10


def test_order_of_particles_does_not_matter(scatter: Callable) -> None:
    state = scatter(LOWER, SPACING, SHAPE, "jittered", seed=10)
    order = np.random.default_rng(11).permutation(state.shape[1])
    assert_close(build(2.0)(state[:, order]), build(2.0)(state)[:, order])


def test_a_lattice_at_rest_stays_at_rest() -> None:
    """No 0/0 where the shifting velocity has no direction (Eq. 2.13)."""
    x, y = np.meshgrid((np.arange(16) + 0.5) * SPACING, (np.arange(14) + 0.5) * SPACING)
    state = np.zeros((5, x.size))
    state[0], state[1] = LOWER[0] + x.ravel(), LOWER[1] + y.ravel()
    out = build(2.0)(state)
    assert np.isfinite(out).all()
    assert np.max(np.abs(out)) < 1e-12


def test_what_is_not_finite_is_not_hidden(scatter: Callable) -> None:
    """Fast arithmetic leaves NaN alone, in the particle and in its neighbours."""
    state = scatter(LOWER, SPACING, SHAPE, "jittered")
    state[3, 17] = np.nan
    out = build(2.0)(state)
    assert np.isnan(out[2, 17])
    assert np.isnan(out[3, 17])
    assert np.isnan(out).any(axis=0).sum() > 5


@pytest.mark.parametrize(("viscosity", "factor"), [("laplacian", 1.0), ("pair", 3.0)])
def test_viscosity_of_a_flow_that_diverges(viscosity: str, factor: float) -> None:
    """Eq. 2.12 acts on u = sin(k x) along x as nu (lap u + 2 grad div u), three times too strong.

    The flow of the other sort, u = sin(k x) along y, has no divergence, and both are right.
    """
    box = BoxDomain((0.0, 0.0), (2.0, 2.0), (True, True))
    x, y = np.meshgrid((np.arange(32) + 0.5) * SPACING, (np.arange(32) + 0.5) * SPACING)
    wave = np.sin(np.pi * x.ravel())
    options = {"viscosity": viscosity, "shifting": False, "diffusion_coefficient": 0.0}
    functional = build(2.0, box, **options)
    for row, expected in ((3, factor), (4, 1.0)):
        state = np.zeros((5, x.size))
        state[0], state[1], state[row] = x.ravel(), y.ravel(), wave
        rate = functional(state)[row]
        measured = -(rate @ wave) / (wave @ wave) / (FLUID.kinematic_viscosity * np.pi**2)
        assert measured == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize(
    ("density", "speed", "time_step", "told"),
    [
        (0.2, 5.0, 1.0, "the time step is beyond its limit of 0.02"),
        (0.2, 5.0, 1e-4, "c0 = 7 m/s is too low for 5 m/s"),
        (0.2, 1.0, 1e-4, "c0 = 7 m/s is too low for the pressure"),
        (np.nan, np.nan, 1e-4, "a smaller time step or a finer"),
    ],
)
def test_a_run_that_ends_early_names_the_reason(density, speed, time_step, told):
    state = np.array([[0.5], [0.5], [density * FLUID.reference_density], [0.0], [speed]])
    assert told in build(2.0).remedy(state, time_step)
