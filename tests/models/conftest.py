"""A cavity with a model from operators and one on particles, and a tank with a free surface."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sphrom

LID: dict[str, Any] = {
    "name": "lid",
    "scene": {
        "kind": "lid-driven-cavity",
        "measure": {
            "drag": {"force_on": "top"},
            "centre": {"probe": [0.5, 0.5]},
            "middle": {"line": {"from": [0.5, 0], "to": [0.5, 1], "points": 5}},
        },
    },
    "discretization": {"resolution": 16},
    "time": {"final_time": 0.6},
    "snapshots": {"every": 6},
    "parameters": {"train": {"reynolds": [50, 200], "lid": [0.5, 1.0]}},
    "rom": [
        {"name": "fast", "evaluation": "operators", "n_modes": 5},
        {"name": "slow", "n_modes": 5, "parameters": [{"reynolds": 50, "lid": 0.5}]},
    ],
    "compare": {"plots": False, "grid": 8},
}
TANK: dict[str, Any] = {
    "name": "tank",
    "scene": {
        "kind": "custom",
        "box": {"lower": [0, 0], "upper": [1, 1]},
        "fluid": {"level": 0.5, "gravity": 1.0},
        "slip": "free",
        "constants": {"ratio": 0.9},
        "histories": {"sway": {"file": "sway.csv"}},
        "body_force": ["0.02*ratio*sway(t)", 0],
        "reference_length": 0.5,
        "measure": {
            "gauge": {"elevation": 0},
            "side": {"force_on": "left"},
            "centre": {"probe": [0.5, 0.25]},
        },
    },
    "fluid": {"reference_speed": 0.7},
    "discretization": {"resolution": 10},
    "time": {"spin_up": 0.2, "final_time": 2.0},
    "snapshots": {"every": 5},
    "parameters": {"train": {"reynolds": [250], "ratio": [0.85, 1.1]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3}],
    "compare": {"plots": False, "grid": 8},
}


@pytest.fixture(scope="package")
def study(tmp_path_factory: pytest.TempPathFactory) -> sphrom.Study:
    """The cavity, with the runs of its models."""
    made = sphrom.Study(LID, out=tmp_path_factory.mktemp("lid") / "runs", threads=1, quiet=True)
    made.run(until="rom")
    return made


@pytest.fixture(scope="package")
def tank(tmp_path_factory: pytest.TempPathFactory) -> sphrom.Study:
    """The tank; the history that shakes it is lost after its runs."""
    folder, before = tmp_path_factory.mktemp("tank"), Path.cwd()
    os.chdir(folder)
    times = np.arange(0.0, 2.3, 0.1)
    rows = np.column_stack([times, np.sin(1.5 * times)])
    np.savetxt("sway.csv", rows, "%.6f", ",", header="t,a", comments="")
    made = sphrom.Study(TANK, out=folder / "runs", threads=1, quiet=True)
    made.run(until="rom")
    os.chdir(before)
    return made


@pytest.fixture(scope="package")
def study_of(study: sphrom.Study, tank: sphrom.Study) -> Callable[[str], sphrom.Study]:
    """The study with models of a family."""
    return lambda family: tank if family == "surface" else study
