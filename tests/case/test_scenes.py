"""Kinds of scene: their defaults, their geometry on a lattice, and what follows from both."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.case.hints import case_warnings
from sphrom.case.points import ParameterPoint
from sphrom.sph.walls import build_walls

LID = "name: box\nscene:\n  kind: lid-driven-cavity\n"
OPEN = "name: open\nscene:\n  kind: open-cavity\n"
VORTEX = "name: vortex\nscene:\n  kind: taylor-green\n"


def test_given_values_win_over_the_scene_s_defaults(load):
    case = load("fluid: {reference_density: 3}\ntime: {final_time: 2}\n", base=LID)
    assert (case.fluid.reference_density, case.time.final_time) == (3.0, 2.0)
    assert load("", "time.spin_up=0", base=OPEN).time.spin_up == 0.0
    form = load("discretization: {shifting: {form: paper}}\n", base=LID).discretization.shifting
    assert (form.form, form.transport) == ("paper", "advective")
    assert load("fluid:\n", base=LID).fluid.reference_density == 1.0


def test_derived_quantities_of_the_open_cavity(load):
    case = load("", base=OPEN)
    assert case.plan.particle_spacing == pytest.approx(0.002)
    assert case.plan.kinematic_viscosity(case.plan.points[0]) == pytest.approx(2.0 * 0.2 / 2400.0)
    assert case.plan.sound_speed == pytest.approx(20.0)
    assert case.plan.probe_line == pytest.approx(0.25)
    assert case.plan.n_particles == 15_000
    assert case.plan.n_ghosts == 2000
    assert not case.scene.has_exact_solution


def test_derived_quantities_of_the_lid_driven_cavity(load):
    case = load("scene: {kind: lid-driven-cavity, length: 2}\n", base="name: box\n")
    assert case.plan.kinematic_viscosity(ParameterPoint(50.0)) == pytest.approx(0.04)
    assert case.plan.probe_line == 1.0
    assert case.plan.n_particles == 10_000
    assert case.plan.n_ghosts == 108**2 - 100**2


@pytest.mark.parametrize(
    ("asked", "ratio", "layers"), [("null", 2.0, 4), ("null", 1.5, 3), ("3", 2.0, 3)]
)
def test_layers_of_ghosts(load, asked, ratio, layers):
    text = f"discretization: {{smoothing_length_ratio: {ratio}, walls: {{layers: {asked}}}}}\n"
    assert load(text, base=LID).plan.n_wall_layers == layers


@pytest.mark.parametrize(
    ("base", "text"),
    [
        (LID, "discretization: {resolution: 20}\n"),
        (OPEN, "discretization: {resolution: 40}\n"),
        (OPEN, "discretization: {resolution: 80, walls: {layers: 3}}\n"),
    ],
)
def test_particles_and_ghosts_are_as_many_as_are_made(load, base, text):
    case = load(text, base=base)
    domain, spacing = case.scene.domain, case.plan.particle_spacing
    assert case.plan.n_particles == len(domain.fill(spacing))
    assert case.plan.n_ghosts == len(build_walls(domain, spacing, case.plan.n_wall_layers).position)


def test_a_periodic_scene_has_no_ghosts(load):
    assert load("").plan.n_ghosts == 0
    assert load("").plan.n_particles == 10_000


def test_keys_of_walls_are_for_scenes_with_walls(load, refusal):
    change = "discretization.walls.no_slip=paper"
    for base in (LID, OPEN):
        assert load("rom: []\n", change, base=base).discretization.walls.no_slip == "paper"
    (line,) = refusal("rom: []\n", change, base=VORTEX)
    assert "discretization.walls.no_slip: a scene of kind taylor-green has no walls" in line


@pytest.mark.parametrize(
    ("base", "changes", "removes"),
    [
        (VORTEX, (), True),
        (LID, (), True),
        (OPEN, (), True),
        (VORTEX, ("discretization.fixed_volume=false",), False),
        (LID, ("discretization.fixed_volume=false",), True),
        (OPEN, ("discretization.fixed_volume=false",), False),
        (LID, ("basis.inner_product=raw",), False),
        (LID, ("basis.mean_density=in-modes",), False),
        (OPEN, ("basis.mean_density=separate", "discretization.fixed_volume=false"), True),
    ],
)
def test_gauge(load, base, changes, removes):
    assert load("", *changes, base=base).plan.separate_mean_density is removes


def test_automatic_step_fits_spin_up_and_recorded_time(load):
    case = load("snapshots: {every: 7}\n", base=OPEN)
    plan = case.plan.steps
    assert plan.n_steps % 7 == 0
    assert plan.start_time == pytest.approx(5.0, rel=1e-12)
    assert plan.end_time == pytest.approx(6.0, rel=1e-12)
    assert plan.n_spin_up_steps == 5 * plan.n_steps
    assert plan.n_snapshots == plan.n_steps // 7 + 1
    limit = case.plan.limits.acoustic
    assert 0.49 * limit < plan.time_step <= 0.5 * limit * (1 + 1e-6)


def test_body_force_limits_the_step(load):
    force = "scene.body_force={magnitude: 1e5, sustained_share: 0}"
    case = load("", force, base=OPEN)
    assert case.plan.limits.body_force == pytest.approx(0.25 * (0.004 / 1e5) ** 0.5)
    assert case.plan.steps.time_step <= 0.5 * case.plan.limits.body_force
    assert load("").plan.limits.body_force == np.inf


LOCAL = """
parameters: {train: {reynolds: [50, 100, 150, 200]}, test: {reynolds: [75, 125]}}
basis:
  subsets:
    low: {reynolds: [50, 100]}
    middle: {reynolds: [100, 150]}
    high: {reynolds: [150, 200]}
    re100: {reynolds: [100]}
"""
LOCAL_MODEL = "rom: [{name: x, basis: local}]\n"


@pytest.mark.parametrize(
    ("reynolds", "name"),
    [
        (50, "low"), (75, "low"), (100, "middle"), (125, "middle"), (150, "high"), (200, "high"),
    ],
)  # fmt: skip
def test_local_basis_is_that_in_whose_interval_a_point_lies(load, reynolds, name):
    case = load(LOCAL + LOCAL_MODEL, base=LID)
    assert case.plan.basis_for(case.rom[0], ParameterPoint(float(reynolds))) == name


def test_named_basis_serves_every_point(load):
    case = load(LOCAL + "rom: [{name: x}, {name: y, basis: re100}]\n", base=LID)
    names = {case.plan.basis_for(model, point) for model in case.rom for point in case.plan.points}
    assert names == {"all", "re100"}


def test_given_interval_wins_over_the_trained_range(load):
    text = LOCAL.replace("[50, 100]}", "[50, 100], interval: [10, 90]}")
    case = load(text, base=LID)
    assert case.basis.subsets["low"].bounds == {"reynolds": (10.0, 90.0)}
    assert case.plan.local_bases(ParameterPoint(20.0)) == ["low"]
    assert case.plan.local_bases(ParameterPoint(95.0)) == []


def test_modes_of_a_local_basis_are_held_against_its_snapshots(refusal):
    short = "time: {step: 1.0e-3, final_time: 0.02}\n"  # 3 snapshots a run
    (line,) = refusal(short + LOCAL + "rom: [{name: x, basis: local, n_modes: 7}]\n", base=LID)
    assert "number of snapshots of basis low, 6; got 7" in line


def test_step_beyond_the_body_force_s_limit(refusal, load):
    text = "time: {step: 2e-4}\n"
    strong = "scene.body_force.magnitude=1e6"
    (line,) = refusal(text, strong, base=OPEN)
    assert "beyond the body-force limit of" in line
    assert "(0.25 sqrt(h / b))" in line
    assert case_warnings(load(text, base=OPEN)) == []


def test_run_that_ends_between_snapshots_counts_from_the_spin_up(load):
    text = "time: {step: 1e-4, spin_up: 1, final_time: 2}\nsnapshots: {every: 3000}\nrom: []\n"
    (warning,) = case_warnings(load(text, base=OPEN))
    assert warning == "snapshots.every: the last snapshot is at 1.9 s, before time.final_time"
