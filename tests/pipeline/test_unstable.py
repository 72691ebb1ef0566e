"""Runs that leave the range of their model are stopped, and never called a result."""

from __future__ import annotations

import csv
import re

from sphrom.artifacts import open_artifact

TOO_FAST = (
    "--force", "--threads", 1, "--set", "time.step=0.04", "--set", "time.final_time=0.8",
    "--set", "snapshots.every=1",
)  # fmt: skip


def test_an_unstable_full_run(empty, sphrom):
    result = sphrom("fom", "tiny.yaml", *TOO_FAST)
    assert result.exit_code == 4
    warning, error = result.stderr.splitlines()
    assert "beyond the acoustic limit" in warning
    assert re.match(r"error: reynolds=100: unstable at step 3, t = 0.12 s: particle \d+ at ", error)
    assert "; the time step is beyond its limit of 0.01875" in error
    with open_artifact(empty / "fom-reynolds100.h5", "sphrom/trajectory", made_by="") as run:
        assert run.text("status") == "unstable"
        assert run.text("status_detail") in error
        assert len(run.read("time")) == 3


def test_nothing_is_made_from_an_unstable_full_run(empty, sphrom):
    assert sphrom("fom", "tiny.yaml", *TOO_FAST).exit_code == 4
    kept = [value for value in TOO_FAST if value != "--force"]
    for stage in ("fom", "map"):
        assert sphrom(stage, "tiny.yaml", *kept).exit_code == 2
    again = sphrom("run", "tiny.yaml", *TOO_FAST, "--verbose")
    assert again.exit_code == 4
    assert "fom-reynolds100.h5: there, and of this case: kept" in again.stdout
    for stage, change in (("map", ()), ("compare", ("--set", "rom=[]"))):
        one = ("--set", "parameters.train.reynolds=[100]", "--set", "parameters.test.reynolds=[]")
        result = sphrom(stage, "tiny.yaml", *TOO_FAST, *one, *change)
        assert result.exit_code == 3
        assert "fom-reynolds100.h5 is of a run that became unstable (unstable at" in result.stderr
    assert {path.name for path in empty.glob("*.h5")} == {"packing.h5", "fom-reynolds100.h5"}


def test_an_unstable_reduced_run_does_not_keep_the_others(place, sphrom, peaks, errors_of):
    change = ("--set", "rom.1.memory_length=1000")
    result = sphrom("run", "tiny.yaml", *change, "--force", "--threads", 1, "--verbose")
    assert result.exit_code == 4, result.output
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
    again = sphrom("run", "tiny.yaml", *change, "--verbose")
    assert again.exit_code == 4
    assert "rom-apg-reynolds100.h5: there, and of this case: kept" in again.stdout
