"""What a user is told before a run: particles, ghosts, steps, and how near limits are."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import pytest

from sphrom.case.models import Case
from sphrom.setup.context import StageContext
from sphrom.setup.cost import BASELINE, described_run, full_seconds, needs, run, stage_times
from sphrom.stages import PIPELINE
from sphrom.text import duration


def described(case: Case) -> str:
    return described_run(case, case.plan.points[0])


def make(kind: str, **sections: object) -> Case:
    return Case.model_validate({"name": "x", "scene": {"kind": kind}, **sections})


def test_periodic_scene_has_neither_ghosts_nor_a_spin_up() -> None:
    assert described(make("taylor-green")) == (
        "reynolds=100: 10000 particles, 201 neighbours each, c0 = 10 m/s, nu = 0.01 m2/s; 210 "
        "steps of 0.004762 s, 0.79 of the acoustic limit, 0.24 of the viscous limit; 22 snapshots"
    )


def test_open_cavity_tells_its_ghosts_its_spin_up_and_its_force_s_limit() -> None:
    case = make("open-cavity", parameters={"train": {"reynolds": [1e5]}})
    assert described(case) == (
        "reynolds=100000: 15000 particles and 2000 ghosts, 50 neighbours each, c0 = 20 m/s, nu = "
        "4e-06 m2/s; 7000 steps of 0.0001429 s after 35000 steps to spin up, 0.5 of the acoustic "
        "limit, 0.00039 of the viscous limit; 701 snapshots; "
        "no particles resolve layers of L / sqrt(Re) = 0.00063 m at walls"
    )


@pytest.mark.parametrize("kind", ["lid-driven-cavity", "open-cavity"])
def test_ghosts_take_memory_and_are_kept_once_a_run(kind: str) -> None:
    thin, thick = (make(kind, discretization={"walls": {"layers": n}}) for n in (1, 8))
    less, more = (needs(case)["fom"] for case in (thin, thick))
    assert BASELINE < less.ram < more.ram
    assert more.disk - less.disk == 4 * 8 * (thick.plan.n_ghosts - thin.plan.n_ghosts)
    assert needs(thin)["map"].disk == needs(thick)["map"].disk


def test_of_a_spin_up_only_its_end_is_kept() -> None:
    short, long = (
        make("open-cavity", time={"spin_up": start, "final_time": start + 1.0})
        for start in (0.0, 5.0)
    )
    less, more = (needs(case)["fom"] for case in (short, long))
    assert less.ram == more.ram
    assert more.disk - less.disk == 5 * 8 * long.plan.n_particles


def checked(case: Case, tmp_path: Path) -> str:
    reporter = Mock()
    run(StageContext(case, tmp_path, False, None, reporter))
    return "\n".join(call.args[0] for call in reporter.info.call_args_list)


def test_fluid_with_a_surface_has_its_own_area_and_change_of_density(tmp_path: Path) -> None:
    tank = {"box": {"upper": [1, 1]}, "fluid": {"level": 0.5, "gravity": 1.0}}
    fluid, steps = {"reference_speed": 0.1}, {"resolution": 32}
    sections = {"scene": {"kind": "custom", **tank}, "fluid": fluid, "discretization": steps}
    case = Case.model_validate({"name": "x", **sections})
    told = checked(case, tmp_path)
    assert "the fluid's area is 0.5 m2" in told
    assert "changes the density by about 1% at most" in told


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
    assert re.search(r"on disk; the full run about [\d.]+ \w+ on one core", told)


def test_few_snapshots_are_warned_of(tmp_path: Path) -> None:
    def warned(n_modes: int, **more: object) -> list[str]:
        reporter = Mock()
        model = {"name": "fast", "evaluation": "operators", "n_modes": n_modes}
        case = make("taylor-green", discretization={"resolution": 16}, rom=[model], **more)
        run(StageContext(case, tmp_path, False, None, reporter))
        return [call.args[0] for call in reporter.warn.call_args_list]

    assert warned(2) == []
    (line,) = warned(10)
    assert line.startswith("snapshots.every: basis all has 10 modes from ")
    assert warned(10, training={"reynolds": [50, 200]}) == []


def fast(kind: str = "taylor-green", **model: object) -> Case:
    return make(kind, rom=[{"name": "x", "evaluation": "operators", **model}])


def test_the_time_of_full_runs_is_that_of_their_steps() -> None:
    short, long = (make("open-cavity", time={"spin_up": t, "final_time": t + 1.0}) for t in (0, 1))
    assert full_seconds(long, 1) == pytest.approx(full_seconds(short, 2), rel=1e-3)


def test_tensors_of_memory_and_estimates_take_memory() -> None:
    def ram(**model: object) -> int:
        return needs(fast(**model))["operators"].ram

    assert ram(n_modes=20, projection="apg") - ram(n_modes=10, projection="apg") > 8 * 10**4
    assert ram(n_modes=20) > ram(n_modes=10) > BASELINE
    assert "operators" not in needs(fast(evaluation="particles"))


def test_a_run_takes_what_is_kept_of_it() -> None:
    none, snapshots, particles = (
        needs(fast(n_modes=5, **model))["rom"].disk
        for model in ({}, {"output": "snapshots"}, {"evaluation": "particles"})
    )
    case = fast()
    assert none == 0
    assert snapshots == 8 * case.plan.n_particles * (4 * case.plan.steps.n_snapshots + 2)
    assert snapshots < particles


def test_the_stages_are_the_parts_of_the_whole(tmp_path: Path) -> None:
    """The time of a stage with runs is that of the runs, shared by workers, and of loading."""
    models = [{"name": "x", "n_modes": 3}, {"name": "y", "evaluation": "operators", "n_modes": 3}]
    case = make("open-cavity", rom=models)
    context = StageContext(case, tmp_path, False, None, Mock())
    times = stage_times(context)
    assert tuple(times) == PIPELINE
    shared = stage_times(replace(context, workers=len(case.plan.points)))
    for stage, name in (("fom", "full runs"), ("map", "maps"), ("rom", "reduced runs")):
        loading = times[stage].seconds - times[stage].items[name]
        assert 0.0 < loading < 1.0
        parts = [seconds for item, seconds in times[stage].items.items() if item != name]
        assert times[stage].items[name] == pytest.approx(sum(parts) * len(case.plan.points))
        assert shared[stage].seconds == pytest.approx(loading + sum(parts))
    whole = sum(time.seconds for time in times.values())
    assert f"all stages of `sphrom run`: about {duration(whole)} on one core" in checked(
        case, tmp_path
    )
