"""The open cavity through the command line: a spin-up, and the recorded part that follows it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sphrom.artifacts import open_artifact

CASE: dict[str, Any] = {
    "name": "open",
    "scene": {"kind": "open-cavity"},
    "discretization": {"resolution": 40},
    "time": {"spin_up": 0.02, "final_time": 0.03, "step": 5e-4},
    "snapshots": {"every": 2},
    "rom": [{"name": "galerkin", "n_modes": 3}],
    "compare": {"plots": False, "grid": 24, "line_points": 21},
}
SPIN_UP, FULL, REDUCED = (f"{name}-reynolds2400.h5" for name in ("spin-up", "fom", "rom-galerkin"))


def trajectory(path: Path):
    return open_artifact(path, "sphrom/trajectory", made_by="")


@pytest.fixture
def channel(made) -> Path:
    """The artifacts' folder of the case."""
    return made(CASE)


@pytest.fixture
def out(copied) -> Path:
    """A copy of the finished folder, to work in; gives the artifacts' folder."""
    return copied(CASE)


def test_a_run_begins_with_the_spin_up_s_end(channel, digests):
    made = {SPIN_UP, FULL, "map-reynolds2400.h5", "pod.h5", "psi.h5", REDUCED, "compare.h5"}
    assert set(digests(channel)) == made
    with (
        open_artifact(channel / SPIN_UP, "sphrom/state", made_by="") as end,
        trajectory(channel / FULL) as run,
    ):
        assert end.number("time") == pytest.approx(0.02, rel=1e-12)
        for name in ("position", "velocity", "density_fluctuation"):
            np.testing.assert_array_equal(run.read(name)[0], end.read(name))
        assert end.read("velocity")[:, 0].mean() > 0.5
        times = run.read("time")
    np.testing.assert_allclose(times, np.linspace(0.02, 0.03, 11), rtol=1e-12)
    with trajectory(channel / REDUCED) as reduced:
        np.testing.assert_allclose(reduced.read("time"), times, rtol=1e-12)


def test_tables_tell_the_flow_and_the_spin_up(channel, peaks):
    assert 0.0 < peaks(channel, "galerkin")[0] < 4.0
    figures = json.loads((channel / "compare.json").read_text())
    assert {row["run"] for row in figures["flow"]} == {"full", "galerkin"}
    assert all(0.5 < row["bulk_velocity"] < 2.0 for row in figures["flow"])
    (mean,) = figures["reference"]
    assert mean["state"] == "time average"
    assert {SPIN_UP, FULL} < {row["artifact"] for row in figures["stages"]}


def test_the_recorded_part_is_repeated_without_the_spin_up(out, sphrom, digests):
    before, stamp = digests(out), (out / SPIN_UP).stat().st_mtime_ns
    (out / FULL).unlink()
    result = sphrom("fom", "open.yaml", "--threads", 1, code=0)
    assert f"{SPIN_UP}: up to date, kept" in result.stdout
    assert (out / SPIN_UP).stat().st_mtime_ns == stamp
    assert digests(out) == before


def test_a_later_end_needs_no_other_spin_up(out, sphrom, refused):
    stamp = (out / SPIN_UP).stat().st_mtime_ns
    with trajectory(out / FULL) as run:
        short = run.read("velocity")
    longer = ("--set", "time.final_time=0.035", "--threads", 1)
    line = refused("fom", "open.yaml", *longer)
    assert f"{out / FULL} ends at 0.03 s: `--resume` continues it" in line
    sphrom("fom", "open.yaml", *longer, "--force", code=0)
    assert (out / SPIN_UP).stat().st_mtime_ns == stamp
    with trajectory(out / FULL) as run:
        np.testing.assert_array_equal(run.read("velocity")[:11], short)
        assert run.read("time")[-1] == pytest.approx(0.035)


@pytest.mark.parametrize("change", ["scene.body_force.magnitude=90", "time.spin_up=0.01"])
def test_a_spin_up_of_another_case(out, refused, digests, change):
    before = digests(out)
    for stage in ("run", "rom"):
        line = refused(stage, "open.yaml", "--set", change)
        assert f"{out / SPIN_UP} was made with another case ({change.split('=')[0]} is " in line
    assert digests(out) == before


def test_a_missing_spin_up(out, sphrom, refused, digests):
    before = digests(out)
    (out / SPIN_UP).unlink()
    for stage in ("map", "pod", "fit-psi"):
        sphrom(stage, "open.yaml", code=0)  # they start from the full run
    (out / REDUCED).unlink()
    assert f"{out / SPIN_UP} is missing" in refused("rom", "open.yaml")
    for stage in ("fom", "rom"):
        sphrom(stage, "open.yaml", "--threads", 1, code=0)
    assert digests(out) == before


def test_a_particle_beyond_a_wall_ends_the_spin_up(written, sphrom):
    """Without shifting, at the corner that the fluid comes off."""
    out = written(CASE)
    result = sphrom(
        "fom", "open.yaml", "--set", "discretization.shifting.enabled=false", "--threads", 1, code=4
    )
    assert result.stderr.startswith("error: reynolds=2400, spin-up: unstable at step ")
    assert "beyond a wall" in result.stderr
    assert [path.name for path in out.iterdir()] == ["sphrom.log"]


@pytest.mark.parametrize(
    "changes",
    [
        (
            "discretization.walls.kind=normal",
            "basis.mean_density=separate",
            "rom.0.time_step=1e-3",
        ),
        ("scene.body_force.form=ramp-up", "time.step=auto", "compare.line=0.05"),
    ],
    ids=["normal", "ramp-up"],
)
def test_options_run_through(written, sphrom, peaks, changes):
    nothing = written(CASE)
    settings = [part for change in changes for part in ("--set", change)]
    sphrom("run", "open.yaml", "--threads", 1, *settings, code=0)
    assert peaks(nothing, "galerkin")[0] < 20.0


def test_plots_of_a_scene_with_walls(out, sphrom):
    sphrom("compare", "open.yaml", "--set", "compare.plots=true", code=0)
    plots = {path.name: path.stat().st_mtime_ns for path in (out / "plots").iterdir()}
    assert {"profiles-reynolds2400.png", "history-reynolds2400.png", "modes-all.png"} <= set(plots)
    # A picture that is missing is drawn again, and no other; one of an earlier comparison goes.
    (out / "plots" / "modes-all.png").unlink()
    (out / "plots" / "gone-reynolds2400.png").touch()
    sphrom("compare", "open.yaml", "--set", "compare.plots=true", code=0)
    again = {path.name: path.stat().st_mtime_ns for path in (out / "plots").iterdir()}
    assert {name for name in plots if again[name] != plots[name]} == {"modes-all.png"}
    assert set(again) == set(plots)
    # A new comparison leaves none of an earlier one.
    sphrom("compare", "open.yaml", "--force", "--set", "compare.plots=false", code=0)
    assert list((out / "plots").iterdir()) == []
