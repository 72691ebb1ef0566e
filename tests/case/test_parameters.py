"""Points of several parameters: grids, lists and samples, and what can't vary."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sphrom.case.hints import case_warnings
from sphrom.case.loader import load_case, parameter_point
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import sweep_points
from sphrom.console import SilentReporter
from sphrom.errors import CaseError
from sphrom.setup.context import StageContext
from sphrom.stages import selected

LID = {"kind": "lid-driven-cavity"}
GRID = {"train": {"reynolds": [50, 200], "lid": [0.5, 1.0]}}
CUSTOM = {
    "kind": "custom",
    "box": {"upper": [2, 2], "periodic": ["x"]},
    "solids": {"disc": {"circle": {"centre": [1, 1], "radius": 0.3}}},
    "constants": {"U": 1.0, "g": 2.0, "omega": 3.0, "k": 1.5},
    "walls": {"top": {"velocity": ["U*(1 + 0.1*cos(pi*x))", 0]}, "disc": {"rotation": 0.5}},
    "body_force": ["(1 + g*sin(k*y))*cos(omega*t)", 0],
    "initial": {"u": "sin(k*y)/omega"},
}


def case(parameters: Any, scene: Any = LID, **sections: Any) -> Case:
    discretization = {"resolution": 16 if scene is LID else 40}
    given = {"name": "x", "scene": scene, "parameters": parameters}
    return load_case({**given, "discretization": discretization, **sections})


def labels(points: Any) -> list[str]:
    return [point.label for point in points]


@pytest.mark.parametrize(
    ("train", "unnamed"),
    [
        # All training runs have the same values, whatever the scene's own are.
        ({"points": [{"reynolds": 250, "lid": 0.6}]}, "reynolds=250, lid=0.6"),
        ({"reynolds": [250], "lid": [0.6]}, "reynolds=250, lid=0.6"),
        # They differ, so the scene's own value counts.
        ({"points": [{"reynolds": 250, "lid": 0.5}, {"lid": 0.6}]}, "reynolds=250, lid=1"),
        ({"sample": {"count": 2, "lid": [0.5, 0.9]}, "reynolds": [7]}, "reynolds=7, lid=1"),
        # Reynolds numbers differ, and the scene has none.
        ({"points": [{"reynolds": 250, "lid": 0.5}, {"reynolds": 9}]}, None),
        ({"reynolds": [250, 9], "lid": [0.5]}, None),
        ({"sample": {"count": 2, "reynolds": [20, 90]}}, None),
    ],
)
def test_what_a_point_does_not_name_is_the_same_everywhere(train, unnamed):
    """The values are those of all training runs, or the scene's own, for every kind of points."""
    listed = [{"lid": 0.75}]
    sections = {
        "parameters": {"train": train, "test": {"points": listed}},
        "rom": [{"name": "fast", "n_modes": 2, "parameters": listed}],
        "sweep": {"parameters": {"lid": [0.75]}},
    }
    if unnamed is None:
        with pytest.raises(CaseError) as refused:
            case(**sections)
        for key in ("parameters.test", "rom.0.parameters", "sweep"):
            assert f"{key}.reynolds: is missing, and training runs have several" in str(
                refused.value
            )
        return
    found = case(**sections)
    points = (*found.plan.test_points, *found.plan.rom_points(found.rom[0]), *sweep_points(found))
    assert {*labels(points)} == {unnamed.partition("lid")[0] + "lid=0.75"}
    assert parameter_point(found, {}).label == unnamed


def test_a_grid_is_every_combination():
    found = case({**GRID, "test": {"reynolds": [100], "lid": [0.8]}})
    assert labels(found.plan.train_points) == [
        "reynolds=50, lid=0.5", "reynolds=50, lid=1", "reynolds=200, lid=0.5",
        "reynolds=200, lid=1",
    ]  # fmt: skip
    assert [point.file_label for point in found.plan.test_points] == ["reynolds100-lid0.8"]


def test_a_point_has_the_scene_s_own_value_of_what_it_does_not_name():
    listed = [{"reynolds": 50, "lid": 0.5}, {"reynolds": 200}]
    found = case({"train": {"points": listed}, "test": {"reynolds": [100]}})
    assert labels(found.plan.points) == [
        "reynolds=50, lid=0.5", "reynolds=200, lid=1", "reynolds=100, lid=1",
    ]  # fmt: skip
    assert labels(case({"train": {"lid": [0.5, 1]}}).plan.points) == [
        "reynolds=100, lid=0.5", "reynolds=100, lid=1",
    ]  # fmt: skip


@pytest.mark.parametrize("method", ["sobol", "halton", "latin-hypercube"])
def test_a_sample_fills_its_box_and_comes_again(method):
    sample = {"count": 6, "method": method, "reynolds": [50, 200], "lid": [0.5, 1]}
    found = case({"train": {"sample": sample}}).plan.points
    assert found == case({"train": {"sample": sample}}).plan.points
    assert len(set(found)) == 6
    assert all(50 <= p.reynolds <= 200 and 0.5 <= p.factors["lid"] <= 1 for p in found)
    assert found != case({"train": {"sample": {**sample, "seed": 1}}}).plan.points
    if method != "latin-hypercube":
        assert case({"train": {"sample": {**sample, "count": 4}}}).plan.points == found[:4]


def test_the_speed_of_sound_is_that_of_the_fastest_wall_at_any_point():
    assert case(GRID).plan.sound_speed == pytest.approx(10.0)
    assert case({"train": {"lid": [0.5, 1.5]}}).plan.sound_speed == pytest.approx(15.0)
    rotating = case({"train": {"disc": [0.5, 20.0]}}, CUSTOM)
    assert rotating.plan.sound_speed == pytest.approx(60.0, rel=1e-3)
    slow = case({"train": {"lid": [0.5]}})
    assert slow.plan.kinematic_viscosity(slow.plan.points[0]) == 0.01


@pytest.mark.parametrize("name", ["U", "g", "omega", "top", "disc", "body_force"])
def test_what_operators_are_affine_in_may_vary(name):
    found = case({"train": {name: [0.5, 0.7]}}, CUSTOM, fluid={"reference_speed": 5.0})
    assert found.plan.parameter_names == ("reynolds", name)
    assert [point.factors[name] for point in found.plan.points] == [0.5, 0.7]


def test_a_closure_from_operators_is_for_the_viscosity_alone():
    closed = [{"name": "a", "projection": "apg", "evaluation": "operators"}]
    assert case({"train": {"reynolds": [50, 200]}}, rom=closed).plan.memory_models
    with pytest.raises(CaseError, match=r"rom\.0\.projection: apg has operators for the viscosity"):
        case(GRID, rom=closed)


def test_some_values_choose_all_points_that_have_them():
    context = StageContext(case(GRID), Path(), False, None, SilentReporter())
    for text, chosen in {
        "lid=0.5": ["reynolds=50, lid=0.5", "reynolds=200, lid=0.5"],
        "lid=1.0, reynolds=200": ["reynolds=200, lid=1"],
    }.items():
        assert labels(selected(context, "fom", [text]).only or ()) == chosen
    with pytest.raises(CaseError, match=r"got 'lid=0\.7,reynolds=50'; this command runs"):
        selected(context, "fom", ["lid=0.7,reynolds=50"])


def test_values_by_name_in_python():
    assert parameter_point(case(GRID), {"reynolds": 137, "lid": 0.8}).label == (
        "reynolds=137, lid=0.8"
    )
    assert parameter_point(case(GRID), {"reynolds": 137}).factors == {"lid": 1.0}
    with pytest.raises(CaseError, match="reynolds: is missing"):
        parameter_point(case(GRID), {"lid": 0.8})
    with pytest.raises(CaseError, match="varies in neither"):
        parameter_point(case({"train": {"reynolds": [100]}}), {"reynolds": 100, "lid": 0.8})


def test_boxes_are_local_bases():
    box = {"a": {"box": {"lid": [0.5, 0.75]}}, "b": {"box": {"lid": [0.75, 1.0]}}}
    train = {"reynolds": [50, 200], "lid": [0.5, 0.75, 1.0]}
    found = case({"train": train}, basis={"subsets": box})
    assert [len(found.plan.bases[name]) for name in ("all", "a", "b")] == [6, 4, 4]
    points = [ParameterPoint(60.0, (("lid", lid),)) for lid in (0.5, 0.75, 0.9, 1.0, 1.1)]
    local = [found.plan.local_bases(point) for point in points]
    assert local == [["a"], ["b"], ["b"], ["b"], []]


def test_sweeps_are_grids_lists_and_samples():
    given = {"reynolds": [50, 100], "parameters": {"lid": {"low": 0.5, "high": 1.0, "count": 3}}}
    assert labels(sweep_points(case(GRID, sweep=given))[:2]) == [
        "reynolds=50, lid=0.5", "reynolds=50, lid=0.75",
    ]  # fmt: skip
    listed = case(GRID, sweep={"points": [{"reynolds": 60, "lid": 0.6}]})
    assert labels(sweep_points(listed)) == ["reynolds=60, lid=0.6"]
    sample = {"count": 8, "reynolds": [50, 200], "lid": [0.5, 1.0]}
    assert len(sweep_points(case(GRID, sweep={"sample": sample}))) == 8
    with pytest.raises(CaseError, match="give values in one way only"):
        case(GRID, sweep={**given, "sample": sample})


def test_a_point_beyond_training_is_named_with_the_range():
    (warning,) = case_warnings(case({**GRID, "test": {"reynolds": [100], "lid": [1.2]}}))
    assert warning.startswith(
        "parameters.test: reynolds=100, lid=1.2 is outside of the trained range, 0.5 to 1 of lid"
    )


def test_points_that_training_does_not_surround_are_beyond_it():
    """The points of training lie on a parabola, so only points above the chords are inside."""
    train = [{"reynolds": 100, "lid": 0.5}, {"reynolds": 200, "lid": 0.6}]
    train.append({"reynolds": 400, "lid": 0.9})
    inside, outside = {"reynolds": 200, "lid": 0.65}, {"reynolds": 150, "lid": 0.5}
    found = case({"train": {"points": train}, "test": {"points": [inside, outside]}})
    (warning,) = case_warnings(found)
    assert warning.startswith(
        "parameters.test: reynolds=150, lid=0.5 is outside of the training points, though each"
    )
    swept = found.plan.point({"reynolds": 50, "lid": 0.7})
    assert "100 to 400 of reynolds" in found.plan.beyond_training(swept)
    corners = case(GRID).plan
    assert corners.beyond_training(corners.point({"reynolds": 60, "lid": 0.6})) is None


def test_a_start_depends_on_the_constants_that_it_names():
    found = case({"train": {"omega": [2.0, 3.0]}}, CUSTOM)
    names = (*CUSTOM["constants"], "top", "disc", "body_force")
    assert [name for name in names if found.scene.starts_by(name)] == ["omega", "k"]
    assert not any(map(case({}).scene.starts_by, ("lid", "reynolds")))
    force, times = found.plan.flow(found.plan.train_points[0]).body_force, np.linspace(0, 3, 200)
    assert force.series(times).tolist() == [force.amplitude(time) for time in times]
