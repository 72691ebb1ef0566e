"""The residual's norm from small factors, against the residual at all points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sphrom.reduction import operator_projection
from sphrom.reduction.memory_operators import project_memory
from sphrom.reduction.operator_projection import project_operators, residual_factor
from sphrom.reduction.reduced_operators import residual_norm
from sphrom.reduction.trial_basis import truncate

NU = 0.01
NAMES = [
    "periodic",
    "lid",
    "lid with its mean",
    "driven lid",
    "forced",
    "forced between driven walls",
    "raw",
    "raw and forced",
]
AROUND = ({"viscosity": NU, "amplitude": -1.4}, {"viscosity": 3.0 * NU, "amplitude": 0.0})


@pytest.fixture(params=NAMES)
def setting(request, settings):
    return settings[request.param]


@pytest.mark.parametrize("advection", ["spline", "sph"])
def test_the_norm_is_that_at_all_points(setting, unprojected, advection: str, monkeypatch) -> None:
    monkeypatch.setattr(operator_projection, "DROPPED", 0.0)
    splines = setting.splines if advection == "spline" else None
    operators = project_operators(setting.points, setting.basis, splines)
    model = unprojected(setting.points, setting.basis, splines, order=1)
    done: list[int] = []
    factor = residual_factor(setting.points, setting.basis, operators, splines, advance=done.append)
    assert sum(done) == setting.points.n_points
    assert len(done) > 1
    for around in AROUND:
        norm = residual_norm(factor, operators, np.arange(5), around["viscosity"])
        states = np.array([[1.0], [0.3], [0.0]]) * setting.coordinates
        found = norm(states, np.full(3, around["amplitude"]))
        expected = [model.residual(state, around) for state in states]
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize("n_modes", [1, 3])
def test_fewer_modes_leave_out_more(settings, unprojected, n_modes: int) -> None:
    """One factor serves all sizes: modes left out are among what is left out."""
    setting = settings["forced"]
    operators = project_operators(setting.points, setting.basis)
    factor = residual_factor(setting.points, setting.basis, operators)
    norm = residual_norm(factor, operators, np.arange(n_modes), NU)
    model = unprojected(setting.points, truncate(setting.basis, n_modes), order=1)
    state, around = setting.coordinates[:n_modes], AROUND[0]
    expected = model.residual(state, around)
    found = norm(state[None], np.array([around["amplitude"]]))
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    whole = residual_norm(factor, operators, np.arange(5), NU)
    padded = np.concatenate((state, np.zeros(5 - n_modes)))
    assert found > whole(padded[None], np.array([around["amplitude"]]))


def test_any_modes_may_be_kept(settings, unprojected) -> None:
    setting = settings["lid"]
    operators = project_operators(setting.points, setting.basis)
    factor = residual_factor(setting.points, setting.basis, operators)
    kept = np.array([0, 2, 3])
    basis = replace(
        setting.basis,
        density_modes=setting.basis.density_modes[kept],
        velocity_modes=setting.basis.velocity_modes[kept],
    )
    model = unprojected(setting.points, basis, order=1)
    state = setting.coordinates[kept]
    expected = model.residual(state, AROUND[0])
    found = residual_norm(factor, operators, kept, NU)(state[None])
    np.testing.assert_allclose(found, expected, rtol=1e-4)


def test_a_closure_leaves_the_projected_rates(settings, unprojected) -> None:
    setting = settings["forced"]
    operators = project_operators(setting.points, setting.basis)
    factor = residual_factor(setting.points, setting.basis, operators)
    memory = project_memory(setting.points, setting.basis, kinematic_viscosity=NU)
    length, state, around = 1e-2, setting.coordinates, AROUND[0]
    closed = operators.at(NU).plus(memory, length)
    closure = memory.scaled(length)
    norm = residual_norm(factor, operators, np.arange(5), NU, closure=closure)
    model = unprojected(setting.points, setting.basis, order=1)
    rates = closed(state, around["amplitude"])
    expected = model.residual(state, around, rates)
    found = norm(state[None], np.array([around["amplitude"]]))
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    without = residual_norm(factor, operators, np.arange(5), NU)
    assert found > 1.001 * without(state[None], np.array([around["amplitude"]]))


def test_directions_that_no_state_reaches_are_dropped(settings) -> None:
    setting = settings["lid"]
    operators = project_operators(setting.points, setting.basis)
    largest = np.array([1.0, 1.0, 1e-9, 1e-9, 1e-9])
    whole, reduced = (
        residual_factor(setting.points, setting.basis, operators, largest=size)
        for size in (None, largest)
    )
    assert len(reduced.inertia) < len(whole.inertia)
    states = largest * np.array([[0.5, -0.8, 1.0, -1.0, 0.3], [1.0, 1.0, 0.0, 0.0, 1.0]])
    expected, found = (
        residual_norm(factor, operators, np.arange(5), NU)(states) for factor in (whole, reduced)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-4)
