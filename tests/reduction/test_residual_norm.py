"""The residual's norm from small factors, against the residual at all points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sphrom.reduction import operator_projection
from sphrom.reduction.memory_projection import project_memory
from sphrom.reduction.operator_projection import project_operators, residual_factor
from sphrom.reduction.reduced_operators import residual_norm

NU = 0.01
AROUND = ({"viscosity": NU, "amplitude": -1.4}, {"viscosity": 3.0 * NU, "amplitude": 0.0})


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
        model_factor, amplitude = factor.of_model(operators, np.arange(5)), around["amplitude"]
        states = np.array([[1.0], [0.3], [0.0]]) * setting.coordinates
        found = residual_norm(model_factor, around["viscosity"], states, np.full(3, amplitude))
        expected = [model.residual(state, around) for state in states]
        np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-11)


@pytest.mark.parametrize(
    ("name", "kept"), [("forced", [0]), ("forced", [0, 1, 2]), ("lid", [0, 2, 3])]
)
def test_fewer_modes_leave_out_more(settings, unprojected, name: str, kept: list[int]) -> None:
    """One factor serves all sizes: modes left out are among what is left out."""
    points, basis = settings[name].points, settings[name].basis
    operators = project_operators(points, basis)
    factor = residual_factor(points, basis, operators)
    fewer = replace(
        basis, density_modes=basis.density_modes[kept], velocity_modes=basis.velocity_modes[kept]
    )
    state, amplitude = np.zeros(5), np.array([AROUND[0]["amplitude"]])
    state[kept] = settings[name].coordinates[kept]
    expected = unprojected(points, fewer, order=1).residual(state[kept], AROUND[0])
    part, whole = (factor.of_model(operators, np.array(modes)) for modes in (kept, range(5)))
    found = residual_norm(part, NU, state[None, kept], amplitude)
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    assert found > residual_norm(whole, NU, state[None], amplitude)


def test_a_closure_leaves_the_projected_rates(settings, unprojected) -> None:
    setting = settings["forced"]
    operators = project_operators(setting.points, setting.basis)
    factor = residual_factor(setting.points, setting.basis, operators)
    memory = project_memory(setting.points, setting.basis).at(NU)
    length, state, around = 1e-2, setting.coordinates, AROUND[0]
    closed = operators.at(NU).plus(memory, length)
    closure = memory.scaled(length)
    driven = np.array([around["amplitude"]])
    here = factor.of_model(operators, np.arange(5)), NU, state[None], driven
    model = unprojected(setting.points, setting.basis, order=1)
    rates = closed(state, around["amplitude"])
    expected = model.residual(state, around, rates)
    found = residual_norm(*here, closure=closure)
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    assert found > 1.001 * residual_norm(*here)


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
        residual_norm(factor.of_model(operators, np.arange(5)), NU, states)
        for factor in (whole, reduced)
    )
    np.testing.assert_allclose(found, expected, rtol=1e-4)
