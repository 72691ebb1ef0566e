"""Measured histories in expressions of a case: their values, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from sphrom.case.hints import case_warnings
from sphrom.case.loader import case_of_text, load_case
from sphrom.case.models import Case, resolved_yaml, section_inputs
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError

TABLE = "time,ax\n0,0\n0.5,2\n2,-1\n"


@pytest.fixture
def load(tmp_path: Path):
    """Load a case with a table of some content, and keys of its scene."""

    def case(
        content: str | bytes | None = TABLE,
        /,
        history: Any = None,
        rom: Any = (),
        parameters: Any = None,
        **given: Any,
    ) -> Case:
        if content is not None:
            data = content if isinstance(content, bytes) else content.encode()
            (tmp_path / "sway.csv").write_bytes(data)
        scene = {
            "kind": "custom",
            "box": {"upper": [2, 1], "periodic": ["x"]},
            "histories": {"sway": {"file": "sway.csv", **(history or {})}},
            "body_force": ["0.1*sway(t)*sin(pi*y)", 0],
            **given,
        }
        keys = {"name": "x", "scene": scene, "time": {"final_time": 2.0}, "rom": [*rom]}
        keys |= {} if parameters is None else {"parameters": parameters}
        (tmp_path / "case.yaml").write_text(yaml.safe_dump(keys))
        return load_case(tmp_path / "case.yaml")

    return case


def force(case: Case, *times: float) -> list[float]:
    """Return the body force along x [m/s2] at (1, 0.5) m."""
    drive = case.plan.flow(case.plan.points[0]).body_force
    assert drive is not None
    return [float(drive(np.array([[1.0], [0.5]]), time)[0, 0]) for time in times]


@pytest.mark.parametrize(
    ("content", "history", "factor"),
    [
        (TABLE, {}, 0.1),
        ('\ufeff ax,n,"s"\r\n0,a,0\r\n\r\n2,b,0.5\n-1,c,"2"\n', {"time": "s", "value": "ax"}, 0.1),
        (TABLE, {"scale": 9.81}, 0.981),
    ],
)
def test_histories_are_linear_between_rows(load, content: str, history, factor: float) -> None:
    """In a channel and in a tank; fast models read a little beyond the end."""
    for fluid in ({}, {"fluid": {"level": 0.5}, "body_force": ["0.1*sway(t)", 0]}):
        values = force(load(content, history=history, **fluid), 0.0, 0.25, 0.5, 1.25, 2.0, 2.1)
        np.testing.assert_allclose(values, factor * np.array([0.0, 1.0, 2.0, 0.5, -1.0, -1.2]))


def test_what_the_table_holds_is_part_of_the_case(load, tmp_path: Path) -> None:
    case, other = load(), load(TABLE.replace("2,-1", "2,-2"))
    assert section_inputs(case, ["scene"]) != section_inputs(other, ["scene"])
    (tmp_path / "sway.csv").unlink()
    again = case_of_text(resolved_yaml(case))  # without its folder
    assert again == case
    assert force(again, 0.25) == force(case, 0.25)  # known to this process
    lost = resolved_yaml(case).replace(str(case.scene.histories["sway"].sha256), "f" * 64)
    with pytest.raises(CaseError, match=r"sway\.csv: can't be read"):
        force(case_of_text(lost), 0.25)
    with pytest.raises(CaseError, match=r"sway\.csv has changed"):
        load(history={"sha256": "f" * 64})


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "can't be read: No such file"),
        ("", "its first line must name"),
        ("0,0\n1,1\n", "must name a column of times and one of values"),
        ("t,a,b\n0,0,0\n1,1,1\n", "`value` choose; it names t, a, b"),
        ("t,t\n0,0\n1,1\n", "it names t, t"),
        ("time;ax\n0;0.5\n1;1,5\n", "line 3 has decimal commas, and line 2 points"),
        ("time,ax\n0,0\n0,5,1\n", "line 3: has 3 cells for 2 columns"),
        ("time,ax\n0,0\n2,1\n1,1\n", "times must increase from row to row; 1 follows 2"),
        ("time,ax\n0,0\n2,1\n2,1\n", "2 follows 2"),
        ("time,ax\n0,0\n2,nan\n", "values must be numbers"),
        ("time,ax\n0,0\n2,\n", "could not convert"),
        ("time,ax\n0,0\n", "two rows or more"),
        (b"time,ax\n0,0\n1,\xff\n", "is not UTF-8 text"),
        (b" " * (17 * 1024 * 1024), "16 MiB"),
    ],
)
def test_files_without_a_history(refusal, content, words: str) -> None:
    (line,) = refusal(content)
    assert "scene.histories.sway" in line
    assert words in line


def test_knots_are_functions_of_constants_in_which_the_driving_is_affine(load) -> None:
    """In a channel and in a tank."""
    knots = {"times": [0, 0.5, 2], "values": [0, "a", "2*b - 1"]}
    given = {"constants": {"a": 2.0, "b": 0.0}, "histories": {"sway": knots}}
    for fluid in ({}, {"fluid": {"level": 0.5}, "body_force": ["0.1*sway(t)", 0]}):
        case = load(**given, **fluid)
        np.testing.assert_allclose(force(case, 0.25, 0.5, 1.25, 2.0), [0.1, 0.2, 0.05, -0.1])
        flow = case.plan.flow(ParameterPoint(100.0, (("a", 1.0), ("b", 2.0))))
        assert flow.body_force(np.array([[1.0], [0.5]]), 1.25)[0, 0] == pytest.approx(0.2)


def test_cubic_histories_reproduce_cubic_polynomials(load) -> None:
    """Through knots, and through the rows of a table."""
    times = np.array([0.0, 0.3, 0.8, 1.5, 2.0])
    asked = np.linspace(0.0, 2.0, 9)
    polynomial = np.polynomial.Polynomial([0.5, -1.0, 2.0, -0.7])
    knots = {"times": times.tolist(), "values": polynomial(times).tolist()}
    rows = "".join(f"{t!r},{v!r}\n" for t, v in zip(*knots.values(), strict=True))
    for history in (knots, {"file": "sway.csv", "scale": 1.0}):
        case = load(f"time,ax\n{rows}", histories={"sway": {**history, "interpolation": "cubic"}})
        np.testing.assert_allclose(force(case, *asked), 0.1 * polynomial(asked), atol=1e-14)


def test_models_are_not_fitted_to_knots(load) -> None:
    """A constant that also shapes the field is a parameter of the equations."""
    given = {
        "constants": {"a": 2.0, "b": 1.0, "c": 1.0},
        "histories": {"sway": {"times": [0, 2], "values": ["a", "b + c"]}},
        "body_force": ["sway(t)*(1 + c*y)", 0],
    }
    point = {"reynolds": 50, "a": 1.0, "b": 2.0, "c": 3.0}
    plan = load(**given, parameters={"train": {"points": [point]}}).plan
    assert plan.fitted_factors(plan.points[0]) == {"c": 3.0}


@pytest.mark.parametrize(
    ("knots", "words"),
    [
        ({"times": [0, 1, 1], "values": [0, 1, 2]}, "sway.times: must rise; got 0, 1, 1"),
        ({"times": [0], "values": [0]}, "sway.times: "),
        ({"times": [0, 2], "values": [0, 1, 2]}, "as many as times; got 3 values and 2 times"),
        (
            {"times": [0, 1.5], "values": [0, 1]},
            "sway: the history has times from 0 to 1.5 s, but 2 s is",
        ),
        ({"times": [0, 2], "values": [0, "f"]}, "sway.values: f is not a known name"),
        ({"times": [0, 2], "values": [0, "t"]}, "sway.values: t is not a known name"),
        ({"times": [0, 2], "values": [0, math.nan]}, "sway.values.1: must be a number"),
        ({"times": [0, 2], "values": [0, "1/0"]}, "sway.values: '1/0' can't be evaluated"),
        ({"times": [0, 2], "values": [0, "log(0)"]}, "body_force: is not finite at t = "),
        ({"times": [0, 2]}, "sway.values: is missing"),
        ({"file": "sway.csv", "times": [0, 2], "values": [0, 1]}, "exactly one of file, times"),
        ({"times": [0, 2], "values": [0, 1], "scale": 2.0}, "scale: is only for file"),
        ({"times": [0, 2], "values": [0, 1], "interpolation": "pchip"}, "one of linear, cubic"),
    ],
)
def test_wrong_knots(load, knots: dict[str, Any], words: str) -> None:
    with pytest.raises(CaseError, match=words):
        load(histories={"sway": knots})


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"body_force": ["sway(t + 1)", 0]}, "body_force: sway: .* to 2 s, but 3 s is needed"),
        ({"body_force": ["sway(t - 0.1)", 0]}, "from 0 to 2 s, but -0.1 s is needed"),
        ({"fluid": {"level": 0.5}, "body_force": ["sway(2*t)", 0]}, "but 4 s is needed"),
        ({"body_force": ["sway", 0]}, r"sway is a history; write sway\(t\)"),
        ({"body_force": ["sway(x)", 0]}, r"takes a time, such as sway\(t\)"),
        ({"body_force": {"file": "sway.csv"}}, r"body_force: .* set scene\.histories"),
        ({"body_force": [{"file": "sway.csv"}, 0]}, r"body_force: .* set scene\.histories"),
        ({"resistance": "sway(t)"}, "t is not a known name"),
        ({"constants": {"sway": 1.0}}, "that no constant has"),
        ({"histories": {"sin": {"file": "sway.csv"}}}, "the name is reserved"),
        ({"histories": {"a-b": {"file": "sway.csv"}}}, "must be a name of letters"),
        ({"histories": {"sway": {"file": "sway.csv", "time": 1}}}, "sway.time: must be text"),
        ({"walls": {"top": {"velocity": ["sway(t) + 1", 0]}, "x": {}}}, "give velocity"),
        ({"walls": {"top": {"velocity": ["sway(t)", "t"]}}}, "top.velocity: all components"),
        (
            {"walls": {"top": {"velocity": ["1/t", 0]}}},
            r"walls\.top\.velocity: is not finite at t = 0 s",
        ),
    ],
)
def test_wrong_keys(load, given: dict[str, Any], words: str) -> None:
    with pytest.raises(CaseError, match=words):
        load(**given)


def test_rows_between_the_steps_and_unused_tables_are_warned_of(load) -> None:
    noisy = "".join(f"{0.001 * n:g},{n % 2}\n" for n in range(2001))
    told = case_warnings(load("time,ax\n" + noisy))
    assert any("sway: has a row every 0.001 s, and changes from row to row" in t for t in told)
    smooth = "".join(f"{0.001 * n:g},{0.001 * n:g}\n" for n in range(2001))
    told = case_warnings(load("time,ax\n" + smooth))
    assert any("sway: has a row every 0.001 s, but runs read values only every" in t for t in told)
    told = case_warnings(load(body_force=[1, 0]))
    assert "scene.histories.sway: is not used; write sway(t) in an expression" in told


def walls(case: Case, *times: float) -> np.ndarray:
    """Return u of the walls (n_times, 2), at the bottom and the top [m/s]."""
    place = np.array([[1.0, -0.1], [1.0, 1.1]])
    flow = case.plan.flow(case.plan.points[0])
    speed = flow.wall_speed(place)
    assert speed is not None
    return np.stack([speed(time) * flow.wall_velocity(place)[:, 0] for time in times])


def test_walls_follow_expressions_in_t(load) -> None:
    moving = {"top": {"velocity": ["3*sway(t)", 0]}, "bottom": {"velocity": ["-4", 0]}}
    case = load(walls=moving)
    np.testing.assert_allclose(walls(case, 0.25, 0.5), [[-4.0, 3.0], [-4.0, 6.0]])
    assert case.plan.max_speed == 6.0  # raises the speed of sound, by each wall's own amplitude
    disc = {"disc": {"circle": {"centre": [1, 0.5], "radius": 0.25}}}
    turning = {"disc": {"rotation": "2*sway(t)"}}
    flow = load(solids=disc, walls=turning, reference_length=0.5).plan
    turned = flow.flow(flow.points[0])
    at = np.array([[1.0, 0.74]])
    assert turned.wall_amplitude is not None
    velocity = turned.wall_amplitude(0.25) * turned.wall_velocity(at)
    np.testing.assert_allclose(velocity, [[-0.5, 0.0]], atol=1e-2)


@pytest.mark.parametrize(
    ("walls", "words"),
    [
        (
            {"top": {"velocity": ["sway(t)", 0]}, "bottom": {"velocity": [1, 0]}},
            "1 of walls.bottom",
        ),
        ({"top": {"velocity": ["cos(t)", 0]}}, r"cos\(t\)\) of walls.top.velocity and \(sway"),
        ({"top": {"velocity": ["sway(t)", 0]}}, ""),
    ],
)
def test_fast_models_need_one_amplitude(load, walls: dict[str, Any], words: str) -> None:
    fast = [{"name": "a", "evaluation": "operators"}]
    assert load(walls=walls).scene.amplitudes
    if not words:
        load(walls=walls, rom=fast)
        return
    with pytest.raises(CaseError, match=words):
        load(walls=walls, rom=fast)


def test_values_without_a_scene(load) -> None:
    case = load(constants={"a": 0.5}, body_force=["interp(t, 0, 0, a, 1)", 0])
    point = case.plan.points[0]
    with pytest.raises(CaseError, match=r"a=-1: body_force: the places in .* must increase"):
        case.plan.flow(ParameterPoint(point.reynolds, (("a", -1.0),)))
