"""Starts of runs from a file of points: how they are interpolated, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import yaml

from sphrom.case.loader import case_of_text, given_keys, load_case
from sphrom.case.models import Case, inputs_digest, resolved_yaml, section_inputs
from sphrom.errors import CaseError

SQUARE = "x,y,u,v,p\n0,0,0,1,5\n1,0,2,1,5\n0,1,4,1,5\n1,1,6,1,5\n"


@pytest.fixture
def load(tmp_path: Path):
    """Load a case that starts from a file of some content."""

    def case(content: str | bytes | None, /, **given: Any) -> Case:
        if content is not None:
            data = content if isinstance(content, bytes) else content.encode()
            (tmp_path / "start.csv").write_bytes(data)
        scene = {
            "kind": "custom",
            "box": {"upper": [2, 1], "periodic": ["x", "y"]},
            "initial": {"file": "start.csv"},
            **given,
        }
        fluid = {"reference_speed": 10.0}
        keys = {"name": "x", "scene": scene, "fluid": fluid, "snapshots": {"every": 1}}
        (tmp_path / "case.yaml").write_text(yaml.safe_dump(keys))
        return load_case(tmp_path / "case.yaml")

    return case


def start(case: Case, *places: tuple[float, float]):
    flow = case.plan.flow(case.plan.points[0])
    at = np.array(places)
    return flow.initial_velocity(at), flow.initial_pressure(at)


def test_values_are_linear_between_points_and_the_nearest_one_s_beyond(load) -> None:
    velocity, pressure = start(load(SQUARE), (0.25, 0.5), (1.9, 0.1))
    np.testing.assert_allclose(velocity, [[2.5, 1.0], [2.0, 1.0]])
    np.testing.assert_allclose(pressure, 5.0)


def test_columns_may_stand_in_any_order_beside_others_and_pressure_may_lack(load) -> None:
    text = "\ufeffname, v,u ,y,x\na,1,0,0,0\n\nb,1,2,0,1\nc,1,4,1,0\n"
    velocity, pressure = start(load(text), (0.25, 0.25))
    np.testing.assert_allclose(velocity, [[1.5, 1.0]])
    np.testing.assert_array_equal(pressure, [0.0])


@pytest.mark.parametrize("separator", [";", "\t"])
def test_semicolons_and_tabs_allow_decimal_commas(load, separator) -> None:
    """A row with too many cells, by decimal commas between commas, must not be read as another."""
    rows = SQUARE.replace("2,1,5", "2.5,1,5").replace(",", separator).replace(".", ",")
    expected = start(load(SQUARE.replace("2,1,5", "2.5,1,5")), (0.25, 0.5))
    found = start(load("# ours\n" + rows), (0.25, 0.5))
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(found[1], expected[1])
    for mixed in ("x,y,u,v\n0,5,0,0,0\n", rows + separator.join(["3,0", "3.0", "1", "1", "1"])):
        with pytest.raises(CaseError, match=r"semicolons between|commas, and line \d"):
            load(mixed)


def test_what_the_file_holds_is_part_of_what_is_made_from_it(load) -> None:
    case, other = load(SQUARE), load(SQUARE.replace("6,1,5", "6,1,4"))
    digests = [inputs_digest(section_inputs(each, ["scene"])) for each in (case, other)]
    assert digests[0] != digests[1]
    assert case_of_text(resolved_yaml(case)) == case  # without its folder
    with pytest.raises(CaseError, match=r"start\.csv has changed"):
        load(SQUARE, initial={"file": "start.csv", "sha256": "0" * 64})


def test_a_case_written_elsewhere_names_the_same_files(
    load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Behind a link too, and with an outline that is larger than a case may be."""
    monkeypatch.setattr("sphrom.case.loader.MAX_BYTES", 8 * 1024)
    outline = shapely.Point(5.0, 5.0).buffer(2.0, 100).wkt
    assert len(outline) > 8 * 1024
    (tmp_path / "disc.wkt").write_text(outline)
    solids = {"hole": {"union": [{"file": "disc.wkt"}]}}
    case = load(SQUARE, box={"upper": [10, 10], "periodic": ["x", "y"]}, solids=solids)
    (tmp_path / "far" / "away").mkdir(parents=True)
    (folder := tmp_path / "link").symlink_to(tmp_path / "far" / "away")
    given = yaml.safe_dump(given_keys(tmp_path / "case.yaml", (), folder))
    for text in (resolved_yaml(case, folder), given):
        (folder / "other.yaml").write_text(text)
        other = load_case(folder / "other.yaml")
        assert section_inputs(other, ["scene"]) == section_inputs(case, ["scene"])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "No such file"),
        ("x,y,u\n0,0,0\n", "must name the columns"),
        (SQUARE.replace("2,1", "one,1"), "could not convert string to float: 'one'"),
        (SQUARE.replace("2,1", "nan,1"), "must be numbers"),
        ("x,y,u,v\n0,0,0,0\n1,0,0,0\n", "got 2"),
        ("x,y,u,v\n0,0,0,0\n1,1,0,0\n2,2,0,0\n", "on one line"),
        (SQUARE + "1,0,0,0,0\n", "twice"),
        (b"x,y,u,v\n\xff", "UTF-8"),
        (b" " * (17 * 1024 * 1024), "16 MiB"),
    ],
)
def test_files_that_hold_no_start(refusal, content, words: str) -> None:
    (line,) = refusal(content)
    assert "scene.initial" in line
    assert words in line


def test_expressions_beside_a_file_are_refused(load) -> None:
    with pytest.raises(CaseError, match="file can't be combined with u, v, w and p"):
        load(SQUARE, initial={"file": "start.csv", "u": 1.0})
