"""What a user is told before a run: particles, ghosts, steps, and how near limits are."""

from __future__ import annotations

import re
from pathlib import Path
from unittest.mock import Mock

import pytest

from sphrom.case.geometry import n_ghosts, n_particles
from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.setup.check import FILES, REMEDIES, describe_cost, describe_run, run
from sphrom.setup.context import StageContext
from sphrom.setup.cost import BASELINE, estimate, estimate_stage
from sphrom.setup.times import _coarser, sweep_seconds, wall_times


def described(case: Case) -> str:
    reporter = Mock()
    describe_run(case, case.points[0], reporter)
    return str(reporter.info.call_args.args[0])


def make(kind: str, **sections: object) -> Case:
    return Case.model_validate({"name": "x", "scene": {"kind": kind}, **sections})


def test_periodic_scene_has_neither_ghosts_nor_a_spin_up() -> None:
    assert described(make("taylor-green")) == (
        "reynolds=100: 10000 particles, 201 neighbours each, c0 = 10 m/s, nu = 0.01 m2/s; 210 "
        "steps of 0.004762 s, 79% of the acoustic limit and 24% of the viscous one; 22 snapshots"
    )


def test_open_cavity_tells_its_ghosts_its_spin_up_and_its_force_s_limit() -> None:
    case = make("open-cavity", parameters={"train": {"reynolds": [1e5]}})
    assert described(case) == (
        "reynolds=100000: 15000 particles and 2000 ghosts, 50 neighbours each, c0 = 20 m/s, nu = "
        "4e-06 m2/s; 33350 steps to spin up and 6670 steps to record, of 0.0001499 s, 50% of "
        "the acoustic limit, less than 1% of the viscous one and 10% of the body force's; 668 "
        "snapshots"
    )


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({}, "1 full run and 1 reduced run: about "),
        ({"test": {"reynolds": [150]}}, "2 full runs and 2 reduced runs: about "),
    ],
)
def test_runs_are_counted_in_words_that_agree(parameters: dict, expected: str) -> None:
    reporter = Mock()
    describe_cost(make("lid-driven-cavity", parameters=parameters), reporter)
    assert str(reporter.info.call_args.args[0]).startswith(expected)


@pytest.mark.parametrize("kind", ["lid-driven-cavity", "open-cavity"])
def test_ghosts_take_memory_and_are_kept_once_a_run(kind: str) -> None:
    thin, thick = (make(kind, discretization={"walls": {"layers": n}}) for n in (1, 8))
    less, more = (estimate_stage(case, "fom") for case in (thin, thick))
    assert BASELINE < less.ram < more.ram
    assert more.disk - less.disk == 4 * 8 * (n_ghosts(thick) - n_ghosts(thin))
    assert estimate_stage(thin, "map") == estimate_stage(thick, "map")


def test_of_a_spin_up_only_its_end_is_kept() -> None:
    short, long = (
        make("open-cavity", time={"spin_up": start, "final_time": start + 1.0})
        for start in (0.0, 5.0)
    )
    less, more = (estimate_stage(case, "fom") for case in (short, long))
    assert less.ram == more.ram
    assert more.disk - less.disk == 5 * 8 * n_particles(long)


def test_reduced_runs_with_local_bases_take_what_those_bases_take() -> None:
    parameters = {"train": {"reynolds": [50, 100, 150]}}
    subsets = {"low": {"reynolds": [50, 100]}, "high": {"reynolds": [100, 150]}}

    def memory(basis: str) -> int:
        case = make(
            "lid-driven-cavity",
            parameters=parameters,
            basis={"subsets": subsets},
            rom=[{"name": "x", "basis": basis}],
        )
        return estimate_stage(case, "rom").ram

    assert memory("local") == memory("all")


def checked(case: Case, tmp_path: Path) -> str:
    reporter = Mock()
    run(StageContext(case, tmp_path, False, None, reporter))
    return "\n".join(call.args[0] for call in reporter.info.call_args_list)


def test_shapes_are_measured_in_supports_and_runs_in_seconds(tmp_path: Path) -> None:
    scene = {
        "kind": "custom",
        "box": {"upper": [6, 4], "periodic": ["x"]},
        "solids": {"disc": {"circle": {"centre": [3, 2], "radius": 1}}},
        "reference_length": 1.0,
    }
    case = Case.model_validate({"name": "x", "scene": scene, "discretization": {"resolution": 10}})
    told = checked(case, tmp_path)
    assert (
        "the fluid's area is 20.86 m2; narrowest gap 1 m, 2.5 times the support's radius; "
        "thinnest solid 2 m, 5 times the support's radius"
    ) in told
    assert re.search(
        r"1 full run: about [\d.]+ \w+ on this machine as it is now, [\d.]+ ms a", told
    )


def test_every_stage_and_the_sweep_are_told_in_seconds(tmp_path: Path) -> None:
    case = make(
        "taylor-green",
        discretization={"resolution": 20, "smoothing_length_ratio": 2.0},
        sweep={"reynolds": [100.0, 150.0]},
    )
    told = checked(case, tmp_path)
    times = r"map \S+ \w+, pod \S+ \w+, operators \S+ \w+, rom \S+ \w+, compare \S+ \w+; all of"
    assert re.search(times, told)
    assert re.search(r"the sweep: about \S+ \w+ of one core", told)


def test_wall_times_grow_with_what_is_run() -> None:
    particles, fast = {"name": "slow"}, {"name": "fast", "evaluation": "operators"}
    one, both = (
        wall_times(make("taylor-green", rom=rom), 0.01) for rom in ([fast], [fast, particles])
    )
    assert both["fom"] == one["fom"] == pytest.approx(2.1)
    assert both["rom"] > 2.0 * both["fom"] > 10.0 * one["rom"]
    assert set(wall_times(make("taylor-green", rom=[]), 0.01)) == {"fom", "compare"}
    full = make("taylor-green", rom=[], sweep={"reynolds": [100.0, 150.0]})
    assert sweep_seconds(full, 0.01) == pytest.approx(2.0 * one["fom"])


def test_few_snapshots_are_warned_of(tmp_path: Path) -> None:
    def warned(n_modes: int) -> list[str]:
        reporter = Mock()
        model = {"name": "fast", "evaluation": "operators", "n_modes": n_modes}
        case = make("taylor-green", discretization={"resolution": 16}, rom=[model])
        run(StageContext(case, tmp_path, False, None, reporter))
        return [call.args[0] for call in reporter.warn.call_args_list]

    assert warned(2) == []
    (line,) = warned(10)
    assert line.startswith("snapshots.every: 10 modes from ")


def test_a_case_of_many_particles_is_timed_coarser() -> None:
    fine = _coarser(make("open-cavity", discretization={"resolution": 2000}))
    assert fine is not None
    assert 2_000 < n_particles(fine) < 25_000
    assert _coarser(make("taylor-green")) == make("taylor-green")


def fast(kind: str = "taylor-green", **model: object) -> Case:
    return make(kind, rom=[{"name": "x", "evaluation": "operators", **model}])


def test_every_stage_has_a_remedy_and_files() -> None:
    assert set(estimate(fast()).stages) == set(REMEDIES) == set(FILES)
    particles_alone = estimate(fast(evaluation="particles")).stages
    assert set(FILES) - set(particles_alone) == {"operators"}


@pytest.mark.parametrize("kind", ["taylor-green", "open-cavity"])
def test_a_closure_grows_with_the_fourth_power_of_the_modes(kind: str) -> None:
    def disk(n_modes: int, **model: object) -> int:
        return estimate_stage(fast(kind, n_modes=n_modes, **model), "operators").disk

    closures = [disk(n, projection="apg") - disk(n, calibrated=False) for n in (10, 20)]
    assert closures[0] > 3 * 8 * 10**4
    assert 10.0 < closures[1] / closures[0] <= 16.0


def test_a_run_takes_what_is_kept_of_it() -> None:
    none, snapshots, particles, probes = (
        estimate_stage(fast(n_modes=5, **model), "rom").disk
        for model in (
            {}, {"output": "snapshots"}, {"evaluation": "particles"}, {"output": "probes"},
        )
    )  # fmt: skip
    case = fast()
    n_snapshots, section = step_plan(case).n_snapshots, case.compare
    assert none == 8 * (6 + 5) * n_snapshots
    assert snapshots - none == 8 * n_particles(case) * (4 * n_snapshots + 2)
    assert snapshots < particles
    assert probes - none == 3 * 8 * (section.line_points + section.grid**2) * n_snapshots


def test_values_without_a_full_run_take_room_too() -> None:
    one, two = (fast(parameters=values) for values in ([100.0], [100.0, 130.0]))
    assert estimate_stage(two, "rom").disk == 2 * estimate_stage(one, "rom").disk
    assert estimate_stage(two, "fom").disk == estimate_stage(one, "fom").disk
