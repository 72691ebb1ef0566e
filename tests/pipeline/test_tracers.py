"""Particles that fast models carry along after a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from sphrom.artifacts import open_artifact
from sphrom.case.loader import load_case
from sphrom.setup.cost import needs

FAST: dict[str, Any] = {"evaluation": "operators", "n_modes": 3}
COMPARE = {"plots": False, "grid": 12, "line_points": 21}
VORTEX: dict[str, Any] = {
    "name": "vortex",
    "scene": {"kind": "taylor-green"},
    "discretization": {"resolution": 16, "smoothing_length_ratio": 2.0},
    "time": {"final_time": 0.2},
    "snapshots": {"every": 2},
    "parameters": {"train": {"reynolds": [100]}},
    "rom": [
        {"name": "fast", **FAST, "calibrated": False, "tracers": True},
        {"name": "bare", **FAST},
    ],
    "compare": COMPARE,
}
OPEN: dict[str, Any] = {
    "name": "open",
    "scene": {"kind": "open-cavity"},
    "discretization": {"resolution": 40},
    "time": {"spin_up": 0.02, "final_time": 0.03, "step": 5e-4},
    "snapshots": {"every": 2},
    "rom": [
        {"name": "fast", **FAST, "calibrated": False, "tracers": True},
    ],
    "compare": {**COMPARE, "grid": 24},
}


@pytest.fixture(scope="module")
def made(tmp_path_factory, sphrom):
    """Run a case once; gives the folder with `<name>.yaml`, `output.txt` and the artifacts."""
    folders: dict[str, Path] = {}

    def make(case: dict[str, Any]) -> Path:
        name = case["name"]
        if name not in folders:
            folder = folders[name] = tmp_path_factory.mktemp(name)
            path = folder / f"{name}.yaml"
            path.write_text(yaml.safe_dump(case, sort_keys=False))
            result = sphrom("run", path, "--out", folder, "--threads", 1)
            assert result.exit_code == 0, result.output
            (folder / "output.txt").write_text(result.stdout)
        return folders[name]

    return make


def opened(folder: Path, name: str, schema: str = "coordinates"):
    return open_artifact(next(folder.glob(f"{name}-*.h5")), f"sphrom/{schema}", made_by="")


@pytest.mark.parametrize("case", [VORTEX, OPEN], ids=lambda case: case["name"])
def test_tracers_go_where_the_full_run_s_particles_go(made, case):
    folder = made(case)
    domain = load_case(folder / f"{case['name']}.yaml").scene.domain
    with opened(folder, "rom-fast") as run, opened(folder, "fom", "trajectory") as full:
        found, exact = run.read("position"), full.read("position")
        assert run.number("timing/tracers") > 0.0
    assert found.shape == exact.shape
    np.testing.assert_allclose(found[0], domain.wrap(exact[0]), atol=1e-15)
    assert all(domain.contains(position).all() for position in found)

    def distance(left, right) -> float:
        apart = left - right
        for axis, length in enumerate(domain.lengths):
            if domain.periodic[axis]:
                apart[..., axis] -= length * np.round(apart[..., axis] / length)
        return float(np.median(np.linalg.norm(apart, axis=-1)))

    # Shifting moves particles apart from the flow, by much less than the flow moves them.
    assert distance(found[-1], exact[-1]) < 0.2 * distance(exact[-1], exact[0])


def test_tracers_are_kept_where_they_are_asked_for_alone(made):
    with opened(made(VORTEX), "rom-bare") as run:
        assert "position" not in run


@pytest.mark.parametrize("case", [VORTEX, OPEN], ids=lambda case: case["name"])
def test_what_is_written_is_estimated_well(made, case):
    folder = made(case)
    written = [path.stat().st_size - 25_000 for path in folder.glob("rom-*.h5")]
    needed = needs(load_case(folder / f"{case['name']}.yaml"))["rom"].disk
    assert sum(max(0, size) for size in written) < 1.2 * needed + 25_000
