"""What just fits is accepted, however its numbers are rounded, and what nearly fits is named."""

from __future__ import annotations

import json

import pytest

from sphrom.case.checks import nearest_fitting_resolution
from sphrom.case.models import Case

LID = "name: small\nscene: {kind: lid-driven-cavity}\n"


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
    ("resolution", "nearest"), [(40, 40), (41, 40), (42, 44), (43, 44), (45, 44), (47, 48)]
)
def test_the_nearest_resolution_that_fits_may_be_coarser_or_finer(
    resolution: int, nearest: int
) -> None:
    """Walls of the open cavity lie at quarters of the channel's length."""
    case = Case.model_construct(
        scene=Case.model_validate({"name": "x", "scene": {"kind": "open-cavity"}}).scene,
        discretization=type("Section", (), {"resolution": resolution}),
    )
    assert nearest_fitting_resolution(case) == nearest
