"""What a case measures: its keys, and what is refused."""

from __future__ import annotations

from typing import Any

import yaml

from sphrom.case.loader import case_of_text, load_case
from sphrom.case.models import Case, resolved_yaml

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
