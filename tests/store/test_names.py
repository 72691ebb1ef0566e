"""No two values share a file, a folder, a row of a journal or of a table."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace
from sphrom.trade.models import (
    candidates,
    courant_number,
    extreme_points,
    trade_points,
    variants,
    varied_models,
)

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


def test_models_of_a_trade_at_close_steps_are_told_apart():
    given = case(step_factors=[1.0, 1.0000001], n_modes=[3])
    labels = [candidate.label for candidate in candidates(given, trade_points(given))]
    assert len(set(labels)) == len(labels) > 1


def test_full_runs_of_a_trade_at_close_steps_are_told_apart():
    given = case(courant_numbers=[0.0101, 0.0102, 0.0103], resolutions=[16])
    found = variants(given)
    assert len({variant.name for variant in found.values()}) == len(found) == 3
    ((label, alone),) = variants(case(courant_numbers=[0.75], resolutions=[16])).items()
    assert label == f"full, 16 across, C = {courant_number(alone):.2g}"


def test_full_models_at_close_values_are_told_apart():
    extremes = {"mach_numbers": [0.1, 0.1000001], "smoothing_length_ratios": [2.0, 2.0000001]}
    found = varied_models(case(extremes=extremes), [])
    assert len(found) == len({variant.name for variant in found.values()}) == 4
    assert found["Mach number", 0.1].name == "extreme-16-mach0.1"


def test_products_are_not_called_after_their_rounding_errors():
    given = case(extremes={"reynolds_factors": [0.3, 1.1]})
    given = given.model_copy(update={"parameters": type(given.parameters).model_validate(
        {"train": {"reynolds": [100, 200]}})})  # fmt: skip
    assert [point.label for point in extreme_points(given)] == ["reynolds=30", "reynolds=220"]
