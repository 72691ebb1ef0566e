"""What models on the reference points need of memory and disk."""

from __future__ import annotations

import pytest

from sphrom.case.geometry import n_particles
from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.setup.check import FILES, REMEDIES
from sphrom.setup.cost import estimate, estimate_stage


def make(kind: str = "taylor-green", **model: object) -> Case:
    rom = [{"name": "x", "evaluation": "operators", **model}]
    return Case.model_validate({"name": "x", "scene": {"kind": kind}, "rom": rom})


def test_every_stage_has_a_remedy_and_files() -> None:
    stages = estimate(make()).stages
    assert "operators" in stages
    assert set(stages) == set(REMEDIES) == set(FILES)


def test_particles_alone_need_no_operators() -> None:
    assert "operators" not in estimate(make(evaluation="particles")).stages


@pytest.mark.parametrize("kind", ["taylor-green", "open-cavity"])
def test_a_closure_grows_with_the_fourth_power_of_the_modes(kind: str) -> None:
    def disk(n_modes: int, **model: object) -> int:
        return estimate_stage(make(kind, n_modes=n_modes, **model), "operators").disk

    closures = [disk(n, projection="apg") - disk(n, calibrated=False) for n in (10, 20)]
    assert closures[0] > 3 * 8 * 10**4
    assert 10.0 < closures[1] / closures[0] <= 16.0


def test_without_fields_a_run_takes_next_to_nothing() -> None:
    case = make(n_modes=5)
    none, snapshots, particles = (
        estimate_stage(make(n_modes=5, **model), "rom").disk
        for model in ({}, {"output": "snapshots"}, {"evaluation": "particles"})
    )
    n_snapshots = step_plan(case).n_snapshots
    assert none == 8 * (6 + 5) * n_snapshots
    assert snapshots - none == 8 * n_particles(case) * (4 * n_snapshots + 2)
    assert snapshots < particles


def test_probes_take_what_is_kept_there() -> None:
    none, probes = (
        estimate_stage(make(n_modes=5, output=output), "rom").disk for output in ("none", "probes")
    )
    section = make().compare
    per_snapshot = 3 * 8 * (section.line_points + section.grid**2)
    assert probes - none == per_snapshot * step_plan(make()).n_snapshots


def test_values_without_a_full_run_take_room_too() -> None:
    one, two = (make(parameters=values) for values in ([100.0], [100.0, 130.0]))
    assert estimate_stage(two, "rom").disk == 2 * estimate_stage(one, "rom").disk
    assert estimate_stage(two, "fom").disk == estimate_stage(one, "fom").disk
