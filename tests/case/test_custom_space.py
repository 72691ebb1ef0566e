"""Flows of one's own in three dimensions: their expressions, walls and defaults."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import sphrom
from sphrom.case.loader import load_case
from sphrom.case.models import Case, resolved_yaml
from sphrom.errors import CaseError
from sphrom.sph.domain import SIDES

BOX: dict[str, Any] = {"lower": [0, 0, -1], "upper": [2, 1, 1], "periodic": ["x"]}
PLACES = np.random.default_rng(2).uniform((0.0, 0.0, -1.0), (2.0, 1.0, 1.0), (20, 3))


@pytest.fixture
def load(tmp_path: Path):
    """Load a case with some keys of its scene changed."""

    def case(**scene: Any) -> Case:
        path = tmp_path / "case.yaml"
        given = {"discretization": {"resolution": 24}, "scene": {"kind": "custom", "box": BOX}}
        given["scene"] |= scene
        path.write_text(yaml.safe_dump({"name": "x", **given}))
        return load_case(path)

    return case


def flow(case: Case) -> Any:
    return case.plan.flow(case.plan.points[0])


def test_expressions_depend_on_all_three_coordinates(load) -> None:
    start = {"u": "0.1*z*y*(1 - y)", "v": "0", "w": "0.01*sin(pi*y)*cos(pi*z/2)", "p": "x + z"}
    case = load(initial=start, body_force=["0.1*z", 0, "0.2*cos(pi*x)"])
    x, y, z = PLACES.T
    found = flow(case)
    u = 0.1 * z * y * (1.0 - y)
    w = 0.01 * np.sin(np.pi * y) * np.cos(np.pi * z / 2.0)
    expected = np.stack((u, np.zeros_like(u), w), axis=1)
    np.testing.assert_allclose(found.initial_velocity(PLACES), expected, atol=1e-15)
    np.testing.assert_allclose(found.initial_pressure(PLACES), x + z)
    push = np.stack((0.1 * z, np.zeros_like(z), 0.2 * np.cos(np.pi * x)))
    np.testing.assert_allclose(found.body_force(PLACES.T, 0.3), push)
    assert case.plan.is_driven(case.plan.points[0])


WALLS: dict[str, Any] = {
    "left": (["0", "x + z", "2"], lambda x, y, z: (0.0, x + z, 2.0)),
    "right": (["0", "1", "y"], lambda x, y, z: (0.0, 1.0, y)),
    "bottom": (["sin(pi*z)", "0", "0"], lambda x, y, z: (np.sin(np.pi * z), 0.0, 0.0)),
    "top": (["0", "0", "x"], lambda x, y, z: (0.0, 0.0, x)),
    "back": (["y", "x", "0"], lambda x, y, z: (y, x, 0.0)),
    "front": (["1", "0", "0"], lambda x, y, z: (1.0, 0.0, 0.0)),
}
"""Velocities of walls as expressions, and as functions."""


@pytest.mark.parametrize("name", WALLS)
def test_each_wall_moves_with_its_own_velocity(load, name: str) -> None:
    walls = {wall: {"velocity": velocity} for wall, (velocity, _) in WALLS.items()}
    case = load(box={**BOX, "periodic": []}, walls=walls)
    assert case.scene.domain.wall_names == tuple(WALLS)
    axis = next(n for n, names in enumerate(SIDES) if name in names)
    is_upper = name == SIDES[axis][1]
    beyond = PLACES.copy()
    beyond[:, axis] = BOX["upper"][axis] + 1e-6 if is_upper else BOX["lower"][axis] - 1e-6
    expected = np.stack([np.broadcast_to(v, 20) for v in WALLS[name][1](*beyond.T)], axis=1)
    np.testing.assert_allclose(flow(case).wall_velocity(beyond), expected, atol=1e-5)


def test_a_wall_may_change_with_time(load) -> None:
    case = load(walls={"front": {"velocity": ["y*sin(t)", 0, 0]}})
    assert flow(case).wall_amplitude(0.5) == pytest.approx(np.sin(0.5))
    assert case.plan.sound_speed == pytest.approx(10.0)


def test_a_box_of_three_lengths_has_defaults_of_space(load) -> None:
    case = load()
    assert case.reference.points == "lattice"
    assert case.plan.lattice_splines
    assert case.plan.smoothing_length == pytest.approx(2.0 * case.plan.particle_spacing)
    assert case.plan.mass == pytest.approx(case.fluid.reference_density * (2.0 / 24) ** 3)
    assert case.plan.n_particles == 24 * 12 * 24 == len(case.scene.fill(2.0 / 24))
    assert case.scene.body_force == (0.0, 0.0)
    assert flow(case).body_force is None
    assert Case.model_validate(yaml.safe_load(resolved_yaml(case))) == case


def test_a_file_of_initial_fields_is_for_a_plane(load, tmp_path: Path) -> None:
    (tmp_path / "start.csv").write_text("x,y,u,v\n0,0,0,0\n1,0,0,0\n0,1,0,0\n")
    with pytest.raises(CaseError, match=r"initial\.file: is only supported in two dimensions"):
        load(initial={"file": "start.csv"})


def test_a_function_of_python_may_give_all_three_components() -> None:
    keys = sphrom.Flow(box=BOX, body_force=lambda x, y, z: (0.1 * z, 0.0 * x, 0.2 * y))
    case = Case.model_validate({"name": "x", "scene": keys, "discretization": {"resolution": 24}})
    found = flow(case).body_force(PLACES.T, 0.0)
    np.testing.assert_allclose(found, [0.1 * PLACES[:, 2], 0.0 * PLACES[:, 0], 0.2 * PLACES[:, 1]])
