"""A small trajectory, and ways to write it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sphrom.artifacts import create_artifact

PHYSICS = {
    "status": "complete",
    "reference_density": 1000.0,
    "sound_speed": 10.0,
    "kinematic_viscosity": 0.01,
    "particle_spacing": 0.1,
    "smoothing_length": 0.2,
    "time_step": 1e-3,
    "mass": 10.0,
    "box_length": (1.0, 1.0),
    "parameters/reynolds": 100.0,
}
CASE_TEXT = "name: demo\nfluid:\n  reynolds: 100\n"

Fields = dict[str, np.ndarray]
Write = Callable[..., Path]


@pytest.fixture
def fields() -> Fields:
    """Three snapshots of five particles."""
    generator = np.random.default_rng(0)
    return {
        "time": np.array([0.0, 0.5, 1.0]),
        "step": np.array([0, 500, 1000]),
        "position": generator.random((3, 5, 2)),
        "velocity": generator.random((3, 5, 2)),
        "density_fluctuation": generator.random((3, 5)),
        "pressure": generator.random((3, 5)),
    }


@pytest.fixture
def arguments() -> dict[str, object]:
    """What `create_artifact` is told of a trajectory."""
    return {
        "stage": "fom",
        "case_text": CASE_TEXT,
        "case_digest": "case",
        "inputs_digest": "inputs",
        "attributes": PHYSICS,
    }


@pytest.fixture
def write_trajectory(tmp_path: Path, fields: Fields, arguments: dict[str, object]) -> Write:
    """Write the trajectory to a file, with changed fields or arguments."""

    def write(path: Path | None = None, changed: Fields | None = None, **other: object) -> Path:
        path = path or tmp_path / "fom.h5"
        with create_artifact(path, "sphrom/trajectory", **(arguments | other)) as artifact:
            for name, array in (fields | (changed or {})).items():
                artifact.write(name, array)
        return path

    return write
