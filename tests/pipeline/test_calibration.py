"""Calibrated and corrected reduced models, through the command line."""

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
        {"name": "plain", **FAST, "calibrated": False, "corrected": False},
        {"name": "calibrated", **FAST, "calibrated": True, "corrected": False},
        {"name": "corrected", **FAST},
        {"name": "fewer", **FAST, "n_modes": 4, "parameters": [100]},
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


@pytest.mark.parametrize("reynolds", [50, 70, 100])
def test_corrected_models_are_nearer_still(lid, reynolds):
    calibrated, corrected = (velocity_error(lid, n, reynolds) for n in ("calibrated", "corrected"))
    assert corrected < 0.97 * calibrated


@pytest.mark.parametrize(("name", "n_modes"), [("corrected", 6), ("fewer", 4)])
def test_corrected_training_runs_are_the_projected_ones(lid, name, n_modes):
    with (
        open_artifact(lid / "operators.h5", "sphrom/operators", made_by="") as operators,
        open_artifact(lid / f"rom-{name}-reynolds100.h5", "sphrom/coordinates", made_by="") as run_,
    ):
        projected = operators.read("bases/all/training_runs")[1, :, :n_modes]
        found = run_.read("generalized_coordinates")
        # The start is the scene's, whose fields are mapped as they are.
        assert np.abs(found - projected).max() < 1e-4 * np.abs(projected).max()


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


def test_a_run_goes_on_beyond_training_and_ends_in_the_steady_state(sphrom, lid):
    model = {"name": "corrected", **FAST, "parameters": [70], "steady": True, "until": 30.0}
    case = {**LID, "rom": [{**model, "name": "longer"}]}
    path = lid / "longer.yaml"
    path.write_text(yaml.safe_dump(case, sort_keys=False))
    result = sphrom("rom", path, "--out", lid, "--threads", 1)
    assert result.exit_code == 0, result.output
    assert "after 3 s the run is beyond the trained time" in result.stderr
    with (
        open_artifact(lid / "rom-longer-reynolds70.h5", "sphrom/coordinates", made_by="") as longer,
        open_artifact(lid / "rom-corrected-reynolds70.h5", "sphrom/coordinates", made_by="") as own,
    ):
        found, time = longer.read("generalized_coordinates"), longer.read("time")
        assert time[-1] == pytest.approx(30.0)
        assert not longer.read("correction")[time > 3.0 + 1e-9].any()
        n = len(own.read("time")) // 2
        np.testing.assert_allclose(
            found[:n], own.read("generalized_coordinates")[:n], atol=0.02 * np.abs(found).max()
        )
        steady = longer.read("steady/coordinates")
        assert np.linalg.norm(found[-1] - steady) < 1e-3 * np.linalg.norm(steady)
    result = sphrom("compare", path, "--out", lid, "--threads", 1, "--force")
    assert result.exit_code == 0, result.output
    assert "longer: no full run to compare with until 30 s" in result.stdout
