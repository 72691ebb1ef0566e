"""Polynomial rates, their spectra, batches of runs, and Newton's method."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest

from sphrom.reduction import polynomial_model
from sphrom.reduction.polynomial_model import (
    OutputTimes,
    PolynomialModel,
    Run,
    steady_state,
    step_limit,
)
from sphrom.reduction.reduced_operators import (
    Polynomial,
    largest_growth,
    memory_length,
    spectral_radius,
    stability_limits,
)
from sphrom.sph.time_loop import runge_kutta_step

N_MODES = 4
RANDOM = np.random.default_rng(5)
STATE = RANDOM.standard_normal(N_MODES)


def symmetric(degree: int, seed: int) -> np.ndarray:
    """Return a tensor that is symmetric in its trailing axes."""
    tensor = np.random.default_rng(seed).standard_normal((N_MODES,) * (degree + 1))
    return sum(tensor.transpose(0, *axes) for axes in permutations(range(1, degree + 1)))


def tensors(highest: int, seed: int = 0) -> tuple[np.ndarray, ...]:
    return tuple(symmetric(degree, seed + degree) for degree in range(highest + 1))


def damped(seed: int = 0, size: float = 0.2) -> Polynomial:
    """Return a quadratic system that decays to somewhere near rest."""
    constant, linear, quadratic = (size * tensor for tensor in tensors(2, seed))
    return Polynomial(((constant, linear - 2.0 * np.eye(N_MODES), quadratic),))


CUBIC = Polynomial((tensors(3), tensors(1, 10), tensors(0, 20)))


def test_rates_are_the_sum_of_contractions() -> None:
    (c, a, h, k), (c1, a1), (c2,) = CUBIC.powers
    quadratic = np.einsum("ijk,j,k->i", h, STATE, STATE)
    cubic = np.einsum("ijkl,j,k,l->i", k, STATE, STATE, STATE)
    expected = c + a @ STATE + quadratic + cubic + 0.7 * (c1 + a1 @ STATE) + 0.49 * c2
    assert np.allclose(CUBIC(STATE, 0.7), expected, rtol=1e-13)
    assert CUBIC.degree == 3
    assert CUBIC.n_modes == N_MODES


def test_the_jacobian_is_the_rates_derivative() -> None:
    step = 1e-5
    for m, along in enumerate(np.eye(N_MODES)):
        ahead, back = (CUBIC(STATE + sign * step * along, 0.7) for sign in (1.0, -1.0))
        column = CUBIC.jacobian(STATE, 0.7)[:, m]
        assert np.allclose(column, (ahead - back) / (2.0 * step), rtol=1e-7, atol=1e-7)
    assert np.allclose(CUBIC.at_rest(0.7), CUBIC.powers[0][1] + 0.7 * CUBIC.powers[1][1])


def test_stability_limits_of_runge_kutta() -> None:
    limits = stability_limits(np.array([-1.0, 2j, -4.0 + 0j, 5j, 3.0 + 2j, 3.0]))
    real, imaginary = 2.785293563405282, 2.0 * math.sqrt(2.0)
    expected = [real, imaginary / 2.0, real / 4.0, imaginary / 5.0, imaginary / 2.0, math.inf]
    assert np.allclose(limits, expected, rtol=1e-9)


@pytest.mark.parametrize("angle", np.linspace(0.5, 1.0, 12) * math.pi)
def test_all_below_the_limit_is_stable_and_nothing_just_above(angle: float) -> None:
    eigenvalue = 3.0 * np.exp(1j * angle)
    limit = stability_limits(np.array([eigenvalue]))[0]

    def growth(step: float) -> float:
        z = eigenvalue * step
        return abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)

    assert all(growth(share * limit) <= 1.0 + 1e-12 for share in np.linspace(0.0, 1.0, 200))
    assert growth(1.001 * limit) > 1.0


def test_the_spectrum_of_a_known_matrix() -> None:
    jacobian = np.array([[-1.0, 7.0, 0.0], [-7.0, -1.0, 0.0], [0.0, 0.0, 0.5]])
    assert largest_growth(jacobian) == pytest.approx(0.5)
    assert spectral_radius(jacobian) == pytest.approx(math.sqrt(50.0))


def test_a_run_is_runge_kutta_with_snapshots() -> None:
    cubic = -0.05 * symmetric(3, 7)
    polynomial = Polynomial(((*damped().powers[0], cubic), tensors(1, 3), tensors(0, 20)))
    output_times = OutputTimes(interval=0.2, n_snapshots=4, start_time=1.5)
    runs = PolynomialModel(polynomial).run(12, STATE, output_times, np.cos)
    state = STATE
    for step in range(12):
        state = runge_kutta_step(
            lambda a, t: polynomial(a, math.cos(t)), state, 1.5 + 0.05 * step, 0.05
        )
    assert np.allclose(runs.coordinates[-1], state, rtol=1e-11)
    assert np.allclose(runs.time, [1.5, 1.7, 1.9, 2.1])
    assert runs.time_step == pytest.approx(0.05)
    assert np.isnan(runs.diverged_at)


@pytest.mark.parametrize("n_steps", [1, 2, 3, 5, 17])
def test_a_cubic_in_time_is_exact_in_any_steps(n_steps: int) -> None:
    """The rates t^2 make t^3 / 3."""
    none = np.zeros(N_MODES)
    still = (none, np.zeros((N_MODES, N_MODES)))
    polynomial = Polynomial((still, (none,), (STATE,)))
    output_times = OutputTimes(0.3, 8, start_time=1.0)
    runs = PolynomialModel(polynomial).run(n_steps, STATE, output_times, lambda t: t)
    expected = STATE * (1.0 + (runs.time[:, None] ** 3 - 1.0) / 3.0)
    assert np.allclose(runs.coordinates, expected, rtol=1e-13)


def test_a_divergent_run_says_when() -> None:
    """da/dt = a^2 from 2 is infinite at 0.5; from -2 it decays."""
    quadratic = np.zeros((N_MODES,) * 3)
    quadratic[0, 0, 0] = 1.0
    polynomial = Polynomial(((np.zeros(N_MODES), np.zeros((N_MODES, N_MODES)), quadratic),))

    def run(start: float, **options: float) -> Run:
        output_times = OutputTimes(0.2, 6, **options)
        return PolynomialModel(polynomial).run(500, start * np.eye(N_MODES)[0], output_times)

    diverging, decaying = run(2.0), run(-2.0)
    assert diverging.diverged_at == pytest.approx(0.5, abs=0.02)
    whole = np.isfinite(diverging.coordinates).all(axis=1)
    assert whole.tolist() == [True, True, True, False, False, False]
    assert np.isnan(decaying.diverged_at)
    assert decaying.coordinates[-1, 0] == pytest.approx(-2.0 / 3.0, rel=1e-6)
    assert run(2.0, largest_norm=4.0).diverged_at == pytest.approx(0.25, abs=0.004)


def test_newton_finds_where_a_run_ends(monkeypatch) -> None:
    polynomial = damped(size=0.1)
    found = steady_state(polynomial, np.zeros(N_MODES))
    assert found.converged
    assert found.residual < 1e-10
    assert found.n_steps <= 6
    monkeypatch.setattr(polynomial_model, "MOST_STEPS", 1)
    early = steady_state(polynomial, np.zeros(N_MODES))
    assert (early.n_steps, early.converged) == (1, False)
    assert found.residual < early.residual
    runs = PolynomialModel(polynomial).run(300, np.zeros(N_MODES), OutputTimes(30.0, 2))
    assert np.allclose(found.coordinates, runs.coordinates[-1], atol=1e-9)


def test_newton_says_when_there_is_no_steady_state() -> None:
    """The rates 1 + a^2 vanish nowhere; a constant's Jacobian is singular."""
    quadratic = np.eye(N_MODES)[:, :, None] * np.eye(N_MODES)[:, None]
    ones, none = np.ones(N_MODES), np.zeros((N_MODES, N_MODES))
    for polynomial in (Polynomial(((ones, none, quadratic),)), Polynomial(((ones, none),))):
        found = steady_state(polynomial, np.full(N_MODES, 0.7))
        assert not found.converged
        assert found.residual > 1.0


@pytest.mark.parametrize("n_modes", [1, 3, 8])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_jacobians_at_many_states_are_bitwise_those_at_one(n_modes: int, degree: int) -> None:
    """Steps follow from them."""
    random = np.random.default_rng(n_modes)
    parts = tuple(random.standard_normal((n_modes,) * (d + 1)) for d in range(degree + 1))
    rates = Polynomial((parts, parts[:2]))
    states = random.standard_normal((13, n_modes))
    expected = np.stack([rates.jacobian(state, 0.3) for state in states])
    assert rates.jacobians(states, 0.3).tobytes() == expected.tobytes()


def test_the_limit_of_steps_is_that_of_the_worst_state() -> None:
    still = Polynomial((tuple(0.0 * tensor for tensor in tensors(2)),))
    assert step_limit(still, np.zeros((7, N_MODES))) == np.inf
    for rates in map(damped, range(5)):
        states = 10.0 * RANDOM.standard_normal((7, N_MODES))
        eigenvalues = (np.linalg.eigvals(rates.jacobian(state)) for state in states)
        each = [stability_limits(values.astype(np.complex128)).min() for values in eigenvalues]
        assert step_limit(rates, states) == pytest.approx(min(each), rel=1e-14)
        assert min(each) < 0.9 * max(each)


SOUND_TIME = 5e-3
"""What sound of 10 m/s takes to cross a smoothing length of 5 cm [s]."""


@pytest.mark.parametrize(
    ("rate", "expected"),
    [
        (1e4, 0.2e-4),
        (0.5 / SOUND_TIME, 0.4 * SOUND_TIME),
        (0.3 / SOUND_TIME, 0.5 * SOUND_TIME),
        (0.0, 0.5 * SOUND_TIME),
    ],
)
def test_memory_is_as_long_as_rates_let_it_up_to_half_of_sound_s_way(rate, expected) -> None:
    jacobian = rate * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -0.9]])
    assert memory_length(jacobian, 0.05, 10.0) == pytest.approx(expected, rel=1e-12)
