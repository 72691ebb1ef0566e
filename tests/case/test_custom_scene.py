"""A flow of one's own in a case file: shapes, walls, forces, starts, and what is measured."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import yaml

from sphrom.case.custom_sections import ramp_share
from sphrom.case.hints import case_warnings
from sphrom.case.loader import case_of_text, load_case
from sphrom.case.models import Case, resolved_yaml
from sphrom.errors import CaseError

SCENE: dict[str, Any] = {
    "kind": "custom",
    "box": {"lower": [0, 0], "upper": [6, 4], "periodic": ["x"]},
    "solids": {"cylinder": {"circle": {"centre": [3, 2], "radius": 1}}},
    "reference_length": 2.0,
}


@pytest.fixture
def load(tmp_path: Path):
    """Load a case with some keys of its scene changed."""

    def case(compare: Any = None, speed: float = 1.0, **scene: Any) -> Case:
        path = tmp_path / "case.yaml"
        given = {"discretization": {"resolution": 60}, "scene": {**SCENE, **scene}}
        given["fluid"] = {"reference_speed": speed}
        given["compare"] = compare or {}
        path.write_text(yaml.safe_dump({"name": "x", **given}, sort_keys=False))
        return load_case(path)

    return case


@pytest.fixture
def flow(load):
    """Build the flow of a case with some keys of its scene changed."""

    def build(**scene: Any):
        case = load(**scene)
        return case.plan.flow(case.plan.points[0])

    return build


def area(load, shape: dict[str, Any]) -> float:
    """Return the area that a solid takes from the box."""
    return 24.0 - load(solids={"a": shape}).scene.domain.area


SQUARE = {"rectangle": {"lower": [1, 1], "upper": [2, 2]}}
DISC = {"circle": {"centre": [2, 2], "radius": 0.5}}


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (SQUARE, 1.0),
        (DISC, math.pi / 4.0),
        ({"polygon": [[1, 1], [2, 1], [1, 3]]}, 1.0),
        ({"wkt": "POLYGON ((1 1, 3 1, 3 2, 1 2, 1 1))"}, 2.0),
        ({"union": [SQUARE, {"rectangle": {"lower": [2, 1], "upper": [3, 2]}}]}, 2.0),
        ({"difference": [SQUARE, DISC]}, 1.0 - math.pi / 16.0),
        ({"intersection": [SQUARE, DISC]}, math.pi / 16.0),
        ({"buffer": {"shape": SQUARE, "distance": 0.5}}, 3.0 + math.pi / 4.0),
        ({**SQUARE, "scale": 0.5}, 0.25),
        ({**SQUARE, "rotate": 30, "translate": [1.5, 0.5]}, 1.0),
    ],
)
def test_shapes(load, shape: dict[str, Any], expected: float) -> None:
    assert area(load, shape) == pytest.approx(expected, rel=2e-4)


def test_a_shape_is_scaled_about_the_origin_turned_about_its_centroid_and_moved(load) -> None:
    bar = {"rectangle": {"lower": [2000, 2000], "upper": [4000, 2400]}}
    moved = load(solids={"bar": {**bar, "scale": 1e-3, "rotate": 90, "translate": [0.5, 0]}})
    distance = moved.scene.domain.distance_and_normal(np.array([[3.5, 3.25], [2.6, 2.2]]))[0]
    assert distance == pytest.approx([0.05, 0.7], rel=1e-6)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig"])
def test_outlines_of_files_are_part_of_the_case(load, tmp_path: Path, encoding: str) -> None:
    polygon = shapely.box(1.0, 1.0, 2.0, 3.0)
    feature = {"type": "Feature", "properties": {}, "geometry": shapely.geometry.mapping(polygon)}
    document = json.dumps({"type": "FeatureCollection", "features": [feature]})
    (tmp_path / "part.geojson").write_text(document, encoding=encoding)
    (tmp_path / "part.wkt").write_text(polygon.wkt, encoding=encoding)
    for name in ("part.geojson", "part.wkt"):
        case = load(solids={"part": {"file": name}})
        assert 24.0 - case.scene.domain.area == pytest.approx(2.0)
        assert case.scene.solids["part"].wkt == polygon.wkt


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "can't be read"),
        ("[]", "must contain polygons; got []"),
        ('{"type": "Point", "coordinates": [0, 0]}', "must contain polygons; got Point"),
        ('{"type": "Polygon"}', "has no polygon"),
        ('{"type": "Polygon", "coordinates": [[[1,1,0],[2,1,0],[2,2,0],[1,1,0]]]}', "third"),
        ('{"type": "Polygon", "coordinates": [[[1,1],[2,2],[2,1],[1,2],[1,1]]]}', "not valid"),
        ("[" * 100_000, "part.geojson"),
        (" " * (5 * 1024 * 1024), "larger than the limit of 4 MiB"),
        ('{"type": "Polygon", "coordinates": [[["1","a"],[2,1],[2,2],[1,1]]]}', "rings of points"),
        ('{"type": "Polygon", "coordinates": [[[NaN,1],[2,1],[2,2],[1,1]]]}', "has no polygon"),
    ],
)
def test_files_that_hold_no_outline(
    refusal, tmp_path: Path, content: str | None, words: str
) -> None:
    if content is not None:
        (tmp_path / "part.geojson").write_text(content)
    (line,) = refusal(solids={"part": {"file": "part.geojson"}})
    assert "scene.solids.part" in line
    assert words in line


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "WKT of polygons with straight sides: it is empty"),
        ("POLYGON((1 1,NaN 1,2 2,1 1))", "must be a number"),
        ("POLYGON((1 1,1e300 1,2 2,1 1))", "must be a number"),
        ("POLYGON Z((1 1 0,2 1 0,2 2 0,1 1 0))", "third coordinate"),
        ("CURVEPOLYGON(CIRCULARSTRING(0 0, 4 0, 4 4, 0 4, 0 0))", "straight sides"),
        ("GEOMETRYCOLLECTION(" * 10_000, "brackets"),
    ],
)
def test_texts_that_are_no_outline(refusal, text: str, words: str) -> None:
    """None ends the process, as the parser would on texts that are deep enough."""
    (line,) = refusal(solids={"part": {"wkt": text}})
    assert "scene.solids.part" in line
    assert words in line


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        ({"initial": {"v": "log((x-1.5)**2+(y-3)**2)"}}, r"initial\.v: .* at \(1.5, 3\) m"),
        ({"body_force": ["log(y)", 0]}, r"body_force: .* at \(0, 0\) m"),
        (
            {"constants": {"pi": 3.0}, "body_force": ["pi", 0]},
            r"constants\.pi: the name is reserved",
        ),
        (
            {"solids": {"a": {"circle": {"centre": [3, 2], "radius": 1e-9}}}},
            "solid a: it is too small",
        ),
    ],
)
def test_what_is_not_finite_or_too_small(load, recwarn, scene: dict[str, Any], words: str) -> None:
    with pytest.raises(CaseError, match=words):
        load(**scene)
    assert not recwarn.list


def test_a_thin_solid_and_a_narrow_gap_are_refused(load) -> None:
    fin = {"rectangle": {"lower": [3, 1], "upper": [3.1, 2]}}
    with pytest.raises(CaseError, match=r"a support of radius .* is larger"):
        load(solids={"fin": fin})
    with pytest.raises(CaseError, match=r"a support of radius .* is larger"):
        load(solids={"disc": {"circle": {"centre": [3, 2], "radius": 1.95}}})


def test_walls_move_as_they_are_told(flow) -> None:
    turning = flow(
        speed=9.0, walls={"cylinder": {"rotation": 2.0}, "top": {"velocity": ["x*(6 - x)", 0]}}
    )
    ghosts = np.array([[3.0, 2.9], [2.2, 2.0], [2.0, 4.05], [5.0, -0.05]])
    velocity = turning.wall_velocity(ghosts)
    np.testing.assert_allclose(
        velocity, [[-2.0, 0.0], [0.0, -2.0], [8.0, 0.0], [0.0, 0.0]], atol=6e-3
    )


def test_a_rotation_of_zero_is_none_and_a_resistance_of_one_slows(flow) -> None:
    still = flow(walls={"cylinder": {"rotation": 0}}, resistance=1)
    assert not still.wall_velocity(np.array([[3.0, 2.9], [2.2, 2.0]])).any()
    places = np.array([[0.5, 5.0], [0.5, 3.0]])
    np.testing.assert_array_equal(still.resistance.own(places), [1.0, 1.0])


def test_fluid_starts_with_the_pressure_of_its_weight(flow) -> None:
    tank = flow(solids={}, box={"upper": [6, 4]}, fluid={"level": 3.0, "gravity": 2.0}, slip="free")
    pressure = tank.initial_pressure(np.array([[1.0, 0.5], [2.0, 3.0]]))
    np.testing.assert_allclose(pressure, [1.0 * 2.0 * 2.5, 0.0], atol=1e-9)
    disc = {"circle": {"centre": [3, 2], "radius": 1}}
    with pytest.raises(CaseError, match=r"scene\.fluid: .*level.* circle"):
        flow(solids={}, box={"upper": [6, 4]}, fluid={"level": 3.0, **disc}, slip="free")


def test_an_inflow_begins_with_half_a_cosine() -> None:
    assert ramp_share(2.0, np.array([0.0, 1.0, 2.0, 5.0])) == pytest.approx([0.0, 0.5, 1.0, 1.0])
    assert ramp_share(0.0, 0.0) == 1.0


def test_forces_and_starts_are_expressions(flow) -> None:
    case = flow(
        speed=9.0,
        constants={"strength": 0.5},
        body_force=["strength*sin(pi*y)*cos(t)", 0],
        initial={"u": "y*(4 - y)", "p": 2},
    )
    place = np.array([[1.0, 0.5], [2.0, 1.5]])
    force = case.body_force(place.T, math.pi)
    np.testing.assert_allclose(force, [[-0.5, 0.5], [0.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(case.initial_velocity(place), [[1.75, 0.0], [3.75, 0.0]])
    np.testing.assert_array_equal(case.initial_pressure(place), [2.0, 2.0])


def test_a_scene_without_force_or_start_is_at_rest(load) -> None:
    case = load()
    flow = case.plan.flow(case.plan.points[0])
    assert flow.body_force is None
    assert case.scene.largest_head(1.0) == 0.0
    assert not flow.initial_velocity(np.ones((3, 2))).any()
    assert case.plan.kinematic_viscosity(case.plan.points[0]) == pytest.approx(2.0 / 100.0)
    assert case.plan.particle_spacing == pytest.approx(2.0 / 60.0)


def test_particles_start_packed_unless_walls_fit_a_lattice(load) -> None:
    assert load().plan.packed
    assert not load(solids={}).plan.packed
    assert load(solids={}, box={"upper": [1, 1], "periodic": ["x", "y"]}).plan.packed


def bar(x: float, y: float, width: float, height: float) -> dict[str, Any]:
    return {"rectangle": {"lower": [x, y], "upper": [x + width, y + height]}}


@pytest.mark.parametrize(
    ("solids", "periodic", "parts"),
    [
        ({"a": bar(2, 0, 1, 4)}, [], "2 parts, of 12, 8 m2"),
        ({"a": bar(2, 0, 1, 4)}, ["x"], None),  # they are one, past the edge
        ({"a": bar(2, 0, 1, 4), "b": bar(4, -1, 1, 6)}, ["x"], "2 parts, of 12, 4 m2"),
        ({"a": bar(0, 2, 6, 1)}, ["x"], "2 parts, of 12, 6 m2"),
        ({"a": bar(0, 2, 6, 1)}, ["x", "y"], None),
        ({"a": {"polygon": [[0, 2], [3, 0], [6, 2], [3, 4]]}}, [], "4 parts, of 3, 3, 3, 3 m2"),
        ({"a": bar(2, 1, 1, 2)}, [], None),
    ],
)
def test_solids_that_cut_the_fluid_apart(load, solids: dict, periodic: list, parts) -> None:
    case = load(solids=solids, box={**SCENE["box"], "periodic": periodic})
    warned = [text for text in case_warnings(case) if text.startswith("scene.solids")]
    assert warned == ([f"scene.solids: divide the fluid into {parts}"] if parts else [])


def test_a_box_that_a_huge_solid_reaches_into_is_warned_of(load) -> None:
    told = case_warnings(load(solids={"a": bar(-1000, -1000, 3000, 1001)}))
    start = "scene.solids.a: is 5e+02 times as wide as the box"
    assert len([warning for warning in told if warning.startswith(start)]) == 1


def test_only_what_fluid_touches_of_a_wall_has_to_slide_along_itself(load) -> None:
    """Neither corners, nor what a solid covers of a side, nor what lies beyond the box."""
    closed = {"upper": [6, 4]}
    step = bar(3, -1, 5, 3)
    moving = {name: {"velocity": [1, 0]} for name in ("top", "bottom")}
    case = load(solids={"step": step}, box=closed, walls=moving)
    assert set(case.scene.walls) == {"top", "bottom"}
    load(solids={}, box=closed, walls=moving)
    with pytest.raises(CaseError, match=r"walls\.left: no fluid touches it"):
        load(solids={"a": bar(-1, -1, 3, 6)}, box=closed, walls={"left": {"velocity": [0, 1]}})
    with pytest.raises(CaseError, match=r"walls\.step: its velocity at .* has a normal component"):
        load(solids={"step": step}, box=closed, walls={"step": {"velocity": [1, 0]}})


@pytest.mark.parametrize(
    ("kind", "number"), [("taylor-green", 2), ("lid-driven-cavity", 3), ("open-cavity", 4)]
)
def test_named_scenes_are_the_flows_that_the_page_says(kind: str, number: int) -> None:
    named = Case.model_validate({"name": "x", "scene": {"kind": kind}})
    page = (Path(__file__).parents[2] / "docs" / "own-flow.md").read_text(encoding="utf-8")
    block = yaml.safe_load(page.split("```yaml\n")[number].partition("```")[0])
    scene = Case.model_validate({"name": "x", **block}).scene
    own = named.model_copy(update={"scene": scene})
    point = named.plan.points[0]
    assert own.plan.kinematic_viscosity(point) == pytest.approx(
        named.plan.kinematic_viscosity(point)
    )
    ours, theirs = own.plan.flow(point), named.plan.flow(point)
    domain = theirs.domain
    assert (ours.domain.lower, ours.domain.upper) == (domain.lower, domain.upper)
    assert ours.domain.area == pytest.approx(domain.area)
    place = domain.lower + np.random.default_rng(1).random((500, 2)) * domain.lengths
    np.testing.assert_array_equal(ours.domain.contains(place), domain.contains(place))
    inside = place[domain.contains(place)]
    for field in ("initial_velocity", "initial_pressure"):
        expected = getattr(theirs, field)(inside)
        np.testing.assert_allclose(getattr(ours, field)(inside), expected, atol=1e-12)
    for time in (0.0, 0.029, 0.05, 6.0) if theirs.body_force else ():
        expected = theirs.body_force(inside.T, time)
        np.testing.assert_allclose(ours.body_force(inside.T, time), expected, rtol=1e-9)
    x = np.linspace(0.01, 0.99, 50) * domain.lengths[0]
    lid = np.stack((x, np.full_like(x, domain.upper[1] + 1e-3)), axis=1)
    np.testing.assert_allclose(ours.wall_velocity(lid), theirs.wall_velocity(lid), atol=1e-12)


MEASURE: dict[str, Any] = {
    "drag": {"force_on": "cylinder"},
    "roof": {"force_on": "top"},
    "flux": {"flow_rate": {"from": [3, 0], "to": [3, 1]}},
    "wake": {"probe": [5, 2]},
    "profile": {"line": {"from": [5, 0], "to": [5, 4]}},
}


def test_measurements_by_kind(load) -> None:
    scene = load(measure=MEASURE).scene
    assert scene.measured_walls == {"drag": "cylinder", "roof": "top"}
    assert list(scene.measured_fields) == ["flux", "wake", "profile"]
    line = scene.measure["profile"].line
    assert line is not None
    assert (line.start, line.end, line.points) == ((5.0, 0.0), (5.0, 4.0), 101)
    assert scene.measure["flux"].quantities == ("flow_rate",)
    assert load().scene.measured_walls == {}


def test_a_case_that_measures_is_written_in_full_and_read_back(load) -> None:
    case = load(measure=MEASURE)
    text = resolved_yaml(case)
    flux = yaml.safe_load(text)["scene"]["measure"]["flux"]
    assert flux["flow_rate"] == {"from": [3.0, 0.0], "to": [3.0, 1.0]}
    assert case_of_text(text) == case


@pytest.mark.parametrize(
    ("strip", "solid", "words"),
    [
        ([0, 1.4], bar(4, 1, 1, 1), "2 m, or discretization.resolution: 86"),
        ([0, 2.0], bar(4, 1, 1, 1), ""),
        ([0, 2.0], bar(0, 0, 6, 1), ""),  # a wall all along the strip
        ([0, 2.0], bar(1, 1, 1, 1), "scene.solids.a: is in the strip of the inflow"),
    ],
)
def test_strips_that_are_narrow_or_hold_a_solid(load, strip: list, solid, words: str) -> None:
    box = {"upper": [6, 4], "periodic": ["x"]}
    inflow = {"strip": dict(zip(("from", "to"), strip, strict=True)), "velocity": [1, 0]}
    case = load(solids={"a": solid}, box=box, inflow={**inflow, "ramp": 0.0}, reference_length=6.0)
    assert case.scene.largest_wall_speed({"inflow": 2.0}) == 2.0  # it raises that of sound
    told = [each for each in case_warnings(case) if "strip" in each]
    assert words in told[0] if words else not told
