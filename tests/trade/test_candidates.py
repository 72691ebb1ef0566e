from __future__ import annotations

import pytest

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.trade.candidates import candidates, global_basis, trade_points

FAST = {"name": "fast", "evaluation": "operators", "n_modes": 5}


def case(*models: dict[str, object], **trade: object) -> Case:
    return Case.model_validate(
        {
            "name": "x",
            "scene": {"kind": "taylor-green"},
            "parameters": {"train": {"reynolds": [100, 200]}, "test": {"reynolds": [150]}},
            "basis": {
                "n_modes": 30,
                "subsets": {"low": {"reynolds": [100, 150], "interval": [50, 160]}},
            },
            "rom": models or ({"name": "galerkin"},),
            "trade": trade,
        }
    )


def labels(given: Case) -> list[str]:
    return [candidate.label for candidate in candidates(given, trade_points(given))]


def test_what_is_weighed_unless_a_case_says_else():
    assert [p.reynolds for p in trade_points(case())] == [150]
    found = candidates(case(), trade_points(case()))
    assert {c.method.evaluation for c in found} == {"operators"}
    sizes = {p: {c.n_modes for c in found if c.method.projection == p} for p in ("galerkin", "apg")}
    assert sizes == {"galerkin": {2, 5, 10, 20, 30}, "apg": {2, 5, 10, 20}}
    assert {(c.method.projection, c.method.calibrated) for c in found} == {
        ("galerkin", True), ("apg", False),
    }  # fmt: skip


def test_labels_tell_what_differs():
    few = {"n_modes": [5], "step_factors": [1, 0.25]}
    assert labels(case(projections=["galerkin"], **few)) == [
        "Galerkin, calibrated, M = 5", "Galerkin, calibrated, M = 5, 0.25 dt",
    ]  # fmt: skip
    found = labels(case(evaluations=["operators", "particles"], bases=["all", "low"], **few))
    assert found[2] == "APG, basis all, M = 5"
    assert found[-1] == "Galerkin, on particles, basis low, M = 5, 0.25 dt"
    assert len(set(found)) == len(found) == 12


def test_only_galerkin_models_with_operators_are_evaluated_otherwise_or_calibrated():
    given = case(
        evaluations=["particles", "operators"], projections=["galerkin", "apg"],
        n_modes=[2], calibrated=[True, False], step_factors=[1], inner_products=["raw"],
    )  # fmt: skip
    found = candidates(given, trade_points(given))
    assert [candidate.family for candidate in found] == [
        "Galerkin, on particles", "APG, on particles",
        "Galerkin, calibrated", "Galerkin", "APG",
    ]  # fmt: skip
    assert {candidate.method.inner_product for candidate in found} == {"raw"}
    names = [candidate.model.name for candidate in found]
    assert len(set(names)) == len(names)


def test_local_bases():
    few = {"n_modes": [2], "step_factors": [1], "projections": ["galerkin"]}
    (found,) = candidates(case(bases=["local"], **few), [ParameterPoint(150.0)])
    assert found.model.basis == "local"
    assert global_basis(case(bases=["local"])) == "all"
    assert global_basis(case(bases=["low"])) == "low"
    assert global_basis(case({**FAST, "basis": "low"})) == "low"
    with pytest.raises(CaseError, match="200"):
        candidates(case(bases=["local"], **few), [ParameterPoint(200.0)])
