"""Runs of a sweep are read back as they were written, whatever became of those among them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sphrom.artifacts import Origin, create_artifact, open_artifact
from sphrom.case.points import ParameterPoint
from sphrom.sweep.records import (
    COMPLETE,
    ERROR,
    FAILED,
    UNSTABLE,
    RunRecord,
    read_points,
    read_records,
    write_records,
)

PLACES = np.array([[0.25, 0.5], [0.75, 0.5]])


def complete(reynolds: float, errors: tuple[float, float] | None) -> RunRecord:
    """Return a run of which every number is its own."""
    random = np.random.default_rng(int(reynolds))
    values = {
        "time": np.array([0.0, 0.1, 0.2]),
        "time_step": random.random(),
        "kinetic_energy": random.random(),
        "largest_speed": random.random(),
        "generalized_coordinates": random.random((3, 2)),
        "probes/velocity": random.random((3, 2, 2)),
        "probes/pressure": random.random((3, 2)),
        "measure/drag/force": random.random((3, 2)),
        "derivatives": random.random(2),
    }
    if errors is not None:
        values |= {f"{ERROR}velocity": errors[0], f"{ERROR}pressure": errors[1]}
        values[f"{ERROR}extrapolated"] = int(reynolds > 130.0)
    return RunRecord(ParameterPoint(reynolds), COMPLETE, "", values, ("a_by_x", "a_by_y"))


def lost(reynolds: float, status: int) -> RunRecord:
    return RunRecord(ParameterPoint(reynolds), status, reason=f"no run at {reynolds}")


MIXED = [
    lost(100.0, UNSTABLE),
    complete(110.0, None),
    complete(120.0, (1.5, 15.0)),
    lost(130.0, FAILED),
    complete(140.0, (2.5, 25.0)),
    complete(150.0, None),
    lost(160.0, UNSTABLE),
    complete(170.0, (3.5, 35.0)),
]


@pytest.fixture
def write(tmp_path: Path) -> Callable[[list[RunRecord]], Path]:
    """Write records to a sweep's artifact."""

    def write(records: list[RunRecord]) -> Path:
        path = tmp_path / "sweep-fast.h5"
        origin = Origin("inputs", "name: x\n")
        with create_artifact(path, "sphrom/sweep", stage="sweep", origin=origin) as artifact:
            write_records(artifact, "fast", records, PLACES)
        return path

    return write


def same(found: RunRecord, given: RunRecord) -> bool:
    if replace(found, values={}) != replace(given, values={}):
        return False
    return found.values.keys() == given.values.keys() and all(
        np.array_equal(found.values[name], value) for name, value in given.values.items()
    )


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1), slice(3), slice(3, 4)])
def test_records_come_back_as_they_were(write, order: slice) -> None:
    path: Path = write(MIXED[order])
    with open_artifact(path, "sphrom/sweep", made_by="") as artifact:
        found = read_records(artifact)
    assert len(found) == len(MIXED[order])
    for one, given in zip(found, MIXED[order], strict=True):
        assert same(one, given), given.point


def test_points_by_how_their_runs_ended(write) -> None:
    with open_artifact(write(MIXED), "sphrom/sweep", made_by="") as artifact:
        done, failed = read_points(artifact), read_points(artifact, (FAILED,))
    assert [p.reynolds for p in done] == [100.0, 110.0, 120.0, 140.0, 150.0, 160.0, 170.0]
    assert [p.reynolds for p in failed] == [130.0]
