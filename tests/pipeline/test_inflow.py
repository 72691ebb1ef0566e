"""A full run whose flow leaves the strip with another flow rate than the case asks for."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import sphrom
from sphrom.errors import UnstableError

CASE = {
    "name": "weak",
    "scene": {
        "kind": "custom",
        "box": {"upper": [3, 1], "periodic": ["x"]},
        "inflow": {
            "strip": {"from": 0, "to": 2},
            "velocity": ["4*y*(1 - y)", 0],
            "strength": 15.0,
            "ramp": 0.4,
        },
        "reference_length": 1.0,
    },
    "discretization": {"resolution": 8},
    "time": {"final_time": 0.8},
    "parameters": {"train": {"reynolds": [20]}},
    "snapshots": {"every": 2},
    "compare": {"line": 2.5, "plots": False},
    "rom": [],
}


def test_a_run_that_misses_its_inflow(tmp_path: Path, capsys) -> None:
    """By 6 % it is told, and again in the answer; by 100 % it fails."""
    study = sphrom.Study(CASE, out=tmp_path / "near", threads=1, quiet=True)
    study.run_stage("fom")
    told = capsys.readouterr().err
    assert "warning: reynolds=20: target inflow 0.6719 m2/s, actual inflow" in told
    assert "The flow is not the one of the case: raise scene.inflow.strength" in told
    study.run_stage("compare")
    assert "Warning: reynolds=20: target inflow" in " ".join(capsys.readouterr().out.split())
    weak = {"scene.inflow.strength": 1e-6}
    study = sphrom.Study(CASE, set=weak, out=tmp_path / "far", threads=1, quiet=True)
    with pytest.raises(UnstableError, match=r"\(-100\.00 %\).* raise scene\.inflow\.strength"):
        study.run_stage("fom")


def test_a_run_whose_inflow_is_zero_has_no_target(tmp_path: Path) -> None:
    scene = {**CASE["scene"], "constants": {"U": 1.0}}  # type: ignore[dict-item]
    scene["inflow"] = {**scene["inflow"], "velocity": ["4*U*y*(1 - y)", 0]}
    train = {"parameters": {"train": {"reynolds": [20], "U": [0.0, 1.0]}}}
    study = sphrom.Study({**CASE, **train, "scene": scene}, out=tmp_path, threads=1, quiet=True)
    study.run_stage("fom", only=["reynolds=20,U=0"])


def test_the_target_of_an_oscillating_inflow_is_its_mean(tmp_path: Path, capsys) -> None:
    """The sum over eight rows is 1/128 above 2/3 m2/s; the oscillation has no mean."""
    inflow = {"scene.inflow.velocity": ["4*y*(1 - y)*(1 + 0.5*sin(10*pi*t))", 0]}
    study = sphrom.Study(CASE, set=inflow, out=tmp_path, threads=1)
    study.run_stage("fom")
    told = re.search(r"target\s+inflow\s+([\d.]+)", "".join(capsys.readouterr()))
    assert told is not None
    assert float(told[1]) == pytest.approx(0.671875, rel=0.01)
