"""The picture of a case before it runs: what it shows, in every kind of scene."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from matplotlib.quiver import Quiver

from sphrom.case.models import Case
from sphrom.case.scenes import DEFAULTS
from sphrom.metrics.grids import GAP
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


def test_the_strip_of_an_inflow_porous_bodies_and_a_level_are_shown() -> None:
    """A strip with its arrow and speed, a body with its hole, and the line of the surface."""
    ring = (
        {"circle": {"centre": [3, 2], "radius": 1}},
        {"circle": {"centre": [3, 2], "radius": 0.5}},
    )
    axes = draw(make({
        "kind": "custom",
        "box": {"upper": [6, 4], "periodic": ["x"]},
        "porous": {"ring": {"permeability": 1e-3, "difference": ring}},
        "inflow": {"velocity": ["-y*(4-y)", 0], "strip": {"from": 4, "to": 5}},
    })).axes[0]  # fmt: skip
    assert {"ring", "inflow, at most 4 m/s"} <= {text.get_text() for text in axes.texts}
    body, strip = axes.patches
    assert (body.get_label(), strip.get_label()) == ("porous bodies", "strip of the inflow")
    assert list(body.get_path().codes).count(1) == 2  # outlines, one of them of the hole
    assert strip.get_path().get_extents().extents == pytest.approx((4.0, 0.0, 5.0, 4.0))
    (arrow,) = (found for found in axes.collections if isinstance(found, Quiver))
    assert arrow.U[0] < 0.0 == arrow.V[0]
    tank = {"kind": "custom", "box": {"upper": [2, 2]}, "fluid": {"level": 0.5}}
    tank["measure"] = {"gauge": {"elevation": 0.25}, "push": {"force_on": "right"}}
    axes = draw(make(tank)).axes[0]
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    np.testing.assert_array_equal(lines["level, y = 0.5 m"], [(0.0, 0.5), (2.0, 0.5)])
    np.testing.assert_array_equal(lines["elevation of the surface"], [(0.25, 0.0), (0.25, 2.0)])
    assert {"gauge", "right, force: push"} <= {text.get_text() for text in axes.texts}


@pytest.mark.parametrize("kind", DEFAULTS)
def test_every_scene_can_be_drawn(kind: str) -> None:
    case = make({"kind": kind})
    axes = draw(case).axes[0]
    shown = [text.get_text().split(",")[0] for text in axes.texts]
    assert list(dict.fromkeys(shown)) == list(case.scene.domain.wall_names)
    number = case.scene.domain.n_particles(case.plan.particle_spacing)
    label = f"fluid particles, {number}"
    if case.scene.domain.n_dim == 3:
        label = f"fluid particles in the slices, {3 * 40**2}"
    assert axes.collections[0].get_label() == label


@pytest.mark.parametrize(("name", "head"), [("a.png", b"\x89PNG"), ("a.svg", b"<?xml")])
def test_the_file_s_name_says_its_format(draw_small, name: str, head: bytes) -> None:
    draw_small("-o", name, code=0)
    first = Path(name).read_bytes()
    assert first.startswith(head)
    draw_small("-o", name, code=2)  # it is there
    draw_small("-o", name, "--force", code=0)
    assert Path(name).read_bytes() == first


def test_without_a_name_it_is_the_case_s(draw_small) -> None:
    draw_small(code=0)
    assert Path("small.png").is_file()


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["-o", "a.pdf"], 2, "--output: must end in .png or .svg; got a.pdf"),
        (["-o", "a"], 2, "--output: must end in .png or .svg"),
        (["-o", "no/a.png"], 3, "no/a.png was not written: No such file"),
        (["--set", "discretization.resolution=1000"], 2, "try --set discretization.resolution=250"),
    ],
)
def test_refusals(draw_small, arguments: list[str], code: int, words: str) -> None:
    assert words in draw_small(*arguments, code=code).output.replace("\n", " ")
    assert not list(Path().glob("a*"))


@pytest.fixture
def draw_small(sphrom, tmp_path, monkeypatch):
    """Draw a small case in a folder of its own."""
    monkeypatch.chdir(tmp_path)
    Path("small.yaml").write_text(
        "name: small\nscene: {kind: taylor-green}\ndiscretization: {resolution: 20}\n"
    )
    return partial(sphrom, "case", "draw", "small.yaml")


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


def test_a_box_in_space_is_drawn_as_three_slices() -> None:
    measure = {
        "flux": {"flow_rate": {"from": [1, 0, 0], "to": [1, 1, 2]}},
        "inside": {"probe": [0.5, 0.25, 1.5]},
    }
    axes = draw(make({
        "kind": "custom",
        "box": {"lower": [0, 0, 0], "upper": [4, 1, 2], "periodic": ["x"]},
        "walls": {"front": {"velocity": ["3*sin(pi*y)", 0, 0]}},
        "measure": measure,
    })).axes[0]  # fmt: skip
    assert axes.get_xlim() == pytest.approx((0.0, 4.0 + GAP * 4.0 + 2.0))
    names = [text.get_text() for text in axes.texts if text.get_text() not in measure]
    # Beside the slice of x and y, that of z and y, and that of x and z.
    assert names[:2] == ["bottom", "top"]
    assert sorted(names[2:6]) == ["back", "bottom", "front, 3 m/s", "top"]
    assert names[6:] == ["back", "front, 3 m/s"]
    right = 4.0 + GAP * 4.0
    upper = 1.0 + GAP * 4.0
    probes = [line.get_xydata()[0] for line in axes.lines if line.get_label() == "probes"]
    np.testing.assert_allclose(probes, [(0.5, 0.25), (right + 1.5, 0.25), (0.5, upper + 1.5)])
    _, across, _ = (line.get_xydata() for line in axes.lines if line.get_label() == "sections")
    corners = [(right, 0.0), (right + 2.0, 0.0), (right + 2.0, 1.0), (right, 1.0)]
    assert {(round(x, 9), round(y, 9)) for x, y in across} == {
        (round(x, 9), round(y, 9)) for x, y in corners
    }
    moving = [found for found in axes.collections if isinstance(found, Quiver)]
    assert [bool(arrows.U.any()) for arrows in moving] == [False, True]  # seen along x, and y
