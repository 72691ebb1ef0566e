from __future__ import annotations

import pytest

from sphrom.case.hints import case_warnings
from sphrom.case.points import ParameterPoint
from sphrom.sph.fluid import Discretization, Fluid, step_limits


def test_derived_quantities(load):
    case = load("scene: {kind: taylor-green, length: 2}\n", base="name: x\n")
    assert case.plan.particle_spacing == pytest.approx(0.02)
    assert case.plan.smoothing_length == pytest.approx(0.08)
    assert case.plan.sound_speed == pytest.approx(10.0)
    assert case.plan.kinematic_viscosity(ParameterPoint(50.0)) == pytest.approx(0.04)


def test_limits_are_those_of_the_physics(load):
    case = load("parameters: {train: {reynolds: [5, 100]}, test: {reynolds: [2]}}\n")
    plan = case.plan
    fluid = Fluid(1000.0, plan.sound_speed, plan.kinematic_viscosity(ParameterPoint(2.0)), 1.0)
    limits = step_limits(fluid, Discretization(plan.particle_spacing, plan.smoothing_length))
    assert plan.limits.acoustic == pytest.approx(limits.acoustic)
    assert plan.limits.viscous == pytest.approx(limits.viscous)


def test_given_step(load):
    plan = load("time: {step: 5e-4}\n").plan.steps
    assert (plan.time_step, plan.n_steps, plan.n_snapshots) == (5e-4, 2000, 201)
    assert plan.snapshot_interval == pytest.approx(5e-3)


@pytest.mark.parametrize(
    ("final_time", "every", "reynolds"), [(0.5, 3, 100.0), (1.0, 10, 0.5), (0.01, 2, 100.0)]
)
def test_automatic_step_keeps_both_limits_and_ends_on_a_snapshot(load, final_time, every, reynolds):
    case = load(
        f"time: {{final_time: {final_time}}}\nsnapshots: {{every: {every}}}\n"
        f"parameters: {{train: {{reynolds: [{reynolds}]}}}}\nrom: []\n"
    )
    plan = case.plan.steps
    share = plan.time_step / case.plan.limits.least
    assert share <= 0.8 * (1.0 + 1e-6)
    assert share > 0.8 * (plan.n_steps - every) / plan.n_steps
    assert plan.n_steps % every == 0
    assert plan.time_step * plan.n_steps == pytest.approx(final_time)


def test_automatic_step_at_courant_number_is_not_shortened_by_rounding(load):
    # 1.2 h / c0 = 0.0048, so 0.528 s are exactly 110 steps, but in floating point a little more.
    case = load("time: {final_time: 0.528}\n")
    assert case.time.final_time / case.plan.step_target > 110
    assert case.plan.steps.n_steps == 110


def test_run_that_ends_between_snapshots_is_warned_of(load):
    (warning,) = case_warnings(load("time: {step: 1e-3}\nsnapshots: {every: 7}\n"))
    assert warning == "snapshots.every: the last snapshot is at 0.994 s, before time.final_time"


@pytest.mark.parametrize(
    ("order", "degree", "warned"), [(3, 1, 0), (3, 0, 1), (5, 1, 1), (2, 1, 0)]
)
def test_splines_that_may_not_exist_are_warned_of(load, order, degree, warned):
    case = load(f"psi: {{order: {order}, polynomial_degree: {degree}}}\n")
    assert len(case_warnings(case)) == warned


def test_bases_and_their_sizes(load):
    case = load(
        "time: {step: 1e-3, final_time: 0.02}\n"
        "parameters: {train: {reynolds: [100, 200]}, test: {reynolds: [150]}}\n"
        "basis: {subsets: {low: {reynolds: [100]}}}\nrom: [{name: a, n_modes: 5}]\n"
    )
    low, high = ParameterPoint(100.0), ParameterPoint(200.0)
    assert case.plan.bases == {"all": (low, high), "low": (low,)}
    assert case.plan.basis_size("all") == 5
    assert case.plan.basis_size("low") == 3


def test_modes_without_reduced_models_are_as_many_as_there_can_be(load):
    case = load("time: {step: 1e-3, final_time: 0.02}\nrom: []\n")
    assert case.plan.basis_size("all") == 3


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [("all", [100, 200, 150]), ("train", [100, 200]), ("test", [150]), ("[200]", [200])],
)
def test_points_of_a_reduced_model(load, parameters, expected):
    case = load(
        "parameters: {train: {reynolds: [100, 200]}, test: {reynolds: [150]}}\n"
        f"rom: [{{name: a, parameters: {parameters}}}]\n"
    )
    assert [point.reynolds for point in case.plan.rom_points(case.rom[0])] == expected


def test_labels():
    assert ParameterPoint(100.0).label == "reynolds=100"
    assert ParameterPoint(12.5).file_label == "reynolds12.5"
    assert ParameterPoint(100.0000001).label == "reynolds=100.0000001"
    assert ParameterPoint(100.0000001).file_label == "reynolds100.0000001"
    assert ParameterPoint(100.0).as_dict() == {"reynolds": 100.0}
