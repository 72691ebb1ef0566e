"""Cases and arguments that no one means: each ends with the right code, in short lines."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
import yaml

LONGEST = 600
"""Characters of a line."""
LID: dict[str, Any] = {
    "name": "lid",
    "scene": {"kind": "lid-driven-cavity", "measure": {"wake": {"probe": [0.5, 0.5]}}},
    "discretization": {"resolution": 10},
    "time": {"final_time": 0.5},
    "snapshots": {"every": 5},
    "parameters": {"train": {"reynolds": [50, 100]}},
    "rom": [{"name": "fast", "evaluation": "operators", "n_modes": 3}],
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
