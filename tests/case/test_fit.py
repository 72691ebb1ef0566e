"""The section `fit`: its model, and which parameters are looked for where."""

from __future__ import annotations

from typing import Any

import pytest

from sphrom.case.loader import load_case
from sphrom.case.studies import fast_model, fit_ranges, fit_values, percent
from sphrom.errors import CaseError

CASE: dict[str, Any] = {
    "name": "lid",
    "scene": {"kind": "lid-driven-cavity"},
    "discretization": {"resolution": 10},
    "time": {"final_time": 0.5},
    "snapshots": {"every": 5},
    "parameters": {"train": {"reynolds": [50, 200], "lid": [0.5, 1.0]}},
    "rom": [
        {"name": "slow", "n_modes": 3},
        {"name": "fast", "evaluation": "operators", "n_modes": 3},
        {"name": "other", "evaluation": "operators", "n_modes": 2},
    ],
}


def test_what_varies_is_looked_for_where_it_was_trained():
    case = load_case(CASE)
    model = fast_model(case, case.fit.model)
    assert model is not None
    assert model.name == "fast"
    assert fit_ranges(case, model) == {"reynolds": (50.0, 200.0), "lid": (0.5, 1.0)}
    assert fit_values(case) == {}


def test_ranges_and_values():
    parameters = {"lid": 0.8, "reynolds": [60, 90]}
    case = load_case({**CASE, "fit": {"model": "other", "parameters": parameters}})
    model = fast_model(case, case.fit.model)
    assert model is not None
    assert model.name == "other"
    assert fit_ranges(case, model) == {"reynolds": (60.0, 90.0)}
    assert fit_values(case) == {"lid": 0.8}


def test_percentages():
    assert [percent(given, "--noise") for given in ("1%", " 0.5 % ", "2", 3.0)] == [1, 0.5, 2, 3]
    for given in ("", "%", "much", "0%", "-1%", "nan", "1e9%", "1e-300%"):
        with pytest.raises(CaseError, match="--noise: must be a percentage from 1e-06% to"):
            percent(given, "--noise")
