"""Models that run without particles, by the members that all users of one share."""

from __future__ import annotations

import math
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from sphrom.case.sections import ReducedModelSection
from sphrom.metrics.series import kinetic_energy
from sphrom.models.points.fast_model import FastModel, FastRun
from sphrom.reduction.polynomial_model import Run

SECTION = ReducedModelSection(name="quick", evaluation="operators")


def workspace_with(*, surface: bool) -> Mock:
    workspace = Mock()
    workspace.case.scene.has_surface = surface
    workspace.case.plan.mass = 0.5
    workspace.case.plan.basis_for.return_value = "all"
    return workspace


def test_a_run_knows_its_energy_and_its_largest_speed() -> None:
    model, modes = FastModel(workspace_with(surface=False), SECTION), np.array([[[3.0, 4.0]]])
    basis = SimpleNamespace(n_modes=1, velocity_modes=modes)
    state = np.array([[1.0], [-2.0]])
    about = Run(np.arange(2.0), state, time_step=1.0, diverged_at=math.nan)
    run = FastRun(**vars(about), model=model, point=Mock(), reduced=Mock(basis=basis))
    expected = [kinetic_energy(each * modes[0], 0.5) for each in state]
    np.testing.assert_allclose(run.kinetic_energy, expected, rtol=1e-14)
    assert run.largest_speed == pytest.approx(10.0, rel=1e-14)
