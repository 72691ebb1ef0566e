"""Runs that leave the range of their model are stopped, and never called a result."""

from __future__ import annotations

import csv
import json
import re

import numpy as np
import pytest

from sphrom.artifacts import open_artifact
from sphrom.store.trajectory import read_quantities

TOO_FAST = (
    "--force", "--threads", 1, "--set", "time.step=0.04", "--set", "time.final_time=0.8",
    "--set", "snapshots.every=1",
)  # fmt: skip


def test_an_unstable_full_run(empty, sphrom):
    warning, error = sphrom("fom", "tiny.yaml", *TOO_FAST, code=4).stderr.splitlines()
    assert "beyond the acoustic limit" in warning
    assert re.match(r"error: reynolds=100: unstable at step 3, t = 0.12 s: particle \d+ at ", error)
    assert "; the time step is beyond its limit of 0.01875" in error
    with open_artifact(empty / "fom-reynolds100.h5", "sphrom/trajectory", made_by="") as run:
        assert run.text("status") == "unstable"
        assert run.text("status_detail") in error
        assert len(run.read("time")) == 3


def test_nothing_is_made_from_an_unstable_full_run(empty, sphrom):
    sphrom("fom", "tiny.yaml", *TOO_FAST, code=4)
    kept = [value for value in TOO_FAST if value != "--force"]
    for stage in ("fom", "map"):
        sphrom(stage, "tiny.yaml", *kept, code=2)
    again = sphrom("run", "tiny.yaml", *TOO_FAST, "--verbose", code=4)
    assert "fom-reynolds100.h5: up to date, kept" in again.stdout
    for stage, change in (("map", ()), ("compare", ("--set", "rom=[]"))):
        one = ("--set", "parameters.train.reynolds=[100]", "--set", "parameters.test.reynolds=[]")
        result = sphrom(stage, "tiny.yaml", *TOO_FAST, *one, *change, code=3)
        assert "fom-reynolds100.h5 is of a run that became unstable (unstable at" in result.stderr
    assert {path.name for path in empty.glob("*.h5")} == {"packing.h5", "fom-reynolds100.h5"}


def test_an_unstable_reduced_run_does_not_keep_the_others(place, sphrom, peaks, errors_of):
    change = ("--set", "rom.1.memory_length=1000")
    result = sphrom("run", "tiny.yaml", *change, "--force", "--threads", 1, "--verbose", code=4)
    errors = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert [line.partition(": unstable ")[0] for line in errors] == [
        f"error: apg, reynolds={re}" for re in (100, 200, 150)
    ]
    assert peaks(place, "galerkin")[0] < 2.0
    rows = [row for row in errors_of(place) if row["compared"] == "apg"]
    assert {row["status"] for row in rows} == {"unstable"}
    assert not any(row[name] for row in rows for name in row if name.endswith("_peak"))
    with (place / "tables" / "timings.csv").open(newline="") as file:
        assert {row["model"] for row in csv.DictReader(file)} == {"galerkin"}
    again = sphrom("run", "tiny.yaml", *change, "--verbose", code=4)
    assert "rom-apg-reynolds100.h5: up to date, kept" in again.stdout


def test_a_channel_at_a_low_reynolds_number_runs_as_it_is(tmp_path, sphrom):
    """Poiseuille's flow, pressed on a wall: c0 = U_max / Ma = 0.64 m/s ended it by its density."""
    line = {"from": [0.8, 0], "to": [0.8, 1.6], "points": 17}
    scene = {"kind": "custom", "box": {"upper": [1.6, 1.6], "periodic": ["x"]}}
    scene |= {"body_force": [0.2, -0.5], "measure": {"profile": {"line": line}}}
    case = {"name": "slow", "scene": scene, "fluid": {"reference_speed": 0.064}, "rom": []}
    case |= {"parameters": {"train": {"reynolds": [0.1024]}}, "time": {"final_time": 2.0}}
    (tmp_path / "slow.yaml").write_text(json.dumps(case | {"discretization": {"resolution": 16}}))
    sphrom("fom", tmp_path / "slow.yaml", "--out", tmp_path, "--threads", 1, code=0)
    with open_artifact(tmp_path / "fom-reynolds0.1024.h5", "sphrom/trajectory", made_by="") as run:
        found = read_quantities(run, "profile")
    y = np.linspace(0.0, 1.6, 17)
    assert found["velocity"][-1, :, 0] == pytest.approx(0.1 * y * (1.6 - y), abs=6e-4)
    assert found["pressure"][-1] == pytest.approx(0.5 * (0.8 - y), abs=0.012)
