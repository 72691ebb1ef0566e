"""Estimated errors of runs on the reference points, through the command line."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sphrom.artifacts import open_artifact
from sphrom.case.loader import load_case
from sphrom.case.points import ParameterPoint
from sphrom.models.reference.stored import read_modes, read_points
from sphrom.setup import particles

COMPARE = {"plots": False, "grid": 12, "line_points": 21}
FAST: dict[str, Any] = {"evaluation": "operators", "n_modes": 4, "calibrated": False}
LID: dict[str, Any] = {
    "name": "lid",
    "scene": {"kind": "lid-driven-cavity"},
    "fluid": {"reference_density": 800.0},
    "discretization": {"resolution": 16},
    "time": {"final_time": 3.0},
    "snapshots": {"every": 8},
    "parameters": {"train": {"reynolds": [100, 200]}, "test": {"reynolds": [150]}},
    "rom": [
        {"name": "fast", **FAST, "n_modes": 6, "parameters": [100, 125, 150, 400]},
        {"name": "small", **FAST, "parameters": "test"},
        {"name": "apg", **FAST, "projection": "apg", "calibrated": "auto", "parameters": "test"},
        {"name": "faithful", "n_modes": 4, "parameters": "test"},
    ],
    "compare": {**COMPARE, "from_time": 0.5},
}
OPEN: dict[str, Any] = {
    "name": "open",
    "scene": {"kind": "open-cavity"},
    "discretization": {"resolution": 40},
    "time": {"spin_up": 0.02, "final_time": 0.03, "step": 5e-4},
    "snapshots": {"every": 2},
    "basis": {"n_modes": 4},
    "rom": [{"name": "fast", **FAST, "n_modes": 3, "parameters": [2400, 1800]}],
    "compare": COMPARE,
}
LOCAL: dict[str, Any] = {
    **LID,
    "name": "local",
    "time": {"final_time": 1.0},
    "parameters": {"train": {"reynolds": [100, 150, 200]}},
    "basis": {
        "subsets": {
            "low": {"reynolds": [100, 150], "interval": [100, 150]},
            "high": {"reynolds": [150, 200], "interval": [150, 200]},
        }
    },
    "rom": [
        {"name": name, "basis": name, "evaluation": "operators", "n_modes": 4, "parameters": [125]}
        for name in ("local", "low")
    ],
}


def run_of(folder: Path, name: str):
    return open_artifact(folder / f"rom-{name}.h5", "sphrom/coordinates", made_by="")


@pytest.mark.parametrize("case", [LID, OPEN], ids=lambda case: case["name"])
def test_the_residual_is_that_at_all_points(made, workspace_of, unprojected, case) -> None:
    """What is left of the rates when the model's own are taken out, point by point."""
    closed = case is LID
    name, reynolds = ("apg-reynolds150", 150.0) if closed else ("fast-reynolds2400", 2400.0)
    workspace = workspace_of(made(case))
    with run_of(made(case), name) as run:
        residuals, states = run.read("residual"), run.read("generalized_coordinates")
        times = run.read("time")
    points = particles.fixed_points(workspace.case, read_points(workspace))
    model = unprojected(points, *read_modes(workspace, "all", states.shape[1]), order=1)
    flow = workspace.case.plan.flow(ParameterPoint(reynolds))
    viscosity = workspace.case.plan.kinematic_viscosity(ParameterPoint(reynolds))
    for k in (0, 3, len(times) - 1):
        amplitude = 0.0 if closed else flow.body_force.amplitude(float(times[k]))
        expected = model.residual(states[k], {"viscosity": viscosity, "amplitude": amplitude})
        if closed:
            # The closure leaves the projected rates, by little.
            assert expected < residuals[k] < 1.1 * expected
        else:
            assert residuals[k] == pytest.approx(expected, rel=1e-4)


def test_estimates_are_near_the_errors(made) -> None:
    """Also where nothing was trained: within a factor that training errors scatter by too."""
    folder = made(LID)
    with (folder / "tables" / "estimates.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(r["compared"], r["parameters"], r["role"]) for r in rows] == [
        ("fast", "reynolds=100", "trained"),
        ("fast", "reynolds=150", "predicted"),
        ("small", "reynolds=150", "predicted"),
        ("apg", "reynolds=150", "predicted"),
    ]
    for row in rows:
        for field in ("velocity", "pressure"):
            # An interpolated pressure is nearly exact in training runs; estimates are not.
            most = 5.0 if (row["role"], field) == ("trained", "pressure") else 2.5
            assert 0.4 < float(row[f"{field}_effectivity_mean"]) < most
            estimate, error = (float(row[f"{field}_{n} [%]"]) for n in ("estimate", "error"))
            assert 0.4 * error < estimate < most * error


def test_each_prediction_comes_with_its_estimate(made) -> None:
    """Where there is no full run as well."""
    folder = made(LID)
    told = (folder.parents[1] / "stdout.txt").read_text()
    assert "effectivity is the ratio of estimate to error" in told
    for run in ("fast, reynolds=125", "small, reynolds=150", "apg, reynolds=150"):
        (line,) = re.findall(rf"^{run}: estimated errors: (.*)$", told, re.MULTILINE)
        assert re.match(r"velocity \S+ % .* factor of \S+ in training\), pressure \S+ % ", line)
    assert "faithful, reynolds=150: estimated" not in told
    with run_of(folder, "fast-reynolds125") as run:
        estimate = run.read("error_estimate/velocity")
        assert estimate[0] == 0.0
        assert (estimate[1:] > 0.0).all()


@pytest.mark.parametrize(
    ("case", "inside", "outside", "trained"),
    [
        (LID, "125", "400", "100 to 200 of reynolds"),
        (OPEN, "2400", "1800", "2400 of reynolds"),
    ],
    ids=["lid", "spun up"],
)
def test_outside_of_training_no_factor_of_training_is_claimed(
    made, case, inside, outside, trained
) -> None:
    told = (made(case).parents[1] / "stdout.txt").read_text()
    found = dict(re.findall(r"^fast, reynolds=(\d+): estimated errors: (.*)$", told, re.MULTILINE))
    assert "factor" in found[inside]
    assert "factor" not in found[outside]
    assert f"outside of the trained range, {trained}: a reduced" in found[outside]


def test_estimates_rise_with_what_the_basis_does_not_hold_of_the_change(made) -> None:
    ends = {}
    for reynolds in (100, 125, 400):
        with run_of(made(LID), f"fast-reynolds{reynolds}") as run:
            ends[reynolds] = run.read("error_estimate/velocity")[-1]
            where = run.text("error_estimate/training")
            assert where == ("outside" if reynolds == 400 else "inside")
            assert ("error_estimate/velocity_factor" in run.attributes) == (where == "inside")
    assert ends[400] > 2.0 * max(ends[100], ends[125])


def test_a_local_basis_is_estimated_from_its_own_training_runs(made) -> None:
    """Also from one at which another basis is the local one."""
    folder = made(LOCAL)
    found = []
    for name in ("local", "low"):
        with run_of(folder, f"{name}-reynolds125") as run:
            found.append(run.read("error_estimate/velocity"))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)


def test_a_case_may_do_without(copied, sphrom) -> None:
    copied(OPEN)
    change = ("--threads", 1, "--set", "operators.error_estimate=false")
    for stage in ("operators", "rom", "compare"):
        result = sphrom(stage, "open.yaml", *change, "--force", code=0)
        assert "estimated errors" not in result.output


def test_many_modes_are_estimated_when_asked_for_only() -> None:
    for wanted in ("auto", True):
        many = {**LID, "operators": {"error_estimate": wanted}, "basis": {"n_modes": 31}}
        assert load_case(many).plan.has_error_estimate("all") is (wanted is True)
