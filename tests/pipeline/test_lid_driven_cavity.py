"""The lid-driven cavity through the command line: walls, local bases, mean density, and leaks."""

from __future__ import annotations

import copy
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from sphrom.artifacts import open_artifact
from sphrom.case.loader import load_case

CASE: dict[str, Any] = {
    "name": "lid",
    "scene": {"kind": "lid-driven-cavity"},
    "discretization": {"resolution": 16},
    "time": {"final_time": 0.2, "courant_number": 0.75},
    "snapshots": {"every": 2},
    "parameters": {"train": {"reynolds": [50, 100, 150]}, "test": {"reynolds": [75]}},
    "basis": {"subsets": {"low": {"reynolds": [50, 100]}, "high": {"reynolds": [100, 150]}}},
    "rom": [
        {"name": "galerkin", "n_modes": 4, "parameters": [100]},
        {"name": "local", "n_modes": 3, "basis": "local"},
    ],
    "compare": {"plots": False, "grid": 12, "line_points": 21, "from_time": 0.05},
}
ALONE = (
    "--set", "parameters.train.reynolds=[100]", "--set", "parameters.test.reynolds=[]",
    "--set", "basis.subsets={}", "--threads", 1,
)  # fmt: skip
"""One value, and no local bases."""


def trajectory(path: Path):
    return open_artifact(path, "sphrom/trajectory", made_by="")


@pytest.fixture
def lid(made) -> Path:
    """The artifacts' folder of the case."""
    return made(CASE)


def test_trajectories_keep_their_ghosts_and_lose_no_particle(lid):
    domain = load_case(CASE).scene.domain
    for name in ("fom", "rom-galerkin", "rom-local"):
        with trajectory(lid / f"{name}-reynolds100.h5") as run:
            position = run.read("position")
            ghosts, velocity = run.read("ghost/position"), run.read("ghost/wall_velocity")
            assert 256 * run.number("mass") == pytest.approx(1.0)
        assert position.shape == (13, 256, 2)
        assert all(domain.contains(snapshot).all() for snapshot in position)
        assert len(ghosts) == 24**2 - 16**2
        assert not domain.contains(ghosts).any()
        assert 0.9 < velocity[ghosts[:, 1] > 1.0].max() <= 1.0
        assert not velocity[ghosts[:, 1] < 1.0].any()


def test_reduced_runs_carry_the_mean_density_apart(lid):
    with trajectory(lid / "rom-galerkin-reynolds100.h5") as run:
        mean, fluctuation = (run.read(f"{name}density_fluctuation") for name in ("mean_", ""))
        assert run.read("generalized_coordinates").shape == (13, 4)
    assert mean.shape == (13,)
    assert np.abs(mean).max() < 0.05 * np.abs(fluctuation).max()


def test_tables_tell_walls_flow_and_local_bases(lid, errors_of, peaks):
    for model in ("galerkin", "local"):
        assert 0.0 < peaks(lid, model)[0] < 2.5
    rows = [row for row in errors_of(lid) if row["against"] == "full"]
    bests = {(r["compared"], r["parameters"], r["role"]) for r in rows if "best" in r["compared"]}
    assert bests == {
        ("best possible, low M=3", "reynolds=50", "trained"),
        ("best possible, low M=3", "reynolds=75", "predicted"),
        ("best possible, high M=3", "reynolds=100", "trained"),
        ("best possible, all M=4", "reynolds=100", "trained"),
        ("best possible, high M=3", "reynolds=150", "trained"),
    }
    field = "pressure_field_relative_l2"
    error = {(row["compared"], row["parameters"]): float(row[field]) for row in rows}
    for best, point, _ in bests:
        assert error[best.replace("best possible", "each field alone"), point] < error[best, point]
    tables = {path.stem for path in (lid / "tables").glob("*.csv")}
    assert tables >= {"errors", "flow", "reference", "timings", "stages"}
    # The flow still changes, so it is not shown beside steady profiles.
    figures = json.loads((lid / "compare.json").read_text())
    assert {row["settled"] for row in figures["reference"]} == {False}
    assert {row["bulk_velocity"] for row in figures["flow"]} == {None}


def test_local_bases_are_those_of_the_intervals(copied, sphrom, digests):
    """What `local` runs is, to the bit, what the basis by its name runs."""
    folder, case = copied(CASE), copy.deepcopy(CASE)
    case["rom"] = [
        {"name": name, "n_modes": 3, "basis": name, "parameters": values}
        for name, values in (("low", [50, 75]), ("high", [100, 150]))
    ]
    case["basis"]["n_modes"] = 4  # as before, so that the bases are the same
    Path("lid.yaml").write_text(yaml.safe_dump(case, sort_keys=False))
    for stage in ("pod", "fit-psi", "rom"):
        sphrom(stage, "lid.yaml", "--force", "--threads", 1, code=0)
    found = digests(folder)
    for name, values in (("low", (50, 75)), ("high", (100, 150))):
        for value in values:
            run = f"reynolds{value}.h5"
            assert found[f"rom-{name}-{run}"] == found[f"rom-local-{run}"]
    assert found["rom-low-reynolds75.h5"] != found["rom-high-reynolds100.h5"]


@pytest.mark.parametrize(
    "changes",
    [
        ("discretization.walls.kind=printed", "discretization.walls.layers=3",
         "discretization.viscosity=paper",
         "discretization.fixed_volume=false", "discretization.shifting.form=paper",
         "discretization.shifting.transport=paper", "reference.method=shepard",
         "basis.inner_product=raw", "basis.mean_density=in-modes", "psi.polynomial_degree=1",
         "rom.0.projection=apg", "rom.0.memory_length=1e-7", "rom.0.advection=paper"),
        ("discretization.walls.kind=normal", "scene.lid=uniform"),
        ("discretization.walls.layers=6", "reference.points=lattice"),
        ("reference.points=relaxed", "basis.lagrangian=true", "rom.0.projection=apg"),
    ],
    ids=["as printed", "normal", "layers", "relaxed"],
)  # fmt: skip
def test_options_run_through(written, sphrom, errors_of, changes):
    out = written(CASE)
    short = ("time.final_time=0.06", "compare.from_time=0.02", "rom.0.n_modes=2")
    settings = [part for change in (*short, *changes) for part in ("--set", change)]
    model = ("--set", "rom.1.basis=all", "--set", "rom.1.n_modes=2")
    sphrom("run", "lid.yaml", *ALONE, *model, *settings, code=0)
    rows = [row for row in errors_of(out) if row["compared"] in ("galerkin", "local")]
    assert [row["status"] for row in rows] == ["complete"] * 2
    assert all(float(row["velocity_field_eq41_by_field_range_peak"]) < 20.0 for row in rows)


def test_a_particle_beyond_a_wall_ends_the_run(written, sphrom):
    """With walls as printed, the lid sucks particles through at its upstream corner."""
    out = written(CASE)
    leaking = ("rom=[]", "discretization.walls.kind=printed",
               "discretization.shifting.enabled=false")  # fmt: skip
    result = sphrom(
        "run", "lid.yaml", *ALONE, *(w for key in leaking for w in ("--set", key)), code=4
    )
    # The first of the uppermost row.
    found = re.search(r"t = ([\d.]+) s: particle 240 at .* m.*beyond a wall", result.stderr)
    assert found, result.stderr
    time = float(found[1])
    with trajectory(out / "fom-reynolds100.h5") as run:
        assert run.text("status") == "unstable"
        assert run.read("time")[-1] <= time
        assert (run.read("position") <= 1.0).all()
