"""What cavities keep beside fields: a spin-up's last state, ghosts, the mean density."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from sphrom.artifacts import SCHEMAS, create_artifact, open_artifact
from sphrom.artifacts.layout import layout_problem

STATE, TRAJECTORY = SCHEMAS["sphrom/state"], SCHEMAS["sphrom/trajectory"]

STATE_FIELDS = ("position", "density_fluctuation", "velocity")
GHOSTS = {"ghost/position": np.zeros((4, 2)), "ghost/wall_velocity": np.ones((4, 2))}


def found(fields: dict[str, np.ndarray]) -> dict:
    return {name: (array.shape, array.dtype) for name, array in fields.items()}


def write_state(path: Path, fields: dict[str, np.ndarray], arguments: dict, **more: object) -> Path:
    physics = {k: v for k, v in arguments["attributes"].items() if k != "status"}
    with create_artifact(
        path, "sphrom/state", **(arguments | {"attributes": physics | more})
    ) as artifact:
        for name in STATE_FIELDS:
            artifact.write(name, fields[name][-1])
    return path


def test_the_end_of_a_spin_up_is_read_back(tmp_path, fields, arguments) -> None:
    path = write_state(tmp_path / "spin-up.h5", fields, arguments, time=5.0)
    with open_artifact(path, "sphrom/state", made_by="sphrom fom CASE") as state:
        assert state.number("time") == 5.0
        assert state.number("parameters/reynolds") == 100.0
        for name in STATE_FIELDS:
            np.testing.assert_array_equal(state.read(name), fields[name][-1])


def test_a_state_says_when_it_was(tmp_path, fields, arguments) -> None:
    with pytest.raises(ValueError, match="attribute time is missing"):
        write_state(tmp_path / "spin-up.h5", fields, arguments)
    assert not (tmp_path / "spin-up.h5").exists()


@pytest.mark.parametrize("gone", STATE_FIELDS)
def test_a_state_is_whole(fields, gone) -> None:
    state = found({name: fields[name][-1] for name in STATE_FIELDS if name != gone})
    assert layout_problem(STATE, state) == f"dataset {gone} is missing"


def test_a_trajectory_may_have_ghosts_and_a_mean_density(fields) -> None:
    reduced = {"generalized_coordinates": np.zeros((3, 2)), "mean_density_fluctuation": np.zeros(3)}
    for more in ({}, GHOSTS, reduced, GHOSTS | reduced):
        assert layout_problem(TRAJECTORY, found(fields | more)) is None


@pytest.mark.parametrize(
    ("name", "shape", "axis"),
    [("ghost/wall_velocity", (3, 2), "ghost"), ("mean_density_fluctuation", (2,), "snapshot")],
)
def test_they_are_as_many_as_they_belong_to(fields, name, shape, axis) -> None:
    problem = layout_problem(TRAJECTORY, found(fields | GHOSTS | {name: np.zeros(shape)}))
    assert f"along {axis}" in str(problem)
