from __future__ import annotations

import math
from typing import Any

import pytest

from sphrom.case.models import Case
from sphrom.trade.candidates import extreme_points
from sphrom.trade.extreme_rows import MOST_GROWTH, ExtremeRow, _cell, stability_map, state_of


def row(**changes: Any) -> ExtremeRow:
    keys: dict[str, Any] = {
        "parameters": "a",
        "varied": "time step",
        "value": 1.0,
        "n_modes": 2,
        "projection": "galerkin",
        "calibrated": False,
        "state": "stable",
        "velocity_error": math.pi,
        "compared_with": "full run",
    }
    return ExtremeRow(**keys | changes)


def test_states():
    assert state_of(None, None, 10.0) == "unstable"
    assert state_of(9.0, 100.0, 10.0) == "stable"
    assert state_of(11.0, 1.0, 10.0) == "inaccurate"
    assert state_of(None, MOST_GROWTH, 10.0) == "stable"
    assert state_of(None, 1.1 * MOST_GROWTH, 10.0) == "inaccurate"


def test_cells_say_how_a_run_fared():
    assert _cell(row()) == "3.14"
    assert _cell(row(state="inaccurate", velocity_error=20.0)) == "20.0 ~"
    assert _cell(row(state="unstable", velocity_error=None)) == "unstable"
    assert _cell(row(state="full unstable", velocity_error=None)) == "full unstable"


def test_values_reach_out_of_the_trained_range():
    case = Case.model_validate(
        {
            "name": "x",
            "scene": {"kind": "taylor-green"},
            "parameters": {"train": {"reynolds": [100, 200]}},
            "trade": {"extremes": {"reynolds_factors": [10.0, 0.1, 1.0, 0.5]}},
        }
    )
    values = [point.reynolds for point in extreme_points(case)]
    assert values == pytest.approx([10.0, 50.0, 200.0, 2000.0])


def test_a_map_has_a_state_for_each_run():
    found = stability_map([row(n_modes=5, value=0.5), row(state="refused"), row(value=0.5)])
    assert found.title == "a"
    assert found.axis.startswith("step over")
    assert (found.n_modes, found.values) == ([2, 5], [0.5, 1.0])
    assert found.states == {(5, 0.5): "stable", (2, 1.0): "refused", (2, 0.5): "stable"}
    assert stability_map([row(compared_with="")]).title == "a (no full run)"
    closed = stability_map([row(varied="memory length", projection="apg")])
    assert closed.title == "APG, a"
    assert closed.axis.startswith("memory length")
