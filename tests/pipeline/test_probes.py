"""Reduced runs that keep their fields where runs are compared, through the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from sphrom.artifacts import open_artifact
from sphrom.case.loader import load_case
from sphrom.store.sampling import probes_of

FAST: dict[str, Any] = {"evaluation": "operators", "n_modes": 3}
LID: dict[str, Any] = {
    "name": "lid",
    "scene": {"kind": "lid-driven-cavity"},
    "discretization": {"resolution": 16},
    "time": {"final_time": 0.5},
    "snapshots": {"every": 8},
    "rom": [
        {"name": "plain", **FAST},
        {"name": "probed", **FAST, "output": "probes"},
        {"name": "unseen", **FAST, "output": "probes", "parameters": [120]},
    ],
    "compare": {"plots": False, "grid": 12, "line_points": 21},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, sphrom) -> Path:
    folder = tmp_path_factory.mktemp("probes")
    (folder / "lid.yaml").write_text(yaml.safe_dump(LID))
    result = sphrom("run", folder / "lid.yaml", "--out", folder / "out")
    assert result.exit_code == 0, result.output
    return folder


def test_fields_are_kept_at_the_probes(folder: Path) -> None:
    probes = probes_of(load_case(folder / "lid.yaml"))
    path = folder / "out" / "rom-probed-reynolds100.h5"
    with open_artifact(path, "sphrom/coordinates", made_by="sphrom rom CASE") as run:
        assert np.array_equal(run.read("probes/position"), probes.all)
        velocity, pressure = run.read("probes/velocity"), run.read("probes/pressure")
        assert velocity.shape == (len(run.read("time")), len(probes.all), 2)
        assert pressure.shape == velocity.shape[:2]
        assert "velocity" not in run
    speed = np.linalg.norm(velocity[-1], axis=1)
    assert 0.5 < speed.max() < 1.1  # the lid's is one
    path = folder / "out" / "rom-plain-reynolds100.h5"
    with open_artifact(path, "sphrom/coordinates", made_by="sphrom rom CASE") as run:
        assert "probes/velocity" not in run


def test_the_comparison_takes_them(folder: Path) -> None:
    rows = json.loads((folder / "out" / "compare.json").read_text())["errors"]
    plain, probed = (
        [row for row in rows if row["compared"] == name] for name in ("plain", "probed")
    )
    assert len(plain) == len(probed) > 0
    for one, other in zip(plain, probed, strict=True):
        assert one | {"compared": ""} == other | {"compared": ""}


def test_they_are_kept_where_nothing_was_compared(folder: Path) -> None:
    path = folder / "out" / "rom-unseen-reynolds120.h5"
    with open_artifact(path, "sphrom/coordinates", made_by="sphrom rom CASE") as run:
        assert np.isfinite(run.read("probes/pressure")).all()


def test_other_probes_are_another_run_s(folder: Path, sphrom) -> None:
    """Runs that keep nothing there don't mind."""
    common = ("rom", folder / "lid.yaml", "--out", folder / "out", "--set", "compare.grid=10")
    refused = sphrom(*common)
    assert refused.exit_code == 3
    assert "rom-probed-reynolds100.h5" in refused.output
    assert "rom-plain" not in refused.stderr


def test_on_particles_there_are_none(folder: Path, sphrom) -> None:
    result = sphrom(
        "case", "check", folder / "lid.yaml", "--set", "rom=[{name: x, output: probes}]"
    )
    assert result.exit_code == 2
    assert "rom.0.output: is only for evaluation: operators" in result.output
