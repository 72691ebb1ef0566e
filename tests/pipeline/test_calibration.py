"""Calibrated reduced models, through the command line."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from sphrom.artifacts import open_artifact

FAST: dict[str, Any] = {"evaluation": "operators", "n_modes": 6}
LID: dict[str, Any] = {
    "name": "lid",
    "scene": {"kind": "lid-driven-cavity"},
    "discretization": {"resolution": 20},
    "time": {"final_time": 3.0},
    "snapshots": {"every": 4},
    "parameters": {"train": {"reynolds": [50, 100]}, "test": {"reynolds": [70]}},
    "rom": [
        {"name": "plain", **FAST},
        {"name": "calibrated", **FAST, "calibrated": True},
        {"name": "fewer", **FAST, "calibrated": True, "n_modes": 4, "parameters": [100]},
    ],
    "compare": {"plots": False, "grid": 12, "line_points": 21, "from_time": 1.0},
}
FORCED: dict[str, Any] = {
    "name": "open",
    "scene": {"kind": "open-cavity"},
    "discretization": {"resolution": 40},
    "time": {"spin_up": 0.02, "final_time": 0.03, "step": 5e-4},
    "snapshots": {"every": 2},
    "rom": [{"name": "calibrated", "evaluation": "operators", "n_modes": 3, "calibrated": True}],
    "compare": {"plots": False, "grid": 24},
}


def run(sphrom, case: dict[str, Any], folder: Path) -> Path:
    path = folder / f"{case['name']}.yaml"
    path.write_text(yaml.safe_dump(case, sort_keys=False))
    result = sphrom("run", path, "--out", folder, "--threads", 1)
    assert result.exit_code == 0, result.output
    return folder


@pytest.fixture(scope="module")
def lid(tmp_path_factory: pytest.TempPathFactory, sphrom) -> Path:
    return run(sphrom, LID, tmp_path_factory.mktemp("lid"))


def velocity_error(folder: Path, name: str, reynolds: int) -> float:
    with (folder / "tables" / "errors.csv").open(newline="") as file:
        (row,) = (
            row
            for row in csv.DictReader(file)
            if row["compared"] == name and row["parameters"] == f"reynolds={reynolds}"
        )
    return float(row["velocity_field_eq41_by_field_range_mean [%]"])


@pytest.mark.parametrize("reynolds", [50, 70, 100])
def test_calibrated_models_are_nearer_where_trained_and_between(lid, reynolds):
    plain, calibrated = (velocity_error(lid, n, reynolds) for n in ("plain", "calibrated"))
    assert calibrated < 0.8 * plain


def test_training_runs_are_the_projected_snapshots(lid):
    with (
        open_artifact(lid / "operators.h5", "sphrom/operators", made_by="") as operators,
        open_artifact(lid / "pod.h5", "sphrom/basis", made_by="") as basis,
        open_artifact(lid / "map-reynolds100.h5", "sphrom/reference-snapshots", made_by="") as run_,
    ):
        kept = operators.read("bases/all/training_runs")
        assert kept.shape == (2, len(run_.read("time")), 6)
        # Velocities alone, as modes of the density have no part in a flow without density.
        modes = basis.read("bases/all/modes/velocity")
        scaled = basis.read("bases/all/modes/density")
        density = run_.read("density_fluctuation")
        density = density - density.mean(axis=1, keepdims=True)
        speed, reference = basis.number("sound_speed"), basis.number("reference_density")
        area = basis.read("volume")[0]
        expected = np.einsum("snd,mnd->sm", run_.read("velocity"), modes)
        expected += speed / reference * density @ scaled.T
        np.testing.assert_allclose(kept[1], area * expected, rtol=1e-9, atol=1e-12)


def test_a_forced_flow_is_calibrated_too(sphrom, tmp_path):
    folder = run(sphrom, FORCED, tmp_path)
    name = folder / "rom-calibrated-reynolds2400.h5"
    with open_artifact(name, "sphrom/coordinates", made_by="") as artifact:
        assert artifact.text("status") == "complete"


def test_runs_of_two_snapshots_are_too_short(sphrom, tmp_path):
    case = {**LID, "time": {"final_time": 0.02, "step": 2e-3}, "snapshots": {"every": 10}}
    case["compare"] = {**LID["compare"], "from_time": 0.0}
    case["rom"] = [{**LID["rom"][1], "n_modes": 2}]
    path = tmp_path / "lid.yaml"
    path.write_text(yaml.safe_dump(case, sort_keys=False))
    result = sphrom("run", path, "--out", tmp_path, "--threads", 1)
    assert result.exit_code == 2
    assert "calibrate" in " ".join(result.stderr.split())
