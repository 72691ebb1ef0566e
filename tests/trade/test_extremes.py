from __future__ import annotations

import math
from typing import Any

import pytest

from sphrom.case.models import Case
from sphrom.trade.candidates import extreme_points
from sphrom.trade.extreme_rows import MOST_GROWTH, ExtremeRow, _cell, stability_maps, state_of


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


def test_maps_say_where_nothing_is_compared():
    rows = [
        row(compared_with=""),
        row(parameters="b", n_modes=5, value=0.5),
        row(parameters="b"),
    ]
    ((first, second),) = stability_maps(rows)
    assert first.title == "a\n(no full run)"
    assert second.title == "b"
    assert (second.n_modes, second.values) == ([2, 5], [0.5, 1.0])
    assert first.states == {(2, 1.0): "stable"}


def test_what_is_no_step_has_maps_below():
    rows = [
        row(),
        row(varied="h/dx", value=4.0, state="refused", compared_with=""),
        row(varied="memory length", value=0.1, n_modes=3, projection="apg"),
        row(varied="h/dx", value=1.3),
    ]
    (steps,), (ratios, memory) = stability_maps(rows)
    assert steps.axis.startswith("step over")
    assert ratios.axis.startswith("h/dx")
    assert ratios.states == {(2, 4.0): "refused", (2, 1.3): "stable"}
    assert ratios.title == "a"
    assert memory.title == "APG models, a"
    # Rows of maps share their axis of modes.
    assert memory.n_modes == ratios.n_modes == steps.n_modes == [2, 3]
