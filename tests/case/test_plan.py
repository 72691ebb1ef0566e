"""The plan of a case: what follows from its keys, for every kind of scene."""

from __future__ import annotations

import json

import pytest

from sphrom.case.discretization_checks import fitting_resolutions
from sphrom.case.hints import case_warnings
from sphrom.case.loader import load_case
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.template import examples
from sphrom.sph.fluid import Discretization, Fluid, step_limits
from sphrom.sph.walls.kinds import KINDS

LID = "name: box\nscene:\n  kind: lid-driven-cavity\n"


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


CHANNEL = "box: {upper: [6, 6.6], periodic: [x]}"
BODY = "solids: {body: {circle: {centre: [3, 3.3], radius: 0.7}}}"


@pytest.mark.parametrize(
    ("scene", "speed", "expected"),
    [
        (f"kind: custom, {CHANNEL}, body_force: [0.2, 0]", 0.07, 0.7),  # on nothing
        (f"kind: custom, {CHANNEL}, {BODY}, body_force: [0.2, 0]", 0.07, 6.3246),
        (f"kind: custom, {CHANNEL}, body_force: [0.4 * sin(pi * x / 3), 0]", 0.07, 8.9443),
        ("kind: custom, body_force: ['9 * exp(-t)', '-18 * exp(-t)']", 1.0, 30.0),
        ("kind: custom, walls: {top: {velocity: [1, 0]}}", 1.0, 40.8248),  # 2.5 nu U / dx
        ("kind: lid-driven-cavity, lid: uniform", 2.0, 81.6497),
        ("kind: custom, box: {upper: [8, 4], periodic: [x]}", 0.06, 0.69282),  # nu U L / H^2
    ],
)
def test_the_density_changes_by_three_per_cent_at_most(load, scene, speed, expected):
    rest = f"fluid: {{reference_speed: {speed}}}\ndiscretization: {{resolution: 20}}\n"
    rest += "parameters: {train: {reynolds: [1]}}\ntime: {final_time: 100}\n"
    case = load(rest, base=f"name: slow\nscene: {{{scene}}}\n")
    assert case.plan.sound_speed == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("scene", "head"),
    [
        # Of the force to the centre, only half of each line adds: the integral of x from 0 to 1.8.
        ("gravity: 0}, body_force: [-x, -y]", 2 * 1.62),
        ("gravity: 1}", 3.6),  # what falls may fill the box to its top
        ("gravity: 1}, body_force: ['sin(pi*t)', 0]", 7.2),
    ],
)
def test_the_head_of_a_drop_is_that_of_the_force_across_its_box(load, scene, head):
    box = "box: {lower: [-1.8, -1.8], upper: [1.8, 1.8]}"
    drop = f"kind: custom, {box}, fluid: {{circle: {{centre: [0, 0], radius: 1}}, {scene}"
    case = load("rom: []\n", base=f"name: drop\nscene: {{{drop}}}\n")
    assert case.scene.largest_head(100.0) == pytest.approx(head, rel=1e-2)


def test_cases_that_come_with_the_program_keep_their_mach_number():
    for case in map(load_case, examples().values()):
        assert case.plan.sound_speed == case.plan.max_speed / case.fluid.mach_number


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
    assert case.plan.flow(case.plan.points[0]).exact is None


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
    assert case.plan.n_ghosts == len(domain.ghosts(spacing, case.plan.n_wall_layers).position)


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


def test_given_interval_wins_over_the_trained_range(load):
    text = LOCAL.replace("[50, 100]}", "[50, 100], interval: [10, 90]}")
    case = load(text, base=LID)
    assert case.basis.subsets["low"].bounds == {"reynolds": (10.0, 90.0)}
    assert case.plan.local_bases(ParameterPoint(20.0)) == ["low"]
    assert case.plan.local_bases(ParameterPoint(95.0)) == []


def sections(**values: object) -> str:
    """Return sections as YAML, with no reduced models."""
    return "".join(f"{name}: {json.dumps(value)}\n" for name, value in values.items()) + "rom: []\n"


@pytest.mark.parametrize("resolution", [40, 43, 58])
def test_a_spin_up_of_as_many_steps_as_there_are_between_snapshots(load, resolution: int) -> None:
    """No step is longer than the target, and none has to be shorter."""
    grid = {"resolution": resolution}
    step = load(sections(discretization=grid), base=LID).plan.step_target
    time = {"spin_up": 10.0 * step, "final_time": 20.0 * step}
    case = load(sections(discretization=grid, time=time), base=LID)
    assert case.plan.steps.time_step == pytest.approx(step, rel=1e-9)


@pytest.mark.parametrize("resolution", [12, 20, 28])
def test_a_support_of_half_a_periodic_box(load, resolution: int) -> None:
    ratio = {"resolution": resolution, "smoothing_length_ratio": resolution / 4.0}
    load(sections(discretization=ratio), "scene.length=0.7")


@pytest.mark.parametrize(
    ("resolution", "nearest"), [(40, [40, 40]), (41, [40, 44]), (47, [44, 48]), (9, [8, 12])]
)
def test_the_nearest_resolutions_that_fit_are_a_coarser_and_a_finer_one(
    resolution: int, nearest: list[int]
) -> None:
    """Walls of the open cavity lie at quarters of the channel's length."""
    case = Case.model_construct(
        scene=Case.model_validate({"name": "x", "scene": {"kind": "open-cavity"}}).scene,
        discretization=type("Section", (), {"resolution": resolution}),
    )
    assert fitting_resolutions(case) == nearest


TANK = """
name: tank
scene: {kind: custom, slip: free, reference_length: 0.5, fluid: {level: 0.5, gravity: 1.0}}
rom: []
"""


def test_walls_that_give_energy_to_slipping_fluid_are_warned_of(load):
    for kind in (name for name, rule in KINDS.items() if rule.below_surfaces):
        case = load(f"discretization: {{walls: {{kind: {kind}}}}}\n", base=TANK)
        warned = any("gains energy" in text for text in case_warnings(case))
        assert warned == KINDS[kind].drives_slip


@pytest.mark.parametrize(
    ("base", "resolution", "ratio", "says"),
    [
        (TANK, 20, 1.2, "particles below a free surface are noisy"),
        (TANK, 20, 2.0, ""),
        (TANK, 20, 2.5, ""),
        (TANK, 20, 4.0, "h is 0.2 of the flow's length, too wide"),
        (None, 20, 3.0, "discretization.resolution: 24"),
        (None, 20, 2.5, ""),
        (None, 20, 1.2, ""),
        (None, 50, 4.0, ""),
        (None, 300, 4.0, ""),
    ],
)
def test_kernels_that_are_too_narrow_or_too_wide_are_warned_of(load, base, resolution, ratio, says):
    """The vortex has h = 4 dx in the paper; what counts is h over the flow's length."""
    size = f"discretization: {{resolution: {resolution}, smoothing_length_ratio: {ratio}}}\n"
    case = load(size) if base is None else load(size, base=base)
    told = [text for text in case_warnings(case) if "smoothing_length_ratio" in text]
    assert [says in text for text in told] == [True] * bool(says)


def test_the_cause_of_a_raised_speed_of_sound_is_named(load):
    """Without walls there is no friction at them."""
    own = "parameters: {train: {reynolds: [1.0e-3]}}\n"
    assert load(own).plan.heads.keys() == {"the body force", "viscous friction in the fluid"}
    lid = "name: x\nscene: {kind: lid-driven-cavity}\n"
    assert "friction at walls" in load(own, base=lid).plan.heads


def test_the_compared_line_avoids_solids(load):
    wall = "solids: {wall: {rectangle: {lower: [0.4, 0], upper: [0.6, 1]}}}"
    scene = f"name: x\nscene:\n  kind: custom\n  {wall}\n"
    case = load("discretization: {resolution: 40}\n", base=scene)
    assert 0.3 < case.plan.probe_line < 0.4 or 0.6 < case.plan.probe_line < 0.7
