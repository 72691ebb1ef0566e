"""The section `fit`: its model, and which parameters are looked for where."""

from __future__ import annotations

from typing import Any

import pytest

from sphrom.case.loader import load_case
from sphrom.case.studies import fit_model, fit_ranges, fit_values, percent
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
    model = fit_model(case)
    assert model is not None
    assert model.name == "fast"
    assert fit_ranges(case, model) == {"reynolds": (50.0, 200.0), "lid": (0.5, 1.0)}
    assert fit_values(case) == {}


def test_ranges_and_values():
    parameters = {"lid": 0.8, "reynolds": [60, 90]}
    case = load_case({**CASE, "fit": {"model": "other", "parameters": parameters}})
    model = fit_model(case)
    assert model is not None
    assert model.name == "other"
    assert fit_ranges(case, model) == {"reynolds": (60.0, 90.0)}
    assert fit_values(case) == {"lid": 0.8}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"model": "slow"}, "fit.model: no model with evaluation: operators has the name slow"),
        ({"model": "fst"}, "has the name fst; did you mean fast?"),
        ({"parameters": {"length": 1.0}}, "fit.parameters.length: does not vary in the case"),
        (
            {"parameters": {"lid": [1.0, 0.5]}},
            "from the lower to the higher value; got 1, 0.5",
        ),
        ({"parameters": {"lid": [1.0, 1.0]}}, "must go from the lower to the higher value"),
        ({"parameters": {"lid": [1.0]}}, "fit.parameters.lid"),
        ({"parameters": {"reynolds": [0, 100]}}, "fit.parameters.reynolds: must be above zero"),
        ({"parameters": {"lid": "fast"}}, "fit.parameters.lid"),
        ({"noise": 0}, "fit.noise"),
        ({"noise": "1%"}, "fit.noise"),
        ({"starts": 0}, "fit.starts"),
        ({"free": ["lid"]}, "fit.free"),
    ],
)
def test_what_is_refused(given, said):
    with pytest.raises(CaseError) as error:
        load_case({**CASE, "fit": given})
    assert said in str(error.value)


def test_percentages():
    assert [percent(given, "--noise") for given in ("1%", " 0.5 % ", "2", 3.0)] == [1, 0.5, 2, 3]
    for given in ("", "much", "0%", "-1%", "nan", "1e9%"):
        with pytest.raises(CaseError, match="--noise: must be a percentage above zero"):
            percent(given, "--noise")
