"""The lid-driven cavity through the command line: walls, local bases, mean density, and leaks."""

from __future__ import annotations

import copy
import csv
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from sphrom.artifacts import open_artifact
from sphrom.case.loader import load_case
from sphrom.setup.cost import needs

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
FULL_RUN = (*ALONE, "--set", "rom=[]")
LEAKING = (
    "--set", "discretization.walls.continuity=paper",
    "--set", "discretization.shifting.enabled=false",
)  # fmt: skip
"""Walls as printed: the lid sucks particles through at its upstream corner."""


def trajectory(path: Path):
    return open_artifact(path, "sphrom/trajectory", made_by="")


@pytest.fixture(scope="module")
def lid(tmp_path_factory: pytest.TempPathFactory, sphrom) -> Path:
    """A folder with the case and, below `runs/lid`, all that `run` makes of it."""
    folder = tmp_path_factory.mktemp("lid")
    (folder / "lid.yaml").write_text(yaml.safe_dump(CASE, sort_keys=False))
    result = sphrom(
        "run", folder / "lid.yaml", "--out", folder / "runs" / "lid", "--threads", 1, "--verbose"
    )
    assert result.exit_code == 0, result.output
    (folder / "output.txt").write_text(result.stdout)
    return folder


@pytest.fixture
def lid_copy(lid, tmp_path, monkeypatch) -> Path:
    """A copy of the finished folder, to work in; gives the artifacts' folder."""
    shutil.copytree(lid, tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    return Path("runs/lid")


@pytest.fixture
def lid_only(tmp_path, monkeypatch) -> Path:
    """A folder with nothing but the case, to work in; gives the artifacts' folder."""
    (tmp_path / "lid.yaml").write_text(yaml.safe_dump(CASE, sort_keys=False))
    monkeypatch.chdir(tmp_path)
    return Path("runs/lid")


def test_run_makes_every_artifact(lid, digests):
    made = {
        *(f"{stage}-reynolds{re}.h5" for stage in ("fom", "map") for re in (50, 75, 100, 150)),
        "pod.h5", "psi.h5", "compare.h5", "rom-galerkin-reynolds100.h5",
        *(f"rom-local-reynolds{re}.h5" for re in (50, 75, 100, 150)),
    }  # fmt: skip
    assert set(digests(lid / "runs" / "lid")) == made  # no packing, no spin-up


def test_trajectories_keep_their_ghosts_and_lose_no_particle(lid):
    domain = load_case(lid / "lid.yaml").scene.domain
    ghosts = []
    for path in (lid / "runs" / "lid").glob("*-reynolds100.h5"):
        if path.name.startswith("map"):
            continue
        with trajectory(path) as run:
            position = run.read("position")
            ghosts.append((run.read("ghost/position"), run.read("ghost/wall_velocity")))
            assert run.text("status") == "complete"
            assert np.isfinite(run.read("pressure")).all()
            assert 256 * run.number("mass") == pytest.approx(1.0)
        assert position.shape == (12, 256, 2)
        assert all(domain.contains(snapshot).all() for snapshot in position)
    assert len(ghosts) == 3
    for position, velocity in ghosts:
        assert len(position) == 24**2 - 16**2
        assert not domain.contains(position).any()
        moves = (velocity != 0.0).any(axis=1)
        assert (position[moves, 1] > 1.0).all()
        assert 0.9 < velocity[:, 0].max() <= 1.0
        assert not velocity[:, 1].any()


def test_reduced_runs_carry_the_mean_density_apart(lid):
    out = lid / "runs" / "lid"
    with trajectory(out / "rom-galerkin-reynolds100.h5") as run:
        coordinates, mean = (
            run.read("generalized_coordinates"),
            run.read("mean_density_fluctuation"),
        )
        fluctuation = run.read("density_fluctuation")
    assert coordinates.shape == (12, 4)
    assert mean.shape == (12,)
    assert np.isfinite(mean).all()
    assert np.abs(mean).max() < 0.05 * np.abs(fluctuation).max()
    with trajectory(out / "fom-reynolds100.h5") as run:
        assert "mean_density_fluctuation" not in run
        assert "generalized_coordinates" not in run


def test_a_kept_gauge_is_in_the_modes(lid_copy, sphrom):
    keep = ("--set", "basis.mean_density=in-modes")
    for stage in ("pod", "fit-psi", "rom"):
        result = sphrom(stage, "lid.yaml", *keep, "--force", "--threads", 1)
        assert result.exit_code == 0, result.output
    with trajectory(lid_copy / "rom-galerkin-reynolds100.h5") as run:
        assert "mean_density_fluctuation" not in run


def test_tables_tell_walls_flow_and_local_bases(lid, errors_of, peaks):
    out = lid / "runs" / "lid"
    for model in ("galerkin", "local"):
        assert 0.0 < peaks(out, model)[0] < 2.5
    rows = [row for row in errors_of(out) if row["against"] == "full"]
    bests = {(r["compared"], r["parameters"], r["role"]) for r in rows if "best" in r["compared"]}
    assert bests == {
        ("best possible, low M=3", "reynolds=50", "trained"),
        ("best possible, low M=3", "reynolds=75", "predicted"),
        ("best possible, high M=3", "reynolds=100", "trained"),
        ("best possible, all M=4", "reynolds=100", "trained"),
        ("best possible, high M=3", "reynolds=150", "trained"),
    }
    roles = {r["parameters"]: r["role"] for r in rows if r["compared"] == "local"}
    assert roles == {
        "reynolds=50": "trained", "reynolds=75": "predicted", "reynolds=100": "trained",
        "reynolds=150": "trained",
    }  # fmt: skip
    figures = json.loads((out / "compare.json").read_text())
    near = {(row["compared"], row["parameters"]) for row in figures["walls"]}
    assert {("map", "reynolds=75"), ("local", "reynolds=75")} <= near
    assert all(row["velocity_near_walls_peak"] > 0.0 for row in figures["walls"])
    flows = {(row["run"], row["parameters"]) for row in figures["flow"]}
    assert ("full", "reynolds=50") in flows
    assert ("galerkin", "reynolds=100") in flows
    assert "decay" not in figures
    tables = {path.stem for path in (out / "tables").glob("*.csv")}
    assert {"errors", "walls", "flow", "reference", "timings", "stages"} <= tables


def test_local_bases_are_those_of_the_intervals(lid_copy, sphrom, digests):
    """What `local` runs is, to the bit, what the basis by its name runs."""
    case = copy.deepcopy(CASE)
    case["rom"] = [
        {"name": name, "n_modes": 3, "basis": name, "parameters": values}
        for name, values in (("low", [50, 75]), ("high", [100, 150]))
    ]
    case["basis"]["n_modes"] = 4  # as before, so that the bases are the same
    Path("lid.yaml").write_text(yaml.safe_dump(case, sort_keys=False))
    for stage in ("pod", "fit-psi", "rom"):
        result = sphrom(stage, "lid.yaml", "--force", "--threads", 1)
        assert result.exit_code == 0, result.output
    found = digests(lid_copy)
    for name, values in (("low", (50, 75)), ("high", (100, 150))):
        for value in values:
            run = f"reynolds{value}.h5"
            assert found[f"rom-{name}-{run}"] == found[f"rom-local-{run}"]
    assert found["rom-low-reynolds75.h5"] != found["rom-high-reynolds100.h5"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            "parameters.test.reynolds=[160]",
            "rom.1.basis: reynolds=160 lies in the interval of no subset, so it has no local basis",
        ),
        (
            "basis.subsets.low.interval=[50, 120]",
            "rom.1.basis: reynolds=100 lies in the intervals of low and high, so it has no local "
            "basis",
        ),
        ("basis.subsets={}", "lies in the interval of no subset, so it has no local basis"),
    ],
)
@pytest.mark.parametrize("command", ["case check", "run"])
def test_a_value_without_one_local_basis(lid_only, sphrom, command, change, message):
    result = sphrom(*command.split(), "lid.yaml", "--set", change)
    assert result.exit_code == 2
    assert message in result.stderr
    assert not lid_only.exists()


def test_a_flow_that_is_not_steady_is_not_shown_against_steady_profiles(lid, lid_copy, sphrom):
    told = "reynolds=50, reynolds=100: the flow still changed over the last tenth of the run, by"
    first = (lid / "output.txt").read_text()
    again = sphrom("compare", "lid.yaml").stdout
    for text in (first, again):
        assert text.count(told) == 1
        assert "Legendre" not in text
    with (lid_copy / "tables" / "reference.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["settled"] for row in rows} == {"False"}
    assert {row["parameters"] for row in rows} == {"reynolds=50", "reynolds=100"}


@pytest.mark.parametrize("stage", ["fom", "map", "pod", "rom"])
def test_what_is_written_is_estimated_well(lid, stage):
    need = needs(load_case(lid / "lid.yaml"))[stage]
    paths = [p for pattern in need.files for p in (lid / "runs" / "lid").glob(pattern)]
    sizes = [path.stat().st_size - 20_000 for path in paths]  # what does not grow
    assert sum(max(0, size) for size in sizes) < 1.2 * need.disk + 20_000
    # Cells at walls, of which so small a box has many, have fewer points around them.
    assert need.disk < 1.4 * sum(sizes) + 30_000 * len(sizes)


def test_a_second_run_keeps_everything(lid_copy, sphrom, digests):
    before = digests(lid_copy)
    result = sphrom("run", "lid.yaml", "--threads", 1)
    assert result.exit_code == 0, result.output
    assert "wrote" not in result.stdout
    assert digests(lid_copy) == before


def test_check_tells_ghosts(lid_only, sphrom):
    result = sphrom("case", "check", "lid.yaml")
    assert (result.exit_code, result.stderr) == (0, "")
    assert "reynolds=75: 256 particles and 320 ghosts, 50 neighbours each" in result.stdout
    assert "4 full runs and 5 reduced runs: about " in result.stdout
    assert "spin up" not in result.stdout


@pytest.mark.parametrize(
    "changes",
    [
        ("discretization.walls.no_slip=paper", "discretization.walls.continuity=paper",
         "discretization.walls.layers=3", "discretization.viscosity=paper",
         "discretization.fixed_volume=false", "discretization.shifting.form=paper",
         "discretization.shifting.transport=paper", "reference.method=shepard",
         "basis.inner_product=raw", "basis.mean_density=in-modes", "psi.polynomial_degree=1",
         "rom.0.projection=apg", "rom.0.memory_length=1e-7", "rom.0.advection=paper"),
        ("discretization.walls.continuity=normal", "scene.lid=uniform", "basis.centred=true"),
        ("discretization.walls.layers=6", "reference.points=lattice", "basis.fields=separate"),
        ("reference.points=relaxed", "basis.lagrangian=true", "rom.0.projection=apg"),
    ],
    ids=["as printed", "normal", "layers", "relaxed"],
)  # fmt: skip
def test_options_run_through(lid_only, sphrom, errors_of, changes):
    short = ("time.final_time=0.06", "compare.from_time=0.02", "rom.0.n_modes=2")
    settings = [part for change in (*short, *changes) for part in ("--set", change)]
    model = ("--set", "rom.1.basis=all", "--set", "rom.1.n_modes=2")
    result = sphrom("run", "lid.yaml", *ALONE, *model, *settings)
    assert result.exit_code == 0, result.output
    rows = [row for row in errors_of(lid_only) if row["compared"] in ("galerkin", "local")]
    assert [row["status"] for row in rows] == ["complete"] * 2
    assert all(float(row["velocity_field_eq41_by_field_range_peak"]) < 20.0 for row in rows)


def test_full_runs_alone_under_a_uniform_lid(lid_only, sphrom):
    result = sphrom("run", "lid.yaml", *FULL_RUN, "--set", "scene.lid=uniform")
    assert result.exit_code == 0, result.output
    made = {path.name for path in lid_only.glob("*.h5")}
    assert made == {"fom-reynolds100.h5", "compare.h5"}
    tables = {path.stem for path in (lid_only / "tables").glob("*.csv")}
    assert tables == {"reference", "flow", "stages"}


@pytest.mark.parametrize("command", ["fom", "run"])
def test_a_particle_beyond_a_wall_ends_the_run(lid_only, sphrom, command):
    result = sphrom(command, "lid.yaml", *FULL_RUN, *LEAKING)
    assert result.exit_code == 4
    found = re.fullmatch(
        r"error: reynolds=100: unstable at step \d+, t = ([\d.]+) s: particle (\d+) at "
        r"\(([\d.]+), ([\d.]+)\) m, beyond a wall, has .*\n",
        result.stderr,
    )
    assert found, result.stderr
    time, particle, x, y = (float(text) for text in found.groups())
    assert 0.0 < time < 0.2
    assert particle == 240  # the first of the uppermost row
    assert 0.0 < x < 0.1
    assert 1.0 < y < 1.02
    with trajectory(lid_only / "fom-reynolds100.h5") as run:
        assert run.text("status") == "unstable"
        assert ", beyond a wall, " in run.text("status_detail")
        assert run.read("time")[-1] <= time
        assert (run.read("position") <= 1.0).all()
    for stage in ("map", "compare"):
        refused = sphrom(stage, "lid.yaml", *FULL_RUN, *LEAKING)
        assert refused.exit_code == 3
        assert "fom-reynolds100.h5 is of a run that became unstable (unstable at" in refused.stderr


def test_what_fits_no_walls_is_refused(lid_only, sphrom):
    result = sphrom("run", "lid.yaml", "--set", "discretization.initial_particles=packed")
    assert result.exit_code == 2
    assert "has walls, which only a lattice fits" in result.stderr
    assert not lid_only.exists()


def test_walls_of_another_kind_are_another_case(lid_copy, sphrom):
    change = ("--set", "discretization.walls.continuity=normal")
    result = sphrom("run", "lid.yaml", *change)
    assert result.exit_code == 3
    assert "discretization.walls.continuity is adjoint there, normal here" in result.stderr
    assert "fom-reynolds50.h5 was made with another case" in result.stderr


def test_from_a_new_case_to_a_comparison(tmp_path, monkeypatch, sphrom, peaks):
    monkeypatch.chdir(tmp_path)
    assert sphrom("case", "new", "lid-driven-cavity", "--full", "-o", "mine.yaml").exit_code == 0
    settings = {
        "discretization.resolution": 16, "time.final_time": 0.1, "snapshots.every": 1,
        "compare.plots": "false", "parameters.train.reynolds": "[100]",
        "parameters.test.reynolds": "[]", "compare.from_time": 0.05,
    }  # fmt: skip
    small = [part for key, value in settings.items() for part in ("--set", f"{key}={value}")]
    for command in (("case", "check"), ("run",)):
        result = sphrom(*command, "mine.yaml", *small)
        assert result.exit_code == 0, result.output
    assert peaks(tmp_path / "runs" / "my-lid-driven-cavity", "apg-m5")[0] < 2.0
