"""Files of others that are huge, or hold numbers that nobody means, end in one short line."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

LONGEST = 500
"""Characters of a line about a fault."""
SECONDS = 60.0
"""After which a command hangs, on a busy machine too; most take less than one."""
THEIRS: dict[str, Any] = {
    "name": "theirs",
    "scene": {"kind": "taylor-green"},
    "discretization": {"resolution": 10, "smoothing_length_ratio": 2.0},
    "time": {"final_time": 0.1, "step": 2.5e-3},
    "snapshots": {"every": 20},
    "parameters": {"train": {"reynolds": [100]}},
}
LID: dict[str, Any] = {
    "name": "lid",
    "scene": {"kind": "lid-driven-cavity", "measure": {"wake": {"probe": [0.5, 0.8]}}},
    "discretization": {"resolution": 10},
    "time": {"final_time": 0.5},
    "snapshots": {"every": 5},
    "parameters": {"train": {"reynolds": [50, 200]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3, "integrated_modes": 3}],
}
OWN: dict[str, Any] = {
    "name": "own",
    "scene": {
        "kind": "custom",
        "box": {"lower": [0, 0], "upper": [6, 4], "periodic": ["x"]},
        "solids": {"part": {"file": "a.wkt"}},
    },
    "discretization": {"resolution": 60},
}
CASES = {"import": THEIRS, "fit": LID, "case": OWN}
"""The case of a command."""


def particles(**changed: object) -> Callable[[Path], None]:
    """Particles that fit the case, at one time."""
    x, y = np.meshgrid(*[(np.arange(10) + 0.5) / 10.0] * 2)
    one = np.ones(100)
    given = {"x": x.ravel(), "y": y.ravel(), "u": 0.0 * one, "v": 0.0 * one, "rho": one, "t": 0.0}
    return lambda path: np.savez(path, **given | changed)  # type: ignore[arg-type]


def huge(start: bytes = b"") -> Callable[[Path], None]:
    """A file of 100 GB that takes no space on disk."""

    def write(path: Path) -> None:
        with path.open("wb") as file:
            file.write(start)
            file.truncate(10**11)

    return write


def wkt(corners: np.ndarray) -> Callable[[Path], object]:
    inner = ",".join(f"{x!r} {y!r}" for x, y in np.vstack((corners, corners[:1])).tolist())
    return lambda path: path.write_text(f"POLYGON(({inner}))")


TURN = np.linspace(0.0, 2.0 * math.pi, 100_000, endpoint=False)
CIRCLE = np.stack((3.0 + np.cos(TURN), 2.0 + np.sin(TURN)), axis=1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "command", "name", "write"),
    [
        (3, "import case.yaml a.npz", "a.npz", particles(u=np.full(100, 1e308))),
        (2, "import case.yaml a.npz", "a.npz", particles(x=np.full(100, 1e99))),
        (2, "import case.yaml a.npz", "a.npz", particles(t=1e308)),
        (3, "import case.yaml a.vtp", "a.vtp", huge(b"<VTKFile")),
        (3, "import case.yaml a.npz", "a.npz", huge(b"PK\3\4")),
        (3, "import case.yaml a.h5", "a.h5", huge(b"\x89HDF\r\n\x1a\n")),
        (2, "case check case.yaml", "a.wkt", wkt(CIRCLE)),
        (2, "case check case.yaml", "a.wkt", wkt(np.random.default_rng(0).random((60_000, 2)))),
        (2, "case check case.yaml", "a.wkt", huge()),
        (2, "case check a.yaml", "a.yaml", huge(b"name: a\n")),
        (2, "fit case.yaml a.csv", "a.csv", lambda path: path.write_text("time," + "x" * 100_000)),
        (2, "fit case.yaml a.csv", "a.csv", huge(b"time,wake_velocity_x\n")),
    ],
)
def test_hostile_file_ends_quickly_in_one_short_line(
    sphrom, tmp_path, monkeypatch, code, command, name, write
) -> None:
    monkeypatch.chdir(tmp_path)
    write(Path(name))
    Path("case.yaml").write_text(yaml.safe_dump(CASES[command.split()[0]]))
    began = time.perf_counter()
    result = sphrom(*command.split())
    assert time.perf_counter() - began < SECONDS
    assert result.exit_code == code, result.output
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ")
    assert len(line) < LONGEST
