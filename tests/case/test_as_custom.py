"""The named scenes as scenes of kind custom: the same fields, and what `case show` prints."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from sphrom.case.as_custom import equivalent
from sphrom.case.loader import load_case
from sphrom.case.models import Case
from sphrom.case.template import scene_kinds
from sphrom.cli.app import app
from sphrom.setup import assembly


@pytest.mark.parametrize(
    "scene",
    [
        {"kind": "taylor-green", "length": 2.0},
        {"kind": "taylor-green", "pressure_sign": "paper"},
        {"kind": "lid-driven-cavity", "length": 0.5},
        {"kind": "lid-driven-cavity", "lid": "uniform"},
        {"kind": "open-cavity"},
        {"kind": "open-cavity", "body_force": {"form": "ramp-up"}, "cavity_height": 0.05},
    ],
)
def test_the_custom_scene_is_the_same_flow(scene: dict) -> None:
    fluid = {"reference_speed": 3.0, "reference_density": 2.0}
    named = Case.model_validate({"name": "x", "scene": scene, "fluid": fluid})
    section, _ = equivalent(named)
    own = named.model_copy(
        update={
            "scene": Case.model_validate(
                {"name": "x", "scene": {"kind": "custom", **section}}
            ).scene
        }
    )
    point = named.points[0]
    assert own.kinematic_viscosity(point) == pytest.approx(named.kinematic_viscosity(point))
    ours, theirs = assembly.scene(own, point), assembly.scene(named, point)
    domain = theirs.domain
    assert (ours.domain.lower, ours.domain.upper) == (domain.lower, domain.upper)
    assert ours.domain.area == pytest.approx(domain.area)
    generator = np.random.default_rng(1)
    place = domain.lower + generator.random((500, 2)) * domain.lengths
    np.testing.assert_array_equal(ours.domain.contains(place), domain.contains(place))
    inside = place[domain.contains(place)]
    for field in ("initial_velocity", "initial_pressure"):
        np.testing.assert_allclose(
            getattr(ours, field)(inside), getattr(theirs, field)(inside), atol=1e-12
        )
    if theirs.body_force is None:
        assert ours.body_force is None
    else:
        for time in (0.0, 0.029, 0.05, 6.0):
            np.testing.assert_allclose(
                ours.body_force(inside.T, time), theirs.body_force(inside.T, time), rtol=1e-9
            )
    x = np.linspace(0.01, 0.99, 50) * domain.lengths[0]
    lid = np.stack((x, np.full_like(x, domain.upper[1] + 1e-3)), axis=1)
    np.testing.assert_allclose(ours.wall_velocity(lid), theirs.wall_velocity(lid), atol=1e-12)


def shown(*arguments: object) -> str:
    result = CliRunner().invoke(app, ["case", "show", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.mark.parametrize("kind", scene_kinds())
def test_what_is_shown_is_the_whole_case(kind: str, tmp_path: Path) -> None:
    path, again = tmp_path / "case.yaml", tmp_path / "again.yaml"
    path.write_text(f"name: mine\nscene: {{kind: {kind}}}\n")
    text = shown(path, "--set", "compare.line_points=51")
    again.write_text(text)
    case = load_case(again)
    assert case.compare.line_points == 51
    assert case == load_case(path, ["compare.line_points=51"])
    block = text.partition("# scene:")[2]
    assert bool(block) == (kind != "custom")
    if block:
        scene = yaml.safe_load("scene:" + block.replace("\n# ", "\n"))
        assert scene["scene"]["kind"] == "custom"


def test_a_ramp_is_said_to_be_left_out(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_text("name: x\nscene: {kind: lid-driven-cavity, lid_ramp: 0.5}\n")
    assert "# The lid's ramp is left out.\n" in shown(path)


def test_what_a_named_scene_measures_is_shown(tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    measure = "{centre: {probe: [0.5, 0.5]}, lid: {force_on: top}}"
    path.write_text(f"name: x\nscene: {{kind: lid-driven-cavity, measure: {measure}}}\n")
    block = shown(path).partition("# scene:")[2]
    scene = yaml.safe_load("scene:" + block.replace("\n# ", "\n"))["scene"]
    assert scene["measure"] == {"centre": {"probe": [0.5, 0.5]}, "lid": {"force_on": "top"}}
