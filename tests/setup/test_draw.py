"""The picture of a case before it runs: what it shows, in every kind of scene."""

from __future__ import annotations

import numpy as np
import pytest
from typer.testing import CliRunner

from sphrom.case.models import Case
from sphrom.case.template import scene_kinds
from sphrom.cli.app import app
from sphrom.plots.preview import draw_preview
from sphrom.setup.draw import preview

SCENE = {
    "kind": "custom",
    "box": {"lower": [0, 0], "upper": [6, 4], "periodic": ["x"]},
    "solids": {"disc": {"circle": {"centre": [3, 2], "radius": 1}}},
    "walls": {"top": {"velocity": [2, 0]}, "disc": {"rotation": -0.5}},
}


def make(scene: dict) -> Case:
    return Case.model_validate({"name": "x", "scene": scene, "discretization": {"resolution": 40}})


def test_walls_have_their_names_within_the_solid_and_their_velocities() -> None:
    seen = preview(make(SCENE))
    walls = {wall.name: wall for wall in seen.walls}
    assert list(walls) == ["bottom", "top", "disc"]
    assert [wall.speed for wall in walls.values()] == pytest.approx([0.0, 2.0, 0.5], abs=0.01)
    assert walls["disc"].label_at == pytest.approx([3.0, 2.0], abs=0.1)
    assert walls["bottom"].label_at[1] < 0.0 < 4.0 < walls["top"].label_at[1]
    radius = np.linalg.norm(walls["disc"].place - (3.0, 2.0), axis=1)
    assert radius == pytest.approx(np.ones(len(radius)), abs=1e-3)
    assert seen.frame[:2] == (0.0, 6.0)  # nothing lies beyond an edge that repeats
    assert seen.line == (3.0, [(0.0, pytest.approx(1.0, 1e-3)), (pytest.approx(3.0, 1e-3), 4.0)])
    solid = seen.solids.wall_distance < 0.0
    assert solid.any()
    assert not solid.all()


@pytest.mark.parametrize("kind", scene_kinds())
def test_every_scene_can_be_drawn(kind: str) -> None:
    seen = preview(make({"kind": kind}))
    figure = draw_preview(seen)
    shown = [text.get_text().split(",")[0] for text in figure.axes[0].texts]
    assert shown == [wall.name for wall in seen.walls]
    assert len(seen.position) > 100


@pytest.mark.parametrize(("name", "head"), [("a.png", b"\x89PNG"), ("a.svg", b"<?xml")])
def test_the_file_s_name_says_its_format(sphrom_case, name: str, head: bytes) -> None:
    result = sphrom_case("-o", name)
    assert result.exit_code == 0, result.output
    path = sphrom_case.folder / name
    first = path.read_bytes()
    assert first.startswith(head)
    assert sphrom_case("-o", name).exit_code == 2  # it is there
    assert sphrom_case("-o", name, "--force").exit_code == 0
    assert path.read_bytes() == first


def test_without_a_name_it_is_the_case_s(sphrom_case) -> None:
    assert sphrom_case().exit_code == 0
    assert (sphrom_case.folder / "small.png").is_file()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["-o", "a.pdf"], 2, "--output: must end in .png or .svg; got a.pdf"),
        (["-o", "a"], 2, "--output: must end in .png or .svg"),
        (["-o", "no/a.png"], 3, "no/a.png can't be written (No such file or directory)"),
        (["--set", "discretization.resolution=1000"], 2, "try --set discretization.resolution=250"),
    ],
)
def test_refusals(sphrom_case, arguments: list[str], code: int, words: str) -> None:
    result = sphrom_case(*arguments)
    assert result.exit_code == code
    assert words in result.output.replace("\n", " ")
    assert not list(sphrom_case.folder.glob("a*"))


@pytest.fixture
def sphrom_case(tmp_path, monkeypatch):
    """Draw a small case in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.yaml").write_text(
        "name: small\nscene: {kind: taylor-green}\ndiscretization: {resolution: 20}\n"
    )

    class Draw:
        folder = tmp_path

        def __call__(self, *arguments: str):
            return CliRunner().invoke(app, ["case", "draw", "small.yaml", *arguments])

    return Draw()


def test_what_is_measured_is_drawn_with_its_name() -> None:
    measure = {
        "flux": {"flow_rate": {"from": [1, 0], "to": [1, 4]}},
        "wake": {"probe": [5, 2]},
        "profile": {"line": {"from": [5, 0], "to": [5, 4]}},
    }
    seen = preview(make({**SCENE, "measure": measure}))
    assert {name: len(ends) for name, ends in seen.measured.items()} == {
        "flux": 2, "wake": 1, "profile": 2,
    }  # fmt: skip
    assert list(seen.sections) == ["flux"]
    axes = draw_preview(seen).axes[0]
    assert {"flux", "wake", "profile"} <= {text.get_text() for text in axes.texts}
    shown = [line.get_label() for line in axes.lines]
    assert {"sections", "probes", "lines"} <= set(shown)
