"""What a comparison shows on the terminal, from rows as they are stored in JSON."""

from __future__ import annotations

import numpy as np

from sphrom.compare.comparison_tables import Tables, error_row, show
from sphrom.compare.references import ReferenceRow
from sphrom.metrics.histories import compare
from sphrom.metrics.samples import Samples
from sphrom.store.sampling import probes_of


class _Recorder:
    """A reporter that keeps its lines, and its tables: title, columns and rows."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.tables: list[tuple[str, tuple[str, ...], list[tuple[str, ...]]]] = []

    @property
    def details(self) -> _Recorder:
        return self

    def info(self, text) -> None:
        self.lines.append(text)

    def table(self, title, columns, rows) -> None:
        self.tables.append((title, tuple(columns), [tuple(r) for r in rows]))


def _recorded(**tables):
    recorder = _Recorder()
    show(recorder, Tables(**tables))
    for _, columns, lines in recorder.tables:
        assert all(len(line) == len(columns) for line in lines)
    return recorder


def test_rows_of_runs_that_ended_and_that_did_not(case_of):
    probes = probes_of(case_of("taylor-green", compare={"grid": 10, "line_points": 10}))
    x, y = probes.all.T
    velocity, pressure = np.stack((x, y), axis=1)[None], (x * y + y)[None]
    full = Samples(np.array([1.0]), velocity, pressure)
    history = compare(Samples(full.time, velocity, pressure + 0.1), full, probes, 0.0)
    named = {"against": "full", "parameters": "reynolds=100", "role": "trained"}
    stable = error_row(history, compared="galerkin", **named)
    lost = error_row(history, compared="apg", status="unstable", **named)
    assert lost.in_field is None
    ((_, _, shown),) = _recorded(errors=[stable, lost]).tables
    assert shown[0][:4] == ("galerkin", "full", "reynolds=100", "trained")
    assert all(float(part) < 1e-10 for cell in shown[0][4:8] for part in cell.split(" / "))
    assert shown[1][3:] == ("unstable", "–", "–", "–", "–", "–")


def _steady(parameters, last_change, settled):
    return ReferenceRow(
        parameters, "u along y", "steady", 8.0, 9.0, 2, None, 0.3, 0.1, 0.1, 0.1, last_change,
        settled, "Ghia",
    )  # fmt: skip


def test_a_flow_that_still_changes_is_not_shown_against_a_steady_one():
    start = ReferenceRow(
        "reynolds=100", "u along y", "transient", 1.0, 1.0, 1, 1.0, 0.01, None, 0.01, None, None,
        True, "LG",
    )  # fmt: skip
    late = [_steady("reynolds=100", 0.004, False), _steady("reynolds=200", 0.0521, False)]
    recorder = _recorded(reference=[*late, start])
    ((_, _, rows),) = recorder.tables
    assert [row[2] for row in rows] == ["transient"]
    (line,) = recorder.lines
    assert line.startswith("reynolds=100, reynolds=200: the flow still changed")
    assert "5.21 %" in line
