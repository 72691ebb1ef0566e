"""What a comparison shows on the terminal, from rows as they are stored in JSON."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.compare.references import ReferenceRow
from sphrom.compare.rows import error_row
from sphrom.compare.show import show
from sphrom.compare.tables import Tables
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


def _pair(cell: str) -> tuple[float, float]:
    """Return the mean and the peak of a cell."""
    mean, peak = cell.split(" / ")
    return float(mean), float(peak)


def test_relative_l2_leads_and_ranges_are_told_apart(case_of):
    probes = probes_of(case_of("taylor-green", compare={"grid": 10, "line_points": 10}))
    x, y = probes.all.T
    velocity, pressure = np.stack((x, y), axis=1)[None], (x * y + y)[None]
    full = Samples(np.array([1.0]), velocity, pressure)
    shifted = Samples(full.time, velocity, pressure + 0.1)
    history = compare(shifted, full, probes, 0.0)
    named = {"against": "full", "parameters": "reynolds=100", "role": "trained"}
    stable = error_row(history, compared="galerkin", **named)
    lost = error_row(history, compared="apg", status="unstable", **named)
    in_field = (stable.errors["velocity_field_relative_l2"],)
    assert stable.in_field == (*in_field, stable.errors["pressure_field_relative_l2"])
    assert lost.in_field is None
    (_, _, norms), (_, _, eq41) = _recorded(errors=[stable, lost]).tables
    assert norms[0][:4] == ("galerkin", "full", "reynolds=100", "trained")
    assert all(max(_pair(cell)) < 1e-10 for cell in norms[0][4:8])
    assert norms[0][8] == "–"  # it was not asked for
    assert norms[1][3:] == ("unstable", "–", "–", "–", "–", "–")
    on_line = full.pressure[0, probes.on_line]
    whole = full.pressure[0, : probes.on_grid.stop]
    for cell, over in zip(eq41[0][6:8], (on_line, whole), strict=True):
        expected = 100.0 * 0.1 / (over.max() - over.min())
        assert _pair(cell) == pytest.approx((expected, expected), rel=5e-3)
    assert eq41[1][3] == "unstable"


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
    assert recorder.lines == [
        "reynolds=100, reynolds=200: the flow still changed over the last tenth of the run, by up "
        "to 5.21 % of U or rho U^2: no steady profile is shown"
    ]
    alone = _recorded(reference=late)
    assert (alone.tables, len(alone.lines)) == ([], 1)
