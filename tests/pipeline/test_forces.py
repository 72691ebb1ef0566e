"""Forces on walls through the command line: full runs, reduced ones, and where nothing is asked."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from sphrom.artifacts import Artifact, open_artifact
from sphrom.case.loader import load_case
from sphrom.case.points import ParameterPoint
from sphrom.online.wall_forces import forces_of
from sphrom.setup import particles
from sphrom.sph import time_loop
from sphrom.store.forces import read_forces
from sphrom.store.operators import read_wall_force

CASE: dict[str, Any] = {
    "name": "body",
    "scene": {
        "kind": "custom",
        "box": {"lower": [0, 0], "upper": [1.6, 1.6], "periodic": ["x"]},
        "solids": {"cylinder": {"circle": {"centre": [0.8, 0.8], "radius": 0.25}}},
        "walls": {"cylinder": {"rotation": 0.5}},
        "body_force": ["1.5*(1 + 0.2*sin(3*t))", 0],
        "reference_length": 0.5,
        "measure": {"drag": {"force_on": "cylinder"}, "roof": {"force_on": "top"}},
    },
    "discretization": {"resolution": 8},
    "time": {"final_time": 0.3},
    "snapshots": {"every": 2},
    "parameters": {"train": {"reynolds": [10, 20]}},
    "rom": [
        {"name": "fast", "evaluation": "operators", "n_modes": 4, "output": "snapshots"},
        {"name": "points", "evaluation": "points", "n_modes": 4, "parameters": [20]},
        {"name": "faithful", "n_modes": 4, "parameters": [20]},
    ],
    "compare": {"plots": False, "grid": 12, "line_points": 21},
}
FULL, RATE = ParameterPoint(20.0), "reynolds20"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, sphrom) -> Path:
    """A folder with the case's file, and its artifacts in `runs`."""
    folder = tmp_path_factory.mktemp("forces")
    (folder / "body.yaml").write_text(yaml.safe_dump(CASE))
    result = sphrom("run", folder / "body.yaml", "--out", folder / "runs", "--threads", 1)
    assert result.exit_code == 0, result.output
    return folder


@pytest.fixture
def opened(made: Path) -> Callable[[str], Artifact]:
    """Open an artifact by its name."""
    kinds = {"fom": "trajectory", "rom-fast": "coordinates", "rom-points": "coordinates"}

    def open_one(name: str):
        kind = next((k for start, k in kinds.items() if name.startswith(start)), "trajectory")
        return open_artifact(made / "runs" / name, f"sphrom/{kind}", made_by="")

    return open_one


@pytest.fixture
def projected(made: Path) -> Callable[[Artifact], dict[str, np.ndarray]]:
    """Return the forces of a reduced run as they were projected, not calibrated."""
    case = load_case(made / "body.yaml")

    def forces(run: Artifact) -> dict[str, np.ndarray]:
        states, mean = run.read("generalized_coordinates"), run.number("mean_density_fluctuation")
        modes = np.arange(states.shape[1])
        with open_artifact(made / "runs/operators.h5", "sphrom/operators", made_by="") as stored:
            found = {n: read_wall_force(stored, "all", n, modes) for n in ("drag", "roof")}
        return forces_of(case, FULL, found, mean, run.read("time"), states)

    return forces


def state_of(run: Artifact, snapshot: int) -> np.ndarray:
    """Return a snapshot as a full state."""
    return np.vstack(
        (
            np.asarray(run.dataset("position")[snapshot]).T,
            run.dataset("density_fluctuation")[snapshot],
            np.asarray(run.dataset("velocity")[snapshot]).T,
        )
    )


@pytest.mark.parametrize("name", [f"fom-{RATE}.h5", f"rom-faithful-{RATE}.h5"])
def test_stored_forces_are_those_of_the_snapshots(made: Path, opened, name: str) -> None:
    case = load_case(made / "body.yaml")
    functional = particles.functional(case, FULL)
    forces = particles.wall_forces(case, FULL, functional)
    with opened(name) as run:
        time = run.read("time")
        for i in (0, len(time) - 1):
            found = forces(state_of(run, i), float(time[i]))
            for measured in ("drag", "roof"):
                stored = read_forces(run, measured)[i]
                np.testing.assert_allclose(stored, found[measured], rtol=1e-9, atol=1e-12)


def test_projected_forces_are_those_of_the_fields_that_coordinates_mean(
    made: Path, opened, projected
) -> None:
    """At the reference points, where volumes are constant: 1/rho makes the difference."""
    case = load_case(made / "body.yaml")
    forces = particles.wall_forces(case, FULL, particles.functional(case, FULL))
    with opened(f"rom-fast-{RATE}.h5") as run:
        time, place = run.read("time"), run.read("reference_position").T
        density = run.read("density_fluctuation")
        last = np.vstack((place, density[-1], run.read("velocity")[-1].T))
        found = forces(last, float(time[-1]))
        thinned = np.abs(density[-1]).max() / case.fluid.reference_density
        for measured in ("drag", "roof"):
            largest = np.abs(found[measured]).max()
            wrong = projected(run)[measured][-1] - found[measured]
            assert np.abs(wrong).max() < 4.0 * thinned * largest
    assert thinned < 0.02


def test_points_and_operators_give_the_same_forces(opened) -> None:
    with opened(f"rom-fast-{RATE}.h5") as fast, opened(f"rom-points-{RATE}.h5") as points:
        a, b = (read_forces(run, "drag")[1:] for run in (fast, points))
    assert np.abs(a - b).max() < 0.01 * np.abs(a).max()


def test_reduced_forces_follow_the_full_run_s(opened, projected) -> None:
    with opened(f"fom-{RATE}.h5") as full, opened(f"rom-fast-{RATE}.h5") as fast:
        a, b = (read_forces(run, "drag").sum(axis=1)[1:, 0] for run in (full, fast))
        plain = projected(fast)["drag"].sum(axis=1)[1:, 0]
    wrong = np.linalg.norm(b - a)
    assert wrong < 0.04 * np.linalg.norm(a)
    assert wrong < 0.6 * np.linalg.norm(plain - a)


def test_a_stopped_run_goes_on_to_the_same_forces(
    made: Path, tmp_path: Path, sphrom, monkeypatch: pytest.MonkeyPatch
) -> None:
    step_taken = time_loop.watched_step
    left = [9]

    def stopped(rates: Any, state: Any, steps: Any, step: int) -> Any:
        if left and step == left[0]:
            left.clear()
            raise KeyboardInterrupt
        return step_taken(rates, state, steps, step)

    monkeypatch.setattr(time_loop, "watched_step", stopped)
    (tmp_path / "runs").mkdir()
    shutil.copy(made / "runs" / "packing.h5", tmp_path / "runs")
    only = ("fom", made / "body.yaml", "--out", tmp_path / "runs", "--threads", 1)
    first = sphrom(*only, "--only", RATE.replace("ds", "ds="))
    assert first.exit_code == 130, first.output
    again = sphrom(*only, "--only", RATE.replace("ds", "ds="), "--resume")
    assert again.exit_code == 0, again.output
    assert "goes on from its checkpoint" in again.output
    name = f"fom-{RATE}.h5"
    with (
        open_artifact(made / "runs" / name, "sphrom/trajectory", made_by="") as whole,
        open_artifact(tmp_path / "runs" / name, "sphrom/trajectory", made_by="") as resumed,
    ):
        assert whole.content_sha256 == resumed.content_sha256
        assert "force/drag/pressure" in whole.datasets
