"""Runs of a sweep are read back as they were written, whatever became of those among them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sphrom.artifacts import Origin, create_artifact, open_artifact
from sphrom.case.points import ParameterPoint
from sphrom.sweep.batches import (
    COMPLETE,
    ERROR,
    FAILED,
    UNSTABLE,
    RunRecord,
    doubts_in_words,
    read_outcomes,
    read_points,
    read_records,
    write_records,
)
from sphrom.sweep.table import summary


def complete(reynolds: float, errors: tuple[float, float] | None) -> RunRecord:
    """Return a run of which every number is its own."""
    random = np.random.default_rng(int(reynolds))
    values = {
        "time": np.array([0.0, 0.1, 0.2]),
        "time_step": random.random(),
        "kinetic_energy": random.random(),
        "largest_speed": random.random(),
        "generalized_coordinates": random.random((3, 2)),
        "measure/there/velocity": random.random((3, 2)),
        "measure/there/pressure": random.random(3),
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


def written(path: Path, records: list[RunRecord]) -> Path:
    """Write records to a sweep's artifact."""
    origin = Origin("inputs", "name: x\n")
    with create_artifact(path, "sphrom/sweep", stage="sweep", origin=origin) as artifact:
        write_records(artifact, "fast", records)
    return path


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1), slice(3), slice(3, 4)])
def test_records_come_back_as_they_were(tmp_path, order: slice) -> None:
    path = written(tmp_path / "sweep-fast.h5", MIXED[order])
    with open_artifact(path, "sphrom/sweep", made_by="") as artifact:
        found, done = read_records(artifact), read_points(artifact)
        outcomes = read_outcomes(artifact)
    for one, given in zip(found, MIXED[order], strict=True):
        assert replace(one, values={}) == replace(given, values={})
        assert one.values.keys() == given.values.keys()
        for name, value in given.values.items():
            np.testing.assert_array_equal(one.values[name], value)
    assert done == [record.point for record in MIXED[order] if record.status != FAILED]
    assert [(run.point, run.status, run.reason) for run in outcomes] == [
        (run.point, run.status, run.reason) for run in found
    ]


def test_doubtful_runs_are_counted_with_one_of_them() -> None:
    assert doubts_in_words(MIXED) is None
    doubtful = replace(MIXED[1], reason="it is steep")
    runs = [*MIXED, doubtful, doubtful]
    assert doubts_in_words(runs) == "2 of 10 runs are doubtful, such as reynolds=110: it is steep"


def test_a_figure_has_its_extremes_where_they_are_and_its_mean() -> None:
    values = {100.0: 2.0, 200.0: 7.0, 300.0: 3.0, 400.0: None}
    records = [RunRecord(ParameterPoint(reynolds), 0) for reynolds in values]
    rows = [{"kinetic_energy": value} for value in values.values()]
    ((words, least, at_least, mean, greatest, at_greatest),) = summary(
        records, rows, {"kinetic_energy": "J/m"}
    )
    assert words == "kinetic energy [J/m] of 3 runs"
    assert (least, mean, greatest) == ("2.00", "4.00", "7.00")
    assert (at_least, at_greatest) == ("reynolds 100", "reynolds 200")
