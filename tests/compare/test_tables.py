"""What a comparison shows on the terminal, from rows as they are stored in JSON."""

from __future__ import annotations

from unittest.mock import Mock

import numpy as np

from sphrom.compare.comparison_tables import Tables, error_row, show
from sphrom.compare.references import ReferenceRow
from sphrom.metrics.histories import compare
from sphrom.metrics.measures import Samples
from sphrom.store.stored_run import probes_of


def _shown(**tables):
    """Return the rows of the one table that is shown, and the lines beside it."""
    reporter = Mock()
    reporter.details = reporter
    show(reporter, Tables(**tables))
    _, columns, rows = reporter.table.call_args.args
    reporter.table.assert_called_once()
    assert all(len(row) == len(columns) for row in rows)
    return [tuple(row) for row in rows], [call.args[0] for call in reporter.info.call_args_list]


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
    shown, _ = _shown(errors=[stable, lost])
    assert shown[0][:4] == ("galerkin", "full", "reynolds=100", "trained")
    norms = *shown[0][4:6], *shown[0][8:]
    assert all(float(part) < 1e-10 for cell in norms for part in cell.split(" / "))
    assert shown[1][3:] == ("unstable", *("–",) * 6)


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
    rows, (line,) = _shown(reference=[*late, start])
    assert [row[2] for row in rows] == ["transient"]
    assert line.startswith("reynolds=100, reynolds=200: the flow still changed")
    assert "5.21 %" in line
