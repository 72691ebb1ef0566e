"""What just fits is accepted, however its numbers are rounded."""

from __future__ import annotations

import json

import pytest

from sphrom.case.plan import step_plan, step_target

LID = "name: small\nscene: {kind: lid-driven-cavity}\n"


def sections(**values: object) -> str:
    """Return sections as YAML, with no reduced models."""
    return "".join(f"{name}: {json.dumps(value)}\n" for name, value in values.items()) + "rom: []\n"


@pytest.mark.parametrize("resolution", range(40, 60, 3))
def test_a_spin_up_of_as_many_steps_as_there_are_between_snapshots(load, resolution: int) -> None:
    """No step is longer than the target, and none has to be shorter."""
    grid = {"resolution": resolution}
    step = step_target(load(sections(discretization=grid), base=LID))
    time = {"spin_up": 10.0 * step, "final_time": 20.0 * step}
    case = load(sections(discretization=grid, time=time), base=LID)
    assert step_plan(case).time_step == pytest.approx(step, rel=1e-9)


@pytest.mark.parametrize("resolution", [12, 20, 28])
def test_a_support_of_half_a_periodic_box(load, resolution: int) -> None:
    ratio = {"resolution": resolution, "smoothing_length_ratio": resolution / 4.0}
    load(sections(discretization=ratio), "scene.length=0.7")
