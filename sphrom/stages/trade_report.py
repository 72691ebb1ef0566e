"""What `trade` shows: the table of models, CSV and JSON, the plot, and which model to take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import sphrom
from sphrom.case.models import Case
from sphrom.case.plan import recorded_time
from sphrom.report.canvas import save
from sphrom.report.tables import format_figure, write_csv, write_json
from sphrom.report.trade import Point, draw_trade
from sphrom.stages.trade_models import FOLDER
from sphrom.stages.trade_table import (
    QUANTITIES,
    Measure,
    ModelRow,
    RunRow,
    Tolerance,
    cheapest,
    most_accurate,
)
from sphrom.stages.workspace import Workspace

ON_FRONT = "*"
"""Marks an error that no model gives in less time."""


@dataclass(frozen=True)
class Recommendation:
    """The cheapest model within a tolerance; None where there is none."""

    velocity_tolerance: float
    pressure_tolerance: float
    judged_by: str
    model: str | None


def publish(
    workspace: Workspace,
    rows: Sequence[ModelRow],
    runs: Sequence[RunRow],
    measure: Measure,
    own_seconds: float,
    tolerance: Tolerance | None,
) -> None:
    """Write tables and the plot, and show the table and what it says."""
    report, folder = workspace.context.report, workspace.folder(FOLDER)
    write_csv(folder / "models.csv", rows)
    write_csv(folder / "runs.csv", runs)
    tables: dict[str, Sequence[Any]] = {"models": rows, "runs": runs}
    chosen = None if tolerance is None else cheapest(rows[1:], tolerance, measure)
    if tolerance is not None:
        name = None if chosen is None else chosen.model
        tables["recommendation"] = [
            Recommendation(tolerance.velocity, tolerance.pressure, measure.words, name)
        ]
    seconds = {"seconds": counted(workspace.case)}
    write_json(folder / "trade.json", tables, about(workspace) | seconds)
    save(draw_trade(_points(rows, measure), own_seconds, measure.words), folder / "trade.png")
    _show(workspace, rows, measure)
    _show_estimates(workspace, rows)
    if tolerance is not None:
        report.info(_recommendation(rows, chosen, tolerance, measure))
    report.info(f"tables, trade.json and trade.png are in {folder}")


def about(workspace: Workspace) -> dict[str, Any]:
    """Return what a JSON file says of where its tables come from."""
    return {
        "case": workspace.case.name,
        "software": f"sphrom {sphrom.__version__}",
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "threads": workspace.threads,
    }


def _points(rows: Sequence[ModelRow], measure: Measure) -> list[Point]:
    """Return what is drawn: the stable models but the one that the others are held against."""
    found = []
    for row in rows[1:]:
        errors = [measure.of(row, quantity) for quantity in QUANTITIES]
        if row.online_seconds is None or errors[0] is None or errors[1] is None:
            continue
        label = row.model.removeprefix(f"{row.family}, ")
        fronts = (row.velocity_front, row.pressure_front)
        found.append(Point(row.family, label, row.online_seconds, (errors[0], errors[1]), fronts))
    return found


def _show(workspace: Workspace, rows: Sequence[ModelRow], measure: Measure) -> None:
    where = "line" if measure.probes == "line" else "field"
    workspace.context.report.table(
        f"speed against accuracy: errors in % (Eq. 4.1, {where}, mean/peak over time); "
        f"{ON_FRONT} on the Pareto front of seconds and {measure.statistic} error; "
        f"{counted(workspace.case)}",
        (
            "model",
            "step [s]",
            "velocity",
            "pressure",
            "offline [s]",
            "online [s]",
            "speed-up",
            "over largest step",
            "break-even",
        ),
        [_cells(row, measure) for row in rows],
    )


def counted(case: Case) -> str:
    """Return which time the seconds of a run stand for, in words."""
    recorded = f"online is a run of {recorded_time(case):g} s"
    if case.time.spin_up == 0.0:
        return recorded
    return (
        f"{recorded}, full or reduced, from the end of a spin-up of {case.time.spin_up:g} s, which "
        "counts as offline where models learn and nowhere else"
    )


def _show_estimates(workspace: Workspace, rows: Sequence[ModelRow]) -> None:
    """Show what reduced models estimate their errors to be, where they do."""
    estimated = [row for row in rows if row.velocity_estimate is not None]
    if not estimated:
        return
    workspace.context.report.table(
        "estimated errors beside true ones: root mean squares over the grid and time, in % of the "
        "full run's",
        ("model", "velocity: estimate", "error", "pressure: estimate", "error"),
        [
            (
                row.model,
                format_figure(row.velocity_estimate),
                format_figure(row.velocity_rms_error),
                format_figure(row.pressure_estimate),
                format_figure(row.pressure_rms_error),
            )
            for row in estimated
        ],
    )


def _cells(row: ModelRow, measure: Measure) -> tuple[str, ...]:
    named = (row.model, format_figure(row.time_step))
    offline = format_figure(row.offline_seconds) if row.offline_seconds else ""
    if not row.stable:
        return (*named, "unstable", "", offline, "", "", "", "")
    return (
        *named,
        _pair(row, "velocity", measure) + (ON_FRONT if row.velocity_front else " "),
        _pair(row, "pressure", measure) + (ON_FRONT if row.pressure_front else " "),
        offline,
        format_figure(row.online_seconds),
        format_figure(row.speed_up),
        format_figure(row.speed_up_largest_step),
        "" if row.kind == "full" else _runs(row.break_even_runs),
    )


def _pair(row: ModelRow, quantity: str, measure: Measure) -> str:
    both = (Measure(measure.probes, statistic).of(row, quantity) for statistic in ("mean", "peak"))
    return " / ".join(format_figure(error) for error in both)


def _runs(number: int | None) -> str:
    if number is None:
        return "never"
    return "1 run" if number == 1 else f"{number} runs"


def _recommendation(
    rows: Sequence[ModelRow], chosen: ModelRow | None, tolerance: Tolerance, measure: Measure
) -> str:
    """Return in words which model to take, or how near models come to the tolerance."""
    if chosen is not None:
        errors = [format_figure(measure.of(chosen, quantity)) for quantity in QUANTITIES]
        return (
            f"within {tolerance.words} ({measure.words}), the cheapest is {chosen.model}: velocity "
            f"{errors[0]} %, pressure {errors[1]} %, {format_figure(chosen.online_seconds)} s a "
            f"run, {format_figure(chosen.speed_up)} times faster than the full run"
        )
    best = []
    for quantity in QUANTITIES:
        row = most_accurate(rows[1:], quantity, measure)
        if row is not None:
            error = format_figure(measure.of(row, quantity))
            best.append(f"{quantity} {error} % by {row.model}")
    nearest = f"; the best are {' and '.join(best)}" if best else ""
    return (
        f"no model is within {tolerance.words} ({measure.words}) but the case's own full run"
        f"{nearest}"
    )
