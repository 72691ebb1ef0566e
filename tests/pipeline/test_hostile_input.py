"""Cases, arguments and files that no one means: each ends with the right code, in short lines."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

LONGEST = 600
"""Characters of a line."""
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
OUTLINED: dict[str, Any] = {
    "name": "outlined",
    "scene": {
        "kind": "custom",
        "box": {"lower": [0, 0], "upper": [6, 4], "periodic": ["x"]},
        "solids": {"part": {"file": "a.wkt"}},
    },
    "discretization": {"resolution": 60},
}
OWN: dict[str, Any] = {
    "name": "own",
    "scene": {
        "kind": "custom",
        "box": {"upper": [1, 1], "periodic": ["x"]},
        "body_force": [0.1, 0],
        "reference_length": 1.0,
    },
    "discretization": {"resolution": 20},
}
CASES = {"import": THEIRS, "fit": LID, "case": OUTLINED}
"""The case of a command."""
CHANGES = [
    "training.reynolds=[1e-300, 50]",
    "training.reynolds=[100, 50]",
    "fit.parameters={reynolds: 1e-300}",
    "fit.noise=1e300",
    "sweep.reynolds={low: 1e-300, high: 5, count: 3}",
    "parameters.train.reynolds=[1e-12]",
    "parameters.train={reynolds: [100], lid: [" + ",".join(map(str, range(1, 9000))) + "]}",
    "rom=[" + ",".join(f"{{name: m{i}}}" for i in range(101)) + "]",
    "rom." + "1" * 5000 + ".name=x",
    "rom.².name=x",
    "a." * 100_000 + "b=1",
    "time.final_time=" + "9" * 5000,
    "time.step=" + "[" * 5000,
]
EXPRESSIONS = [
    "(" * 400 + "x" + ")" * 400,
    "2**" * 300 + "2",
    "9**9**9",
    "f(a=" * 150 + "x" + ")" * 150,
    "\x00",
]
ARGUMENTS = [
    ("fom", "lid.yaml", "--out", ""),
    ("fom", ""),
    ("fom", "pipe"),
    ("fom", "lid.yaml", "--" + "x" * 5000),
    ("fom", "lid.yaml", "--only", "reynolds=" + "9" * 5000),
    ("sweep", "lid.yaml", "--shard", "1" * 5000 + "/2"),
    ("fit", "lid.yaml", "tiny_noise.csv"),
    ("fit", "lid.yaml", "huge.csv", "--noise", "1%"),
    ("fit", "lid.yaml", "pipe", "--noise", "1%"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Cases, measurements and a pipe that nobody reads."""
    found = tmp_path_factory.mktemp("hostile")
    (found / "lid.yaml").write_text(yaml.safe_dump(LID))
    (found / "own.yaml").write_text(yaml.safe_dump(OWN))
    tiny = "time,wake_pressure,wake_pressure_noise\n0.1,1,1e-300\n0.2,2,1\n"
    (found / "tiny_noise.csv").write_text(tiny)
    (found / "huge.csv").write_text("time,wake_pressure\n0.1,1e300\n0.2,2\n")
    os.mkfifo(found / "pipe")
    return found


def require_short_refusal(result: Any, *codes: int) -> None:
    assert result.exit_code in codes, result.output
    assert "Traceback" not in result.output
    lines = result.stderr.splitlines()
    assert lines
    assert max(map(len, lines)) < LONGEST


@pytest.mark.parametrize("change", CHANGES, ids=lambda text: text[:30])
def test_absurd_values_and_keys(sphrom, folder, monkeypatch, change) -> None:
    monkeypatch.chdir(folder)
    require_short_refusal(sphrom("case", "check", "lid.yaml", "--set", change), 2)


@pytest.mark.parametrize("text", EXPRESSIONS, ids=lambda text: text[:10])
def test_absurd_expressions(sphrom, folder, monkeypatch, text) -> None:
    monkeypatch.chdir(folder)
    case = {**OWN, "scene": {**OWN["scene"], "body_force": [text, 0]}}
    Path("absurd.yaml").write_text(yaml.safe_dump(case))
    require_short_refusal(sphrom("case", "check", "absurd.yaml"), 2)


@pytest.mark.parametrize("arguments", ARGUMENTS, ids=lambda given: " ".join(given)[:40])
def test_absurd_arguments(sphrom, folder, monkeypatch, arguments) -> None:
    monkeypatch.chdir(folder)
    require_short_refusal(sphrom(*arguments), 2, 3)
    assert not list(folder.glob("*.h5"))


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
    require_short_refusal(result, code)
    (line,) = result.stderr.splitlines()
    assert line.startswith("error: ")
