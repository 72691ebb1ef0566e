"""What `compare` does where a comparison has no meaning, and what it says of cost."""

from __future__ import annotations

import csv

import pytest

from sphrom.errors import UnstableError
from sphrom.online import particle_runs


@pytest.mark.parametrize("change", ["compare.grid=2", "compare.line_points=2"])
def test_probes_that_all_see_the_same_are_refused(place, sphrom, change):
    """The flow's symmetry gives every point of so coarse a set of probes one pressure."""
    result = sphrom("compare", "tiny.yaml", "--force", "--set", change)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: compare.line_points, compare.grid, compare.from_time: ")


def test_a_model_that_fails_at_its_start_is_reported(place, sphrom, errors_of, monkeypatch):
    """The others run all the same, and the table says which one did not."""

    def fail(*_: object) -> float:
        raise UnstableError("no density is left")

    monkeypatch.setattr(particle_runs, "reduced_jacobian", fail)
    result = sphrom("run", "tiny.yaml", "--force", "--set", "rom.1.advection=paper")
    assert result.exit_code == 4
    assert "apg, reynolds=100: unstable at the start: no density is left" in result.stderr
    status = {row["compared"]: row["status"] for row in errors_of(place)}
    assert status["apg"] == "unstable"
    assert status["galerkin"] == "complete"


def test_costs_name_both_time_steps(finished):
    with (finished[0] / "runs" / "tiny" / "tables" / "timings.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert all(float(row["reduced_seconds [s]"]) > 0.0 for row in rows)
    assert all(row["full_step [s]"] == row["reduced_step [s]"] for row in rows)
