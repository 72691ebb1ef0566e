"""Forces on walls in generalized coordinates, against those of the fields that they mean."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.models.points.force_training import chosen_loads
from sphrom.reduction.force_projection import project_forces
from sphrom.reduction.held_out import DIVERGED
from sphrom.reduction.reduced_measures import TimedLoads
from sphrom.reduction.stokes_fields import StokesFields
from sphrom.sph.functional import MeasuredWall
from tests.reduction.conftest import N_MODES, SPACING

NU, AMPLITUDE, MEAN = 0.013, -1.4, 0.3
NAMES = ["lid", "lid with its mean", "driven lid", "forced", "raw", "raw and forced"]
RANDOM = np.random.default_rng(8)
TIMES, AMPLITUDES = np.zeros(2), np.full(2, AMPLITUDE)


def a_wall(n_ghosts: int) -> MeasuredWall:
    """Return a wall that weighs ghosts at random."""
    weights = np.random.default_rng(5).standard_normal((3, 2, n_ghosts))
    return MeasuredWall(weights, circulation=0.7)


def expected(points, wall: MeasuredWall, q: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Return the pressure's and the viscous loads (2, 3) of fields at the points."""
    pressure = points.ghost_pressures(q[:, None], velocity[..., None])[..., 0]
    if points.body_force is not None:
        head = (1.0 + q / points.sound_speed) * points.body_force
        pressure = pressure + AMPLITUDE * points.ghost_heads(head)
    speed = AMPLITUDE if points.walls_driven else 1.0
    viscous = points.ghost_friction(velocity[..., None])[..., 0] + speed * points.ghost_drag
    loads = np.stack((wall.loads(pressure), NU * wall.loads(viscous)))
    loads[1, 2] -= NU * speed * points.fluid.reference_density * wall.circulation
    return loads


@pytest.mark.parametrize("name", NAMES)
def test_forces_are_those_of_the_fields(settings, unprojected, name: str) -> None:
    setting = settings[name]
    points = setting.points
    wall = a_wall(points.ghost_drag.shape[1])
    force = project_forces(points, setting.basis, wall)
    states = np.outer((1.0, 0.3), setting.coordinates)
    kept, some = np.array([0, 3]), states * [1.0, 0.0, 0.0, 1.0, 0.0]
    local = force.at(NU, points.walls_driven)
    few = force.of_modes(kept).at(NU, points.walls_driven)
    np.testing.assert_allclose(
        few.at(TIMES, some[:, kept], some[:, kept], AMPLITUDES, MEAN),
        local.at(TIMES, some, some, AMPLITUDES, MEAN),
        rtol=1e-12,
    )
    found = local.at(TIMES, states, states, AMPLITUDES, MEAN)
    model = unprojected(points, setting.basis)
    for coordinates, loads in zip(states, found, strict=True):
        q, velocity = model.fields(coordinates)
        wanted = expected(points, wall, q + points.density_scale * MEAN, velocity)
        np.testing.assert_allclose(loads, wanted, rtol=1e-9, atol=1e-11 * np.abs(wanted).max())


@pytest.mark.parametrize("name", ["lid", "forced"])
def test_with_a_stokes_flow_the_whole_force_is_the_balance_of_momentum(settings, name) -> None:
    setting = settings[name]
    points, basis, splines = setting.points, setting.basis, setting.splines
    n = points.n_points
    value, slope = RANDOM.standard_normal((3, n, 2)), RANDOM.standard_normal((3, n, 2, 2))
    tested = StokesFields(np.array([True, False, True]), value, slope)
    wall = a_wall(points.ghost_drag.shape[1])
    force = project_forces(points, basis, wall, balance=(tested, splines))
    state, rates = setting.coordinates, RANDOM.standard_normal(N_MODES)
    about = TIMES[:1], state[None], rates[None], AMPLITUDES[:1], MEAN
    found = force.at(NU).at(*about)[0]
    wanted = project_forces(points, basis, wall).at(NU).at(*about)[0]

    velocity = np.tensordot(state, basis.velocity_modes, 1)
    change = np.tensordot(rates, basis.velocity_modes, 1)
    gradients = splines.values_and_gradients(points.position)[1].reshape(n, N_MODES, 3, 2)[:, :, 1:]
    gradient = np.tensordot(state, gradients, (0, 1))
    strain, tested_strain = (0.5 * (g + g.swapaxes(-1, -2)) for g in (gradient, slope))
    push = np.zeros((n, 2)) if points.body_force is None else AMPLITUDE * points.body_force.T
    integrand = np.einsum("nd,lnd->ln", push - change, value)
    integrand += np.einsum("ni,nj,lnij->ln", velocity, velocity, slope)
    integrand -= 2.0 * NU * np.einsum("nij,lnij->ln", strain, tested_strain)
    balanced = points.fluid.reference_density * SPACING**2 * integrand.sum(axis=1)
    wanted[0, [0, 2]] = balanced[[0, 2]] - wanted[1, [0, 2]]
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


def test_own_pressure_modes_replace_the_balance_of_momentum_in_some_loads(settings) -> None:
    setting = settings["forced"]
    points, basis, n = setting.points, setting.basis, setting.points.n_points
    tested = StokesFields(
        np.ones(3, dtype=bool), RANDOM.standard_normal((3, n, 2)), np.zeros((3, n, 2, 2))
    )
    wall, modes = a_wall(points.ghost_drag.shape[1]), RANDOM.standard_normal((4, n))
    balance = tested, setting.splines
    force = project_forces(points, basis, wall, balance=balance, pressure_modes=modes)
    assert force.own is not None
    state, own = setting.coordinates[None], RANDOM.standard_normal((1, 3))  # without the last mode
    about = TIMES[:1], state, state, AMPLITUDES[:1], MEAN
    loads = np.array([False, True, True])
    found = force.with_own(force.own, loads).at(NU).at(*about, own=own)[0]
    balanced = project_forces(points, basis, wall, balance=balance).at(NU).at(*about)[0]
    summed = project_forces(points, basis, wall).at(NU).at(*about)[0]
    pressure = own @ modes[:3]
    added = wall.loads(points.ghost_pressures(pressure.T, np.zeros((2, n, 1))))[:, 0]
    wanted = np.where(loads, summed + np.stack((added, np.zeros(3))), balanced)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-11 * np.abs(wanted).max())


def test_own_pressure_modes_are_chosen_for_the_loads_that_they_improve_clearly() -> None:
    places = np.arange(4.0)[:, None]
    joint = np.full((4, 3), 0.2)
    own = joint * [0.1, 0.9, 1.5]
    own[0], own[3] = 9.0, 0.0  # outside of the others, so that they do not count
    assert chosen_loads(np.stack((joint, own)), places).tolist() == [True, False, False]
    own[2] = DIVERGED
    joint[2] = DIVERGED
    assert chosen_loads(np.stack((joint, own)), places).tolist() == [True, False, False]


def test_what_training_runs_add_keeps_its_later_mean_after_them() -> None:
    time, parts = np.linspace(0.0, 1.0, 11), RANDOM.standard_normal((11, 12))
    added, whole = TimedLoads.of(time, parts), parts[:, :6] + parts[:, 6:]
    np.testing.assert_allclose(added.at(time), whole)
    np.testing.assert_allclose(added.at(np.array([0.05])), whole[:2].mean(axis=0)[None])
    np.testing.assert_allclose(added.at(np.array([3.0])), whole[5:].mean(axis=0)[None])
