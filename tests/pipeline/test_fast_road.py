"""Reduced models on the reference points, through the command line, for every scene."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sphrom.artifacts import open_artifact, read_record
from sphrom.case.loader import load_case
from sphrom.case.points import ParameterPoint
from sphrom.kernels.ahead import KERNELS
from sphrom.models.points.fast_model import FastModel
from sphrom.models.reference.stored import read_basis, read_points, read_splines
from sphrom.models.stored_run import StoredRun
from sphrom.reduction.memory_projection import project_memory
from sphrom.reduction.reduced_operators import MemoryOperators
from sphrom.reduction.reference_model import automatic, step_tolerance
from sphrom.setup import particles

FAST: dict[str, Any] = {
    "evaluation": "operators",
    "n_modes": 3,
    # Projection alone, nothing that training runs teach.
    "calibrated": False,
    "corrected": False,
}
COMPARE = {"plots": False, "grid": 12, "line_points": 21}
VORTEX: dict[str, Any] = {
    "name": "vortex",
    "scene": {"kind": "taylor-green"},
    "discretization": {"resolution": 16, "smoothing_length_ratio": 2.0},
    "time": {"final_time": 0.2},
    "snapshots": {"every": 2},
    "parameters": {"train": {"reynolds": [100, 200]}},
    "rom": [
        {"name": "fast", **FAST, "parameters": [100, 150, 200]},
        {"name": "apg", **FAST, "projection": "apg", "output": "snapshots"},
        {"name": "faithful", "n_modes": 3},
    ],
    "compare": COMPARE,
}
LID: dict[str, Any] = {
    "name": "lid",
    "scene": {"kind": "lid-driven-cavity"},
    "discretization": {"resolution": 16},
    "time": {"final_time": 3.0},
    "snapshots": {"every": 8},
    "rom": [{"name": "fast", **FAST, "n_modes": 8, "steady": True}],
    "compare": {**COMPARE, "from_time": 1.0},
}
OPEN: dict[str, Any] = {
    "name": "open",
    "scene": {"kind": "open-cavity"},
    "discretization": {"resolution": 40},
    "time": {"spin_up": 0.02, "final_time": 0.03, "step": 5e-4},
    "snapshots": {"every": 2},
    "rom": [
        {"name": "fast", **FAST, "parameters": [2400, 3000]},
        {"name": "apg", **FAST, "projection": "apg"},
        {"name": "calibrated", **FAST, "calibrated": True},
    ],
    "compare": {**COMPARE, "grid": 24},
}


@pytest.fixture
def place(copied) -> Path:
    """A copy of the vortex to work in; gives the artifacts' folder."""
    return copied(VORTEX)


def told(out: Path, stream: str = "stdout") -> str:
    """Return the output of the run that made a folder."""
    return (out.parents[1] / f"{stream}.txt").read_text()


def run_of(folder: Path, name: str):
    """Open what a model on the reference points gave."""
    return open_artifact(folder / f"rom-{name}.h5", "sphrom/coordinates", made_by="")


def coordinates(folder: Path, name: str) -> np.ndarray:
    with run_of(folder, name) as run:
        return run.read("generalized_coordinates")


LOADED = """
import sys
from sphrom.cli.app import app
try:
    app(sys.argv[1:])
finally:
    print(*sys.modules)
"""


@pytest.mark.slow
def test_a_run_from_operators_loads_no_kernel_of_sph(made, printed):
    out = made(LID)
    place = ("--out", out, "--force", "--quiet", "--set", f"rom={json.dumps(LID['rom'][:1])}")
    loaded = printed(LOADED, "rom", out.parents[1] / "lid.yaml", *place)
    late = {f"scipy.{name}" for name in ("interpolate", "optimize", "sparse", "spatial", "stats")}
    late |= {"sphrom.kernels.sweeps", "matplotlib", "pandas", "rich", "xarray"}
    assert not late & set(loaded.split())


def test_kernels_compiled_ahead_have_the_types_of_the_calls_by_stages(made):
    made(VORTEX)
    unlike = {kernel.__name__ for kernel, types in KERNELS if types not in kernel.overloads}
    assert unlike <= {"leave_out", "regularity"}  # not called with these types by this case


@pytest.mark.parametrize("case", [VORTEX, LID, OPEN], ids=lambda case: case["name"])
def test_operators_hold_what_the_scene_has(made, case):
    out = made(case)
    n = max(model["n_modes"] for model in case["rom"])
    with open_artifact(out / "operators.h5", "sphrom/operators", made_by="") as artifact:
        artifact.verify_content()
        assert artifact.read("bases/all/inertia/quadratic").shape == (n, n, n)
        assert ("bases/all/walls/linear" in artifact) == (case is not VORTEX)
        assert ("bases/all/force/constant" in artifact) == (case is OPEN)
        assert artifact.number("bases/all/skewness") < 1e-12
        assert ("bases/all/memory/3/cubic" in artifact) == (case is not LID)


@pytest.mark.parametrize("case", [LID, OPEN], ids=lambda case: case["name"])
def test_a_run_keeps_its_coordinates_alone(made, case):
    out, value = made(case), "reynolds2400" if case is OPEN else "reynolds100"
    with (
        run_of(out, f"fast-{value}") as run,
        open_artifact(out / f"fom-{value}.h5", "sphrom/trajectory", made_by="") as full,
    ):
        run.verify_content()
        assert run.text("status") == "complete"
        np.testing.assert_allclose(run.read("time"), full.read("time"), rtol=1e-12)
        n_modes = case["rom"][0]["n_modes"]
        assert run.read("generalized_coordinates").shape == (len(full.read("time")), n_modes)
        # Sound doesn't limit them.
        assert run.text("integrator") == "exponential"
        assert "velocity" not in run
        assert ("steady/coordinates" in run) == (case is LID)
        if case is LID:
            assert run.text("steady/status") == "converged"
    assert ("steady state converged in" in told(out)) == (case is LID)


def test_it_is_as_near_to_the_full_run_as_the_faithful_road(made, peaks):
    folder = made(VORTEX)
    fast, faithful, apg = (peaks(folder, name) for name in ("fast", "faithful", "apg"))
    assert fast[0] < 1.5 * faithful[0] + 0.1
    assert fast[1] < 1.5 * faithful[1] + 1.0
    assert apg[0] < 1.5 * faithful[0] + 0.1


def test_the_memory_length_is_kept_and_told(made):
    out = made(VORTEX)
    with run_of(out, "apg-reynolds100") as run:
        length = run.number("memory_length")
    case = load_case(out.parents[1] / "vortex.yaml")
    assert 0.0 < length <= 0.5 * case.plan.smoothing_length / case.plan.sound_speed
    found = re.search(r"^apg, reynolds=100: .* memory length (\S+) s$", told(out), re.MULTILINE)
    assert found is not None
    assert float(found[1]) == pytest.approx(length, rel=1e-2)
    with (out / "tables" / "timings.csv").open(newline="") as file:
        rows = {(row["model"], row["parameters"]): row for row in csv.DictReader(file)}
    row = rows["apg", "reynolds=100"]
    seconds = [float(row[f"{n}_seconds [s]"]) for n in ("full", "reduced")]
    assert float(row["speed_up"]) == pytest.approx(seconds[0] / seconds[1], rel=1e-6)
    assert float(row["memory_length [s]"]) == pytest.approx(length)


@pytest.mark.parametrize(("case", "reynolds"), [(VORTEX, 137.0), (OPEN, 2000.0)])
def test_closures_at_any_viscosity_are_those_assembled_there(made, workspace_of, case, reynolds):
    workspace = workspace_of(made(case))
    viscosity = workspace.case.plan.kinematic_viscosity(ParameterPoint(reynolds))
    with workspace.open(workspace.operators()) as artifact:
        stored = read_record(artifact, MemoryOperators, "bases/all/memory/3").at(viscosity)
    direct = project_memory(
        particles.fixed_points(workspace.case, read_points(workspace)),
        read_basis(workspace, "all"),
        read_splines(workspace, "all"),
    ).at(viscosity)
    assert len(stored.powers) == len(direct.powers)
    for found, expected in zip(stored.powers, direct.powers, strict=True):
        for one, other in zip(found, expected, strict=True):
            scale = max(np.abs(other).max(), 1e-12)
            np.testing.assert_allclose(one, other, atol=1e-10 * scale)


def test_runs_take_the_steps_of_the_nearest_training_run_as_exactly(made, workspace_of):
    workspace = workspace_of(made(VORTEX))
    fast = FastModel(workspace, workspace.case.rom[0])
    trained, near, other = (fast.at(ParameterPoint(re)) for re in (100.0, 130.0, 190.0))
    assert near.linear is trained.linear is not other.linear
    steps = automatic(near).steps
    assert steps.time_step <= near.first_step == automatic(trained).steps.time_step
    # Its own linear part, and many more steps, give the same run.
    own = replace(automatic(near.around(near.states)).steps, n_steps=40 * steps.n_steps).run()
    error = np.linalg.norm(steps.run().coordinates - own.coordinates)
    assert error < 1.5 * step_tolerance(near.basis) * np.linalg.norm(own.coordinates)


def test_a_value_without_a_full_run(made, errors_of):
    out = made(VORTEX)
    names = ("reynolds100", "reynolds150", "reynolds200")
    at = {name: coordinates(out, f"fast-{name}") for name in names}
    sizes = [np.linalg.norm(at[name][-1]) for name in names]
    assert sizes[0] < sizes[1] < sizes[2]
    assert not (out / "fom-reynolds150.h5").exists()
    assert "fast: no full run to compare with at reynolds=150" in told(out)
    assert {row["parameters"] for row in errors_of(out)} == {"reynolds=100", "reynolds=200"}


def test_a_value_without_a_spin_up_starts_from_the_nearest(made):
    out = made(OPEN)
    trained, unseen = (coordinates(out, f"fast-reynolds{re}") for re in (2400, 3000))
    np.testing.assert_array_equal(unseen[0], trained[0])
    assert np.abs(unseen[-1] - trained[-1]).max() > 0.0
    assert "reynolds=3000 has no spin-up of its own, so its run starts from" in told(out, "stderr")


@pytest.mark.parametrize("name", ["fast", "apg", "calibrated"])
def test_the_force_is_that_of_the_time(made, workspace_of, name):
    """From 0.02 to 0.03 s the force falls to a half; from 0 to 0.01 s it would not."""
    workspace = workspace_of(made(OPEN))
    point = workspace.case.plan.points[0]
    model = next(m for m in workspace.case.rom if m.name == name)
    with (
        StoredRun.opened(workspace, point) as full,
        StoredRun.opened(workspace, point, model) as reduced,
    ):
        runs = full, reduced
        momenta = [[run.fields(s)[0][:, 0].mean() for s in (0, len(run.time) - 1)] for run in runs]
    exact, (start, end) = momenta
    assert start == pytest.approx(exact[0], rel=0.02)
    # A force that did not fall would have added a quarter more.
    assert end - start == pytest.approx(exact[1] - exact[0], rel=0.05)


def test_stale_operators_are_refused(place, refused):
    change = ("--set", "operators.error_estimate=false")
    line = refused("rom", "vortex.yaml", *change, "--force")
    assert "operators.h5 was made with another case (operators.error_estimate is auto" in line


def test_only_a_closure_of_another_size_needs_other_operators(place, sphrom):
    sphrom("rom", "vortex.yaml", "--set", "rom.1.n_modes=2", "--force", code=3)
    more = ("--set", "rom.0.n_modes=2", "--set", "rom.0.parameters=[170]")
    kept = sphrom("operators", "vortex.yaml", *more)
    assert "operators.h5: up to date, kept" in kept.stdout


def test_a_run_that_diverges(place, sphrom, peaks):
    change = ("--set", "rom.1.memory_length=1000", "--set", "rom.1.time_step=fom")
    result = sphrom("run", "vortex.yaml", *change, "--force", "--threads", 1, code=4)
    assert "error: apg, reynolds=100: unstable after t = " in result.stderr
    assert "is beyond the model's stability limit of" in result.stderr
    with run_of(place, "apg-reynolds100") as run:
        run.verify_content()
        assert run.text("status") == "unstable"
        assert len(run.read("time")) == len(run.read("velocity")) < 20
    assert peaks(place, "fast")[0] < 5.0
