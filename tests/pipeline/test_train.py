"""Training chooses its full runs, tests what it promises, and goes on after a kill."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from sphrom.errors import UnstableError
from sphrom.models import fom

FAST = {"name": "fast", "evaluation": "operators", "n_modes": 8}
REGION = {"reynolds": [50, 400]}
PLACE = Path("runs/tiny")


@pytest.fixture
def case(case_text, tmp_path, monkeypatch):
    """Write `tiny.yaml`, with a region to train in, and work beside it."""
    monkeypatch.chdir(tmp_path)

    def write(training=REGION, **changes):
        changes = {"time__final_time": 0.2, **changes}
        text = case_text(rom=[FAST], parameters={"test": {"reynolds": [150]}}, **changes)
        lines = yaml.safe_dump({"training": training}, sort_keys=False)
        Path("tiny.yaml").write_text(f"{text}{lines}")
        return Path("tiny.yaml")

    return write


@pytest.fixture
def train(sphrom, case):
    """Train, in this process."""

    def run(*arguments, code=0):
        return sphrom("train", "tiny.yaml", "--workers", "1", *arguments, code=code)

    return run


def table(place=PLACE):
    with (place / "training" / "training.csv").open(newline="") as file:
        return [{k.partition(" ")[0]: v for k, v in row.items()} for row in csv.DictReader(file)]


def about(place=PLACE):
    return json.loads((place / "training" / "training.json").read_text())["about"]


def trained(place=PLACE):
    return [values["reynolds"] for values in about(place)["trained"]]


def uuids(place=PLACE):
    return {path.name: path.read_bytes() for path in place.glob("*.h5")}


def test_a_promise_is_tested_first_and_the_case_goes_on_with_the_same_artifacts(
    case, train, sphrom, digests
):
    case()
    result = train("--tolerance", "5%", "--budget", "6")
    assert about()["ending"] == "within"
    rows = table()
    assert float(rows[-1]["worst_estimate"]) <= 5.0
    held_out = [row for row in rows if row["velocity_error"]]
    assert held_out
    assert len(trained()) == 2 + len(held_out)
    for row in held_out:
        assert float(row["velocity_floor"]) <= float(row["velocity_error"]) * (1.0 + 1e-9)
        factor = max(1.0, float(row["velocity_error"]) / float(row["velocity_estimate"]))
        assert float(rows[-1]["factor"]) >= factor * (1.0 - 1e-12)
    assert "velocity within 5 % everywhere with" in result.stdout
    worst = max(float(row["pressure_error"]) for row in held_out)
    assert "pressure has no tolerance: worst estimate" in result.stdout
    assert f"errors of up to {worst:.3g} %, estimated as" in result.stdout
    written = yaml.safe_load((PLACE / "training" / "case.yaml").read_text())
    assert written["parameters"]["train"]["reynolds"] == trained()
    before = uuids()
    after = sphrom("run", PLACE / "training" / "case.yaml", "--out", PLACE, code=0)
    assert {name: uuids()[name] for name in before} == before
    assert "pod: all artifacts exist" in after.stdout
    assert {"pod.h5", "operators.h5", "rom-fast-reynolds150.h5"} <= digests(PLACE).keys()
    assert (PLACE / "training" / "training.png").stat().st_size > 10_000


def test_the_same_command_goes_on_and_makes_no_run_twice(case, train, monkeypatch):
    case()
    train("--budget", "3", "--tolerance", "0.06%")
    assert about()["ending"] == "budget"
    first, rows = trained(), table()
    made = []
    ensure = fom._run_point
    monkeypatch.setattr(
        fom, "_run_point", lambda w, p, *a: (made.append(p.reynolds), ensure(w, p, *a))
    )
    train("--budget", "3", "--tolerance", "0.06%")
    assert (trained(), table(), made) == (first, rows, [])
    again = train("--budget", "5", "--tolerance", "0.06%")
    assert "case.yaml --force, which makes pod.h5, psi.h5, operators.h5 again" in again.stdout
    assert trained()[: len(first)] == first
    assert sorted(made) == sorted(trained()[len(first) :])


@pytest.mark.slow
def test_what_a_kill_leaves_goes_on_to_the_same_bits(case, train, digests):
    case()
    options = ("--tolerance", "0.06%", "--budget", "5")
    train(*options, "--out", "whole")
    command = [sys.executable, "-m", "sphrom", "train", "tiny.yaml", "--workers", "1", *options]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    for n_runs in (1, 3):
        process = subprocess.Popen(
            command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        deadline = time.monotonic() + 600.0
        while process.poll() is None and time.monotonic() < deadline:
            if len(list(PLACE.glob("fom-*.h5"))) > n_runs:
                break
            time.sleep(0.02)
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=60)
    train(*options)
    assert table() == table(Path("whole"))
    assert digests(PLACE) == digests(Path("whole"))
    ends = [path / "training" / "case.yaml" for path in (PLACE, Path("whole"))]
    assert ends[0].read_bytes() == ends[1].read_bytes()


@pytest.mark.slow
def test_several_runs_at_once_are_apart_and_points_that_are_there_count(case, sphrom):
    case()
    sphrom("fom", "tiny.yaml", "--set", "parameters.train.reynolds=[50,400,120]", code=0)
    before = uuids()
    sphrom(
        "train", "tiny.yaml", "--workers", "2", "--budget", "6", "--tolerance", "0.06%",
        "--set", "parameters.train.reynolds=[120,300]", "--write-case", "chosen.yaml", code=0,
    )  # fmt: skip
    assert trained()[:3] == [50.0, 400.0, 120.0]
    assert {name: uuids()[name] for name in before} == before
    parameters = yaml.safe_load(Path("chosen.yaml").read_text())["parameters"]
    assert parameters["train"]["reynolds"] == trained()
    assert parameters["test"]["reynolds"] == [150]


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [(80.0, 250.0, "the model may miss the tolerance"), (0.0, 1e9, "a corner of the region")],
)
def test_a_full_run_that_becomes_unstable_is_left_out(case, train, monkeypatch, low, high, words):
    """But a corner of the region it has to be stable."""
    case()
    ensure = fom.ensure_run

    def sometimes(workspace, point):
        if low < point.reynolds < high:
            raise UnstableError(f"{point.label}: too fast")
        return ensure(workspace, point)

    monkeypatch.setattr(fom, "ensure_run", sometimes)
    result = train("--tolerance", "0.06%", "--budget", "4", code=4)
    assert words in result.output
    if low > 0.0:
        assert "left out, as its full run became unstable" in result.output
        assert all(not low < reynolds < high for reynolds in trained())
        assert any(row["failure"] for row in table())
        assert "nan" not in (PLACE / "training" / "training.csv").read_text().lower()


def test_a_tolerance_below_what_the_basis_can_reach_is_told(case, train):
    case()
    result = train("--tolerance", "0.0001%")
    assert about()["ending"] == "floor"
    assert len(trained()) == 2
    assert "further runs would not help" in result.output


@pytest.mark.slow
def test_two_parameters_and_both_fields(case, sphrom):
    region = {"reynolds": [50, 100], "lid": [0.5, 1.0], "quantity": "both"}
    case(region, scene__kind="lid-driven-cavity", time__final_time=0.2)
    text = Path("tiny.yaml").read_text().replace("reynolds:\n    - 150", "reynolds: []")
    Path("tiny.yaml").write_text(text)
    sphrom("train", "tiny.yaml", "--workers", "1", "--budget", "5", "--tolerance", "90%", code=0)
    assert about()["trained"][:4] == [
        {"reynolds": 50.0, "lid": 0.5},
        {"reynolds": 100.0, "lid": 1.0},
        {"reynolds": 50.0, "lid": 1.0},
        {"reynolds": 100.0, "lid": 0.5},
    ]
    assert len(about()["trained"]) == 5
    points = yaml.safe_load((PLACE / "training" / "case.yaml").read_text())["parameters"]["train"]
    assert points["points"] == about()["trained"]


@pytest.mark.parametrize(
    ("training", "arguments", "message"),
    [
        ({}, (), "the case has no region of parameters"),
        (REGION, ("--budget", "2"), "starts from 2 full runs"),
        (REGION, ("--tolerance", "0"), "--tolerance"),
        (REGION, ("--write-case", "nowhere/a.yaml"), "--write-case"),
        ({**REGION, "reynolds": [150, 400]}, (), "is a training value; test other"),
    ],
)
def test_what_can_not_be_done_is_told_before_anything_runs(
    case, train, training, arguments, message
):
    case(training)
    result = train(*arguments, code=2)
    assert message in result.output
    assert not list(PLACE.glob("*.h5"))


def test_a_flow_that_starts_from_a_file_is_trained_and_told_of_no_range(case, train, sphrom):
    Path("start.csv").write_text("x,y,u,v\n0,0,0.1,0\n1,0,0.1,0\n0,1,0.2,0\n1,1,0.2,0\n")
    box = {"upper": [1, 1], "periodic": ["x", "y"]}
    case(scene={"kind": "custom", "box": box, "initial": {"file": "start.csv"}})
    result = train("--tolerance", "50%", "--workers", "2", "--out", "made")
    assert "outside of the trained range" not in result.output
    again = sphrom("fom", "made/training/case.yaml", "--out", "made", "--only", "reynolds=50")
    assert "fom-reynolds50.h5: up to date, kept" in again.output
    assert "next: sphrom run made/training/case.yaml --out made" in result.output
