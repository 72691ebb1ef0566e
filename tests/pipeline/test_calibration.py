"""Calibrated and corrected reduced models, through the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from sphrom.artifacts import Artifact, open_artifact
from sphrom.models.points.stored import mapped_starts
from sphrom.models.points.training import _Training

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
        {"name": "fewer", **FAST, "n_modes": 5, "parameters": [100]},
        {"name": "leading", **FAST, "integrated_modes": 3, "parameters": [70, 100]},
        {"name": "third", **FAST, "n_modes": 3, "parameters": [70]},
        {"name": "chosen", **FAST, "n_modes": "auto", "parameters": [70]},
    ],
    "basis": {"n_modes": 6},
    "compare": {"plots": False, "grid": 12, "line_points": 21, "from_time": 1.0},
}


@pytest.fixture
def lid(made) -> Path:
    return made(LID)


def coordinates(folder: Path, name: str, reynolds: int) -> Artifact:
    """Open the run of a model."""
    path = folder / f"rom-{name}-reynolds{reynolds}.h5"
    return open_artifact(path, "sphrom/coordinates", made_by="")


@pytest.fixture
def velocity_error(lid, errors_of):
    def read(name: str, reynolds: int) -> float:
        wanted = name, f"reynolds={reynolds}"
        (row,) = (r for r in errors_of(lid) if (r["compared"], r["parameters"]) == wanted)
        return float(row["velocity_field_eq41_by_field_range_mean"])

    return read


@pytest.mark.parametrize("reynolds", [70, 100])
def test_calibrated_models_are_nearer_and_corrected_ones_nearer_still(velocity_error, reynolds):
    plain, calibrated, corrected = (
        velocity_error(name, reynolds) for name in ("plain", "calibrated", "corrected")
    )
    assert calibrated < 0.9 * plain
    assert corrected < 0.97 * calibrated


@pytest.mark.parametrize(("name", "n_modes"), [("corrected", 6), ("fewer", 5), ("leading", 6)])
def test_corrected_training_runs_are_the_projected_ones(lid, name, n_modes):
    with (
        open_artifact(lid / "operators.h5", "sphrom/operators", made_by="") as operators,
        coordinates(lid, name, 100) as run_,
    ):
        projected = operators.read("bases/all/training_runs")[1, :, :n_modes]
        found = run_.read("generalized_coordinates")
        # The start is the scene's, whose fields are mapped as they are.
        assert np.abs(found - projected).max() < 1e-4 * np.abs(projected).max()


def test_modes_that_training_runs_predict_are_better_than_none(lid, velocity_error):
    leading, third = (velocity_error(name, 70) for name in ("leading", "third"))
    assert leading < 0.8 * third
    with coordinates(lid, "leading", 70) as run_:
        assert run_.number("integrated_modes") == 3
        added, found = run_.read("correction"), run_.read("generalized_coordinates")
    assert np.array_equal(added[:, 3:], found[:, 3:])
    assert not np.array_equal(added[:, :3], found[:, :3])


def test_the_number_of_modes_is_that_of_the_least_errors_of_runs_held_out(lid, velocity_error):
    with open_artifact(lid / "operators.h5", "sphrom/operators", made_by="") as operators:
        error = operators.read("bases/all/held_out/error")
        integrated = operators.read("bases/all/held_out/integrated")
    n_modes = 1 + int(np.argmin(error.prod(axis=1)))
    with coordinates(lid, "chosen", 70) as chosen:
        assert chosen.read("generalized_coordinates").shape[1] == n_modes
        assert chosen.number("integrated_modes") == integrated[n_modes - 1]
    assert velocity_error("chosen", 70) <= 1.05 * velocity_error("corrected", 70)


def test_a_held_out_run_has_no_part_in_the_fit_of_what_predicts_it(lid, workspace_of):
    workspace = workspace_of(lid)
    (section,) = (model for model in workspace.case.rom if model.name == "calibrated")
    training = _Training(workspace, section, "all", mapped_starts(workspace).at)
    trained = training.model().trained
    found = [training._without(trained, k, [0, 1]) for k in (0, 1)]
    training.projected[0] *= 1.1
    (ours, theirs) = (training._without(trained, k, [0, 1]) for k in (0, 1))
    assert np.array_equal(ours[0].coordinates, found[0][0].coordinates)
    assert not np.array_equal(theirs[0].coordinates, found[1][0].coordinates)


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


@pytest.mark.parametrize(
    ("model", "problem"),
    [
        ({"calibrated": True, "n_modes": 2}, "calibrated: true needs training runs of 3"),
        ({"n_modes": "auto"}, "n_modes: auto needs training runs of 3 snapshots or more"),
    ],
)
def test_runs_of_two_snapshots_are_too_short(refused, written, model, problem):
    case = {**LID, "time": {"final_time": 0.02, "step": 2e-3}, "snapshots": {"every": 10}}
    case["compare"] = {**LID["compare"], "from_time": 0.0}
    case |= {"rom": [{"name": "x", "evaluation": "operators", **model}], "basis": {"n_modes": 2}}
    written(case)
    assert problem in " ".join(refused("case", "check", "lid.yaml", code=2).split())


def test_a_model_settles_on_the_cycles_of_periodic_runs_alone(refused, copied):
    copied(LID)
    models = [
        {"name": "x", **FAST, "calibrated": "cycle"},
        {**FAST, "name": "y", "n_modes": "auto"},
    ]
    Path("lid.yaml").write_text(yaml.safe_dump({**LID, "rom": models}, sort_keys=False))
    told = " ".join(refused("rom", "lid.yaml", "--threads", 1, code=2).split())
    assert "rom.calibrated: the training run at reynolds=50: " in told
    assert "see time.spin_up and time.final_time" in told


@pytest.mark.parametrize(("own", "n_integrated"), [("corrected", "auto"), ("leading", 3)])
def test_a_run_goes_on_beyond_training_and_ends_in_the_steady_state(
    sphrom, copied, own, n_integrated
):
    lid = copied(LID)
    model = {**FAST, "parameters": [70], "steady": True, "until": 30.0}
    longer = {"name": f"longer-{own}", **model, "integrated_modes": n_integrated}
    # The operators' case has a model that leaves the number of modes to training runs.
    chosen = {"name": "chosen", **FAST, "n_modes": "auto"}
    Path("lid.yaml").write_text(yaml.safe_dump({**LID, "rom": [longer, chosen]}, sort_keys=False))
    result = sphrom("rom", "lid.yaml", "--threads", 1, code=0)
    assert "after 3 s the run is beyond the trained time" in result.stderr
    with coordinates(lid, f"longer-{own}", 70) as longer, coordinates(lid, own, 70) as shorter:
        found, time = longer.read("generalized_coordinates"), longer.read("time")
        assert time[-1] == pytest.approx(30.0)
        assert not longer.read("correction")[time > 3.0 + 1e-9].any()
        n = len(shorter.read("time")) // 2
        np.testing.assert_allclose(
            found[:n], shorter.read("generalized_coordinates")[:n], atol=0.02 * np.abs(found).max()
        )
        steps = np.linalg.norm(np.diff(found, axis=0), axis=1)
        fades, before = (time[1:] > 2.6) & (time[1:] < 3.1), (time[1:] > 2.0) & (time[1:] < 2.6)
        assert steps[fades].max() < 2.0 * steps[before].max()
        steady = longer.read("steady/coordinates")
        assert np.linalg.norm(found[-1] - steady) < 1e-3 * np.linalg.norm(steady)
    result = sphrom("compare", "lid.yaml", "--threads", 1, "--force")
    assert f"longer-{own}: no full run to compare with until 30 s" in result.stdout
