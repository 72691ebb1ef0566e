"""The functional's symmetries: what turns, mirrors, moves or speeds up the flow."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.functional import Functional

SPACING = 0.0625
BOX = BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))
FLUID = Fluid(1000.0, 10.0, 0.01, 1.0)

MATRICES = {
    "quarter turn": np.array([[0.0, -1.0], [1.0, 0.0]]),
    "half turn": -np.eye(2),
    "mirror in x": np.diag([-1.0, 1.0]),
    "mirror in the diagonal": np.array([[0.0, 1.0], [1.0, 0.0]]),
}
PRINTED = {"shifting_as_printed": True, "shifting_transport": "paper", "viscosity": "pair"}


def rates(state: np.ndarray, **options) -> np.ndarray:
    return Functional(FLUID, Discretization(SPACING, 2.0 * SPACING, **options), BOX)(state)


@pytest.fixture
def state(scatter: Callable) -> np.ndarray:
    return scatter((0.0, 0.0), SPACING, (16, 16), "jittered", seed=1)


def assert_close(actual: np.ndarray, expected: np.ndarray) -> None:
    assert np.max(np.abs(actual - expected)) <= 1e-11 * np.max(np.abs(expected))


def assert_rows_close(actual: np.ndarray, expected: np.ndarray) -> None:
    """Compare positions, densities and velocities, each in units of their largest."""
    for rows in (slice(0, 2), slice(2, 3), slice(3, 5)):
        assert_close(actual[rows], expected[rows])


def turned(fields: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return np.vstack((matrix @ fields[:2], fields[2:3], matrix @ fields[3:]))


@pytest.mark.parametrize("name", MATRICES)
@pytest.mark.parametrize("options", [{"acoustic_damping": 1.0}, PRINTED])
def test_turns_and_mirrors(state: np.ndarray, name: str, options: dict) -> None:
    matrix = MATRICES[name]
    out = rates(turned(state, matrix), **options)
    expected = turned(rates(state, **options), matrix)
    assert_rows_close(out, expected)


@pytest.mark.parametrize("name", MATRICES)
@pytest.mark.parametrize(
    "options",
    [
        {"acoustic_damping": 1.0, "fixed_volume": True},
        {"wall_kind": "printed-normal"},
        {"wall_kind": "adami", "shifting_transport": "paper"},
    ],
    ids=["default", "normal", "whole"],
)
def test_a_square_box_has_the_symmetries_of_a_square(
    scatter: Callable, name: str, options: dict
) -> None:
    """Turned or mirrored, the fluid and the lid do as before: no corner is special."""
    matrix, box = MATRICES[name], BoxDomain((-0.5, -0.5), (0.5, 0.5), (False, False))
    discretization = Discretization(SPACING, 2.0 * SPACING, **options)

    def lid(position: np.ndarray) -> np.ndarray:
        above = (position[:, 1] > 0.5) & (np.abs(position[:, 0]) < 0.5)
        return np.outer(above, [1.0, 0.0])

    def build(turn: np.ndarray) -> Functional:
        walls = box.ghosts(SPACING, 4).moving(lambda position: lid(position @ turn) @ turn.T)
        return Functional(FLUID, discretization, box, walls)

    state = scatter((-0.5, -0.5), SPACING, (16, 16), "jittered", seed=7)
    expected = turned(build(np.eye(2))(state), matrix)
    assert_rows_close(build(matrix)(turned(state, matrix)), expected)


def test_moves(state: np.ndarray) -> None:
    moved = state.copy()
    moved[:2] += np.array([[0.3217], [-1.777]])
    assert_close(rates(moved), rates(state))


@pytest.mark.parametrize("shifting", [True, False])
def test_galilean_invariance(state: np.ndarray, shifting: bool) -> None:
    boosted = state.copy()
    boosted[3:] += np.array([[2.0], [-1.0]])
    options = {"shifting": shifting, "acoustic_damping": 1.0}
    out, expected = rates(boosted, **options), rates(state, **options)
    assert_close(out[2:], expected[2:])
    assert_close(out[:2], expected[:2] + np.array([[2.0], [-1.0]]))


def test_the_printed_shifting_term_knows_the_frame(state: np.ndarray, brute_force: type) -> None:
    """Eq. 2.7 as printed adds 2 u_i delta u_i . s_i, s_i the sum of the kernel's gradient.

    A uniform velocity U therefore changes du_i/dt by 2 U delta u_i . s_i rho_0/rho_i, which
    vanishes where particles are even. Density does not notice.
    """
    boost = np.array([2.0, -1.0])
    boosted = state.copy()
    boosted[3:] += boost[:, None]
    discretization = Discretization(SPACING, 2.0 * SPACING, shifting_transport="paper")
    functional = Functional(FLUID, discretization, BOX)
    before = functional.evaluate(state[:2], state[2], state[3:])
    after = functional.evaluate(boosted[:2], boosted[2], boosted[3:])
    volume = functional.volume(state[2])
    sums = brute_force(state[:2].T, (1.0, 1.0), (True, True), 2.0 * SPACING, SPACING)
    uneven = np.sum(before.shifting_velocity * sums.kernel_gradient_sum(volume).T, axis=0)
    ratio = FLUID.reference_density / (FLUID.reference_density + state[2])
    assert_close(after.density, before.density)
    assert np.array_equal(after.shifting_velocity, before.shifting_velocity)
    change = after.velocity - before.velocity
    expected = 2.0 * boost[:, None] * uneven * ratio
    assert np.max(np.abs(change - expected)) < 1e-11 * np.max(np.abs(before.velocity))
    assert np.max(np.abs(expected)) > 1e-3 * np.max(np.abs(before.velocity))


def test_the_reference_density_is_a_unit(state: np.ndarray) -> None:
    """A fluid seven times as dense moves alike, its densities and their rates sevenfold."""
    state[2] *= 3.0
    dense = state.copy()
    dense[2] *= 7.0
    fluid = Fluid(7.0 * FLUID.reference_density, 10.0, 0.01, 1.0)
    out = Functional(fluid, Discretization(SPACING, 2.0 * SPACING), BOX)(dense)
    expected = rates(state)
    expected[2] *= 7.0
    assert_rows_close(out, expected)
