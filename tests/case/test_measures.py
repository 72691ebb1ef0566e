"""What a case measures: its keys, and what is refused."""

from __future__ import annotations

from typing import Any

import pytest
import yaml

from sphrom.case.identity import resolved_yaml, section_inputs
from sphrom.case.loader import case_of_text, load_case
from sphrom.case.models import Case
from sphrom.case.schema import json_schema
from sphrom.case.template import scene_kinds
from sphrom.errors import CaseError

SCENE: dict[str, Any] = {
    "kind": "custom",
    "box": {"lower": [0, 0], "upper": [6, 4], "periodic": ["x"]},
    "solids": {"cylinder": {"circle": {"centre": [3, 2], "radius": 1}}},
    "reference_length": 2.0,
}
MEASURE: dict[str, Any] = {
    "drag": {"force_on": "cylinder"},
    "roof": {"force_on": "top"},
    "flux": {"flow_rate": {"from": [3, 0], "to": [3, 1]}},
    "wake": {"probe": [5, 2]},
    "profile": {"line": {"from": [5, 0], "to": [5, 4]}},
}


def case_of(measure: dict[str, Any], **sections: Any) -> Case:
    scene = {**SCENE, "measure": measure}
    return load_case(
        {"name": "x", "scene": scene, "discretization": {"resolution": 60}, **sections}
    )


def test_measurements_by_kind() -> None:
    scene = case_of(MEASURE).scene
    assert scene.measured_walls == {"drag": "cylinder", "roof": "top"}
    assert list(scene.measured_fields) == ["flux", "wake", "profile"]
    line = scene.measure["profile"].line
    assert line is not None
    assert (line.start, line.end, line.points) == ((5.0, 0.0), (5.0, 4.0), 101)
    assert scene.measure["flux"].quantities == ("flow_rate",)
    assert case_of({}).scene.measured_walls == {}


def test_a_case_that_measures_is_written_in_full_and_read_back() -> None:
    case = case_of(MEASURE)
    text = resolved_yaml(case)
    assert yaml.safe_load(text)["scene"]["measure"]["flux"]["flow_rate"] == {
        "from": [3.0, 0.0],
        "to": [3.0, 1.0],
    }
    assert case_of_text(text) == case


def test_what_was_made_before_measurements_had_kinds_is_still_valid() -> None:
    stored = section_inputs(case_of({"drag": {"force_on": "cylinder"}}), ["scene"])["scene"]
    assert isinstance(stored, dict)
    assert stored["measure"] == {"drag": {"force_on": "cylinder"}}
    for kind in scene_kinds():
        case = Case.model_validate({"name": "x", "scene": {"kind": kind}})
        assert "measure" not in str(section_inputs(case, ["scene"]))


def test_the_schema_knows_the_keys() -> None:
    definitions = json_schema()["$defs"]
    assert set(definitions["LineSection"]["properties"]) == {"from", "to", "points"}
    assert set(definitions["MeasureSection"]["properties"]) == {
        "force_on", "flow_rate", "probe", "line",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("measure", "words"),
    [
        ({}, "scene.measure.a: must be exactly one of force_on, flow_rate, probe, line; got none"),
        ({"force_on": "top", "probe": [1, 1]}, "got force_on and probe"),
        ({"force_on": "ball"}, "a.force_on: there is no such wall; the walls are bottom, top, cyl"),
        ({"force_on": 1}, "scene.measure.a.force_on: "),
        ({"force_on": "top", "on": 1}, "scene.measure.a.on: unknown key"),
        ({"probe": [3, 2.5]}, "scene.measure.a.probe: (3, 2.5) m is in a solid"),
        ({"probe": [7, 2]}, "scene.measure.a.probe: (7, 2) m is outside of the box"),
        ({"probe": [1]}, "scene.measure.a.probe"),
        ({"probe": [float("nan"), 1]}, "scene.measure.a.probe.0: must be a number"),
        ({"line": {"from": [1, 1], "to": [1, 1]}}, "scene.measure.a.line: its ends are one place"),
        ({"line": {"from": [1, 1]}}, "scene.measure.a.line.to: is missing"),
        ({"line": {"from": [1, 1], "to": [2, 1], "points": 1}}, "line.points: must be a whole"),
        ({"line": {"from": [1, 1], "to": [1, 5]}}, "m is outside of the box"),
        (
            {"flow_rate": {"from": [3, 0], "to": [3, 4]}},
            "scene.measure.a.flow_rate: (3, 1.00624) m is in a solid; give a segment for each part",
        ),
        ({"flow_rate": {"start": [3, 0], "to": [3, 1]}}, "flow_rate.start: unknown key"),
    ],
)
def test_refusals(measure: dict[str, Any], words: str) -> None:
    with pytest.raises(CaseError) as error:
        case_of({"a": measure})
    assert words in str(error.value)


def test_names_are_safe() -> None:
    with pytest.raises(CaseError, match="a name of at most 64 letters"):
        case_of({"a/b": {"force_on": "top"}})


def test_ends_on_walls_and_tangents_are_fine() -> None:
    on_walls = {"flow_rate": {"from": [3, 3], "to": [3, 4]}}
    tangent = {"line": {"from": [0, 3], "to": [6, 3]}}
    assert case_of({"gap": on_walls, "over": tangent, "top": {"probe": [3, 3]}})


def test_a_trade_by_what_is_not_measured() -> None:
    assert case_of(MEASURE, trade={"measure": "drag"})
    with pytest.raises(
        CaseError, match=r"trade\.measure: nothing measured has the name dragg; .*drag"
    ):
        case_of(MEASURE, trade={"measure": "dragg"})
    with pytest.raises(CaseError, match=r"trade\.measure: .* scene\.measure is empty"):
        case_of({}, trade={"measure": "drag"})
