"""The polynomial closure against Eq. 3.22 with the Jacobian at all points."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.reduction.memory_projection import project_memory
from sphrom.reduction.operator_projection import project_operators
from sphrom.reduction.polynomial_model import OutputTimes, PolynomialModel

NU = 0.01
AROUND = {"viscosity": NU, "amplitude": -1.4}


@pytest.mark.parametrize("advection", ["spline", "sph"])
def test_the_polynomial_is_the_closure(setting, unprojected, advection: str) -> None:
    splines = setting.splines if advection == "spline" else None
    memory = project_memory(setting.points, setting.basis, splines)
    direct = unprojected(setting.points, setting.basis, splines, order=1)
    for scale, viscosity in ((1.0, NU), (0.3, NU), (1.0, 3.0 * NU)):
        expected = direct.memory(scale * setting.coordinates, AROUND | {"viscosity": viscosity})
        found = memory.at(viscosity)(scale * setting.coordinates, AROUND["amplitude"])
        assert np.max(np.abs(found - expected)) < 1e-9 * np.max(np.abs(expected))


def test_a_closed_model_runs_as_it_is_evaluated(settings) -> None:
    here = settings["forced"]
    rates = project_operators(here.points, here.basis).at(NU)
    memory = project_memory(here.points, here.basis).at(NU)
    closed = rates.plus(memory, 1e-3)
    step = 1e-6
    run = PolynomialModel(closed).run(
        1, here.coordinates, OutputTimes(step, 2), lambda time: np.full(time.shape, 0.7)
    )
    change = (run.coordinates[1] - here.coordinates) / step
    assert np.allclose(change, closed(here.coordinates, 0.7), rtol=1e-3, atol=1e-6)
