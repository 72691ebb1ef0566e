"""The polynomial closure against Eq. 3.22 with the Jacobian at all points."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.reduction.memory_operators import project_memory
from sphrom.reduction.mode_fields import mode_fields, mode_gradients, weighted_rows
from sphrom.reduction.operator_projection import project_operators
from sphrom.reduction.polynomial_model import OutputTimes, PolynomialModel
from sphrom.sph.fixed_points import EVERYWHERE

NU = 0.01
AROUND = {"viscosity": NU, "amplitude": -1.4}
NAMES = [
    "periodic",
    "lid",
    "lid with its mean",
    "driven lid",
    "forced",
    "forced between driven walls",
    "raw and forced",
]


@pytest.fixture(params=NAMES)
def setting(request, settings):
    return settings[request.param]


class Direct:
    """Eq. 3.22 with fields at all points; a quadratic's central difference is its derivative."""

    def __init__(self, setting, splines, rates) -> None:
        self.rates = rates
        self.points = setting.points
        self.fields = mode_fields(setting.basis, setting.points)
        self.weights = weighted_rows(setting.basis, self.fields, EVERYWHERE)
        everywhere = slice(0, self.points.n_points)
        self.slopes = mode_gradients(self.points, self.fields, splines)(everywhere)

    def projected(self, rates: np.ndarray) -> np.ndarray:
        return np.einsum("mfn,fn->m", self.weights, rates)

    def memory(self, coordinates: np.ndarray) -> np.ndarray:
        factors = self.fields.coefficients(coordinates)
        q, u = self.fields.scaled_density @ factors, self.fields.velocity @ factors
        slopes = self.slopes @ factors
        rates = self.rates(self.points, q, u, slopes, AROUND, 1)
        inside, n = self.projected(rates), self.fields.n_modes
        rest = rates - np.stack(
            (
                self.fields.scaled_density[:, :n] @ inside,
                *(self.fields.velocity[..., :n] @ inside),
            )
        )
        more = np.stack([self.points.gradients(field) for field in rest])
        ahead, back = (
            self.rates(self.points, q + s * rest[0], u + s * rest[1:], slopes + s * more, AROUND, 1)
            for s in (1e-3, -1e-3)
        )
        return self.projected(ahead - back) / 2e-3


@pytest.mark.parametrize("advection", ["spline", "sph"])
def test_the_polynomial_is_the_closure(setting, point_rates, advection: str) -> None:
    splines = setting.splines if advection == "spline" else None
    memory = project_memory(
        setting.points,
        setting.basis,
        splines,
        kinematic_viscosity=NU,
    )
    direct = Direct(setting, splines, point_rates)
    for scale in (1.0, 0.3):
        expected = direct.memory(scale * setting.coordinates)
        found = memory(scale * setting.coordinates, AROUND["amplitude"])
        assert np.max(np.abs(found - expected)) < 1e-9 * np.max(np.abs(expected))


def test_tensors_are_symmetric_and_as_many_as_the_drive_asks_for(setting) -> None:
    memory = project_memory(setting.points, setting.basis, kinematic_viscosity=NU)
    driven = setting.points.body_force is not None or setting.points.walls_driven
    assert [len(tensors) for tensors in memory.powers] == ([4, 3, 2] if driven else [4])
    cubic = memory.powers[0][3]
    assert np.allclose(cubic, cubic.transpose(0, 2, 1, 3))
    assert np.allclose(cubic, cubic.transpose(0, 3, 2, 1))


def test_a_closed_model_runs_as_it_is_evaluated(settings) -> None:
    here = settings["forced"]
    rates = project_operators(here.points, here.basis).at(NU)
    memory = project_memory(here.points, here.basis, kinematic_viscosity=NU)
    closed = rates.plus(memory, 1e-3)
    step = 1e-6
    run = PolynomialModel(closed).run(
        1, here.coordinates, OutputTimes(step, 2), lambda time: np.full(time.shape, 0.7)
    )
    change = (run.coordinates[1] - here.coordinates) / step
    assert np.allclose(change, closed(here.coordinates, 0.7), rtol=1e-3, atol=1e-6)
