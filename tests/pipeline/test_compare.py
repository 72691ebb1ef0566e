"""What `compare` does where a comparison has no meaning, and what it says of cost."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from sphrom.compare.results import Excerpt
from sphrom.errors import UnstableError
from sphrom.metrics.samples import Probes, Samples
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
    result = sphrom("run", "tiny.yaml", "--force", "--set", "rom.1.jacobian_step=1e-6")
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


def test_an_excerpt_keeps_nothing_else_alive():
    samples = Samples(np.arange(5.0), np.zeros((5, 30, 2)), np.zeros((5, 30)))
    probes = Probes(line=np.zeros((10, 2)), grid=np.zeros((20, 2)), grid_shape=(4, 5))
    excerpt = Excerpt.of(samples, probes, middle=2)
    for kept in (excerpt.line, excerpt.middle):
        assert not np.shares_memory(kept.velocity, samples.velocity)
        assert not np.shares_memory(kept.pressure, samples.pressure)
    assert excerpt.middle.time == [2.0]
    assert Excerpt.of(samples.until(1), probes, middle=2).middle.time == [0.0]
