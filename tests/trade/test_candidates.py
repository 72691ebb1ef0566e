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


def test_what_is_weighed_unless_a_case_says_else():
    assert [p.reynolds for p in trade_points(case())] == [150]
    found = candidates(case(), trade_points(case()), "all")
    assert {model.evaluation for model in found} == {"operators"}
    sizes = {p: {m.n_modes for m in found if m.projection == p} for p in ("galerkin", "apg")}
    assert sizes == {"galerkin": {2, 5, 10, 20, 30}, "apg": {2, 5, 10, 20}}
    assert {(model.projection, model.is_calibrated) for model in found} == {
        ("galerkin", True), ("apg", False),
    }  # fmt: skip


def test_models_have_the_basis_of_the_first():
    local = case({**FAST, "basis": "local"}, n_modes=[2])
    found = candidates(local, [ParameterPoint(150.0)], "local")
    assert {each.basis for each in found} == {"local"}
    assert global_basis(local) == "all"
    assert global_basis(case({**FAST, "basis": "low"})) == "low"
    with pytest.raises(CaseError, match="200"):
        candidates(local, [ParameterPoint(200.0)], "local")
