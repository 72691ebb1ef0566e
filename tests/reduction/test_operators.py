"""Projected operators against the projection of the right-hand side at all points."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from sphrom.reduction import operator_projection
from sphrom.reduction.operator_projection import project_operators
from sphrom.reduction.polynomial_model import OutputTimes, PolynomialModel, steady_state, step_limit
from sphrom.reduction.reduced_rates import spectrum
from sphrom.reduction.trial_basis import InnerProduct

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


@pytest.mark.parametrize("name", ["raw", "raw, periodic"])
def test_the_raw_product_creates_sound(settings, name: str) -> None:
    setting = settings[name]
    assert project_operators(setting.points, setting.basis).skewness > 0.1


def test_the_raw_product_diverges_where_the_acoustic_one_does_not(settings) -> None:
    """The same states span both bases; the raw one's Jacobian grows by hundreds a second."""
    growth, diverged = {}, {}
    for name in ("lid with its mean", "raw"):
        start, basis = settings[name].coordinates, settings[name].basis
        rates = project_operators(settings[name].points, basis).at(NU)
        growth[name] = spectrum(rates.jacobian(start)).largest_real_part
        output_times = OutputTimes(0.02, 501, largest_norm=1e3 * float(np.linalg.norm(start)))
        diverged[name] = PolynomialModel(rates).run(5000, start, output_times).diverged_at
    assert growth["lid with its mean"] < 0.0
    assert growth["raw"] > 100.0
    assert np.isnan(diverged["lid with its mean"])
    assert diverged["raw"] < 1.0


@pytest.mark.parametrize("name", ["lid", "forced"])
def test_nothing_depends_on_the_reference_density(settings, name: str) -> None:
    here = settings[name]
    light = replace(
        here, reference_density=1.2, product=InnerProduct.acoustic(1.2, here.points.sound_speed)
    )
    ours, theirs = (
        project_operators(each.points, each.basis).at(NU)(here.coordinates, 0.7)
        for each in (here, light)
    )
    close(ours, theirs, 1e-11)


@pytest.mark.parametrize("name", ["periodic", "driven lid"])
def test_the_step_limit_is_sharp(settings, name: str) -> None:
    """Around rest: stable a little below it, unstable a little above."""
    setting = settings[name]
    rates = project_operators(setting.points, setting.basis).at(NU)
    limit = step_limit(rates, np.zeros((1, rates.n_modes)))
    assert 0.0 < limit < math.inf
    start = 1e-6 * setting.coordinates
    finals = {
        share: PolynomialModel(rates).run(2000, start, OutputTimes(share * limit, 2001))
        for share in (0.9, 1.3)
    }
    assert np.isnan(finals[0.9].diverged_at)
    assert np.linalg.norm(finals[0.9].coordinates[-1]) < np.linalg.norm(start)
    assert np.isfinite(finals[1.3].diverged_at)


def test_a_driven_cavity_settles_where_newton_says(settings) -> None:
    """The smooth modes don't know the walls, but what drives and damps them balances."""
    setting = settings["lid"]
    rates = project_operators(setting.points, setting.basis).at(20.0 * NU)
    found = steady_state(rates, np.zeros(5))
    assert found.converged
    assert spectrum(rates.jacobian(found.coordinates)).largest_real_part < 0.0
    steps = OutputTimes(0.5 * step_limit(rates, found.coordinates[None]), 4001)
    run = PolynomialModel(rates).run(4000, np.zeros(5), steps)
    close(run.coordinates[-1], found.coordinates, 1e-6)
