"""No two values share a file, a folder, a row of a journal or of a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace
from sphrom.trade.candidates import FULL_MODEL, variants, varied_models

CLOSE = (100.0, 100.0000001)


def case(**trade: Any) -> Case:
    return Case.model_validate(
        {
            "name": "x",
            "scene": {"kind": "taylor-green"},
            "discretization": {"resolution": 16},
            "time": {"final_time": 0.4, "spin_up": 0.1},
            "parameters": {"train": {"reynolds": list(CLOSE)}},
            "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3}, {"name": "slow"}],
            "trade": trade,
        }
    )


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    return Workspace(StageContext(case(), tmp_path, False, 1, None))  # type: ignore[arg-type]


def test_artifacts_of_close_values_have_names_of_their_own(workspace):
    points = [ParameterPoint(value) for value in CLOSE]
    targets = (workspace.spin_up, workspace.full_run, workspace.mapped)
    for made in (*targets, *(lambda p, m=m: workspace.reduced_run(m, p) for m in case().rom)):
        one, other = (made(point) for point in points)
        assert one.path != other.path
        assert one.inputs_digest != other.inputs_digest
    assert workspace.full_run(points[0]).path.name == "fom-reynolds100.h5"
    assert len(workspace.basis().parents) == 2


def test_full_models_at_close_values_are_told_apart(monkeypatch):
    for name, values in {"Mach number": (0.1, 0.1000001), "h/dx": (2.0, 2.0000001)}.items():
        section, key, _ = FULL_MODEL[name]
        monkeypatch.setitem(FULL_MODEL, name, (section, key, values))
    own = case()
    found = [v.name for *_, v in varied_models(own, (own.plan.points, own.plan.points[0]), [])]
    assert len(set(found)) == len(found) >= 4
    assert "extreme-16-mach_number-0.1" in found


def test_full_runs_of_a_trade_are_told_apart():
    found = variants(own := case(resolutions=[16, 20]))
    assert len({variant.name for variant in found.values()}) == len(found) == 4
    for label, variant in found.items():
        across = variant.discretization.resolution
        ratio = variant.plan.steps.time_step / own.plan.steps.time_step
        assert label == f"full, {across} across, {ratio:.2g} dt"
