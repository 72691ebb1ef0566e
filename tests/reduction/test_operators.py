"""Projected operators against the projection of the right-hand side at all points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sphrom.reduction import operator_projection
from sphrom.reduction.operator_projection import project_operators

NU = 0.01
AROUND = {"viscosity": NU, "amplitude": -1.4}


def close(actual: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    assert np.max(np.abs(actual - expected)) <= tolerance * np.max(np.abs(expected))


@pytest.mark.parametrize("advection", ["spline", "sph"])
def test_operators_are_the_projection_of_the_rates(setting, unprojected, advection: str) -> None:
    splines = setting.splines if advection == "spline" else None
    reduced = project_operators(setting.points, setting.basis, splines)
    model = unprojected(setting.points, setting.basis, splines, order=1)
    for around in (AROUND, {"viscosity": 3.0 * NU, "amplitude": 0.0}):
        rates = reduced.at(around["viscosity"])
        for scale in (1.0, 0.3):
            coordinates = scale * setting.coordinates
            close(rates(coordinates, around["amplitude"]), model(coordinates, around), 1e-10)


def test_blocks_make_no_difference(setting, monkeypatch) -> None:
    whole = project_operators(setting.points, setting.basis, setting.splines)
    monkeypatch.setattr(operator_projection, "BLOCK_VALUES", 6 * 6 * 50)
    done: list[int] = []
    parts = project_operators(setting.points, setting.basis, setting.splines, advance=done.append)
    assert len(done) > 3
    assert sum(done) == setting.points.n_points
    close(parts.at(NU)(setting.coordinates, 1.0), whole.at(NU)(setting.coordinates, 1.0), 1e-10)


@pytest.mark.parametrize("name", ["periodic", "lid", "forced"])
def test_projection_creates_no_sound(settings, name: str) -> None:
    """The gate of the acoustic product: pressure and divergence are skew, with a damper or not.

    What the damper adds only takes energy.
    """
    damped, free = (
        project_operators(setting.points, setting.basis)
        for setting in (settings[name], replace(settings[name], acoustic_damping=0.0))
    )
    for found in (damped, free):
        assert found.skewness < 1e-12
        assert np.max(np.abs(found.acoustic)) > 1.0
    close(damped.acoustic, free.acoustic, 1e-12)
    taken = damped.inertia[1] - free.inertia[1]
    close(taken, taken.T, 1e-10)
    power = np.linalg.eigvalsh(0.5 * (taken + taken.T))
    assert power.max() < 1e-12 * np.abs(power).max()
    assert power.min() < -1e-3
