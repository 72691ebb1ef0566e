"""The picture of a case before it runs: what it shows, in every kind of scene."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.quiver import Quiver
from typer.testing import CliRunner

from sphrom.case.models import Case
from sphrom.case.scenes import DEFAULTS
from sphrom.cli.app import app
from sphrom.setup.draw import draw

SCENE = {
    "kind": "custom",
    "box": {"lower": [0, 0], "upper": [6, 4], "periodic": ["x"]},
    "solids": {"disc": {"circle": {"centre": [3, 2], "radius": 1}}},
    "walls": {"top": {"velocity": [2, 0]}, "disc": {"rotation": -0.5}},
}


def make(scene: dict) -> Case:
    return Case.model_validate({"name": "x", "scene": scene, "discretization": {"resolution": 40}})


def test_walls_have_their_names_within_the_solid_and_their_velocities() -> None:
    axes = draw(make(SCENE)).axes[0]
    places = {text.get_text(): text.get_position() for text in axes.texts}
    assert list(places) == ["bottom", "top, 2 m/s", "disc, 0.5 m/s"]
    assert places["disc, 0.5 m/s"] == pytest.approx((3.0, 2.0), abs=0.1)
    assert places["bottom"][1] < 0.0 < 4.0 < places["top, 2 m/s"][1]
    _, disc = (found for found in axes.collections if isinstance(found, Quiver))
    radius = np.hypot(*(disc.get_offsets() - (3.0, 2.0)).T)
    assert radius == pytest.approx(np.ones(len(radius)), abs=1e-3)
    assert axes.get_xlim() == (0.0, 6.0)  # nothing lies beyond an edge that repeats
    compared = [line.get_xydata() for line in axes.lines if line.get_label() == "compared line"]
    np.testing.assert_allclose(
        compared, [[(3.0, 0.0), (3.0, 1.0)], [(3.0, 3.0), (3.0, 4.0)]], atol=1e-3
    )


@pytest.mark.parametrize("kind", DEFAULTS)
def test_every_scene_can_be_drawn(kind: str) -> None:
    case = make({"kind": kind})
    axes = draw(case).axes[0]
    shown = [text.get_text().split(",")[0] for text in axes.texts]
    assert shown == list(case.scene.domain.wall_names)
    number = case.scene.domain.n_particles(case.plan.particle_spacing)
    assert axes.collections[0].get_label() == f"fluid particles, {number}"


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
        (["-o", "no/a.png"], 3, "no/a.png was not written: No such file"),
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
    axes = draw(make({**SCENE, "measure": measure})).axes[0]
    assert {"flux", "wake", "profile"} <= {text.get_text() for text in axes.texts}
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    np.testing.assert_array_equal(lines["sections"], [(1, 0), (1, 4)])
    np.testing.assert_array_equal(lines["probes"], [(5, 2), (5, 2)])
    np.testing.assert_array_equal(lines["lines"], [(5, 0), (5, 4)])
    arrow = axes.collections[-1]
    assert isinstance(arrow, Quiver)
    assert arrow.U[0] > 0.0 == arrow.V[0]  # to the right, seen from start to end
