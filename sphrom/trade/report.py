"""What `trade` shows: the table of models, CSV and JSON, the plot, and which model to take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from sphrom.case.models import Case
from sphrom.case.plan import recorded_time
from sphrom.compare.error_rows import Errors
from sphrom.plots.canvas import save
from sphrom.plots.tables import UNKNOWN, format_figure, write_csv, write_json
from sphrom.plots.trade import Point, draw_trade
from sphrom.sph.time_loop import STEPS_IN_BLOCK
from sphrom.store.workspace import Workspace
from sphrom.trade import advice as trade_advice
from sphrom.trade import full as trade_full
from sphrom.trade.models import FOLDER
from sphrom.trade.nothing import NothingRow
from sphrom.trade.table import QUANTITIES, Measure, ModelRow, RunRow, Tolerance
from sphrom.version import __version__

ON_FRONT = "*"
"""Marks an error that no model gives in less time."""


@dataclass(frozen=True)
class Found:
    """All that a trade found."""

    rows: Sequence[ModelRow]
    """The case's own full run first."""
    nothing: Sequence[NothingRow]
    runs: Sequence[RunRow]
    measure: Measure
    own_seconds: float | None
    """What the case's own full run takes [s]; None where nobody knows."""


def publish(workspace: Workspace, found: Found, tolerance: Tolerance | None) -> None:
    """Write tables and the plot, and show the table and what it says."""
    report, folder = workspace.context.report, workspace.folder(FOLDER)
    rows, measure = found.rows, found.measure
    tables: dict[str, Sequence[Any]] = {
        "models": rows,
        "runs": found.runs,
        "doing_nothing": found.nothing,
    }
    for name, each in tables.items():
        write_csv(folder / f"{name}.csv", each)
    advice = None
    if tolerance is not None:
        advice = trade_advice.recommend(rows, found.nothing, tolerance, measure)
        tables["recommendation"] = [advice]
    seconds = {"seconds": counted(workspace.case), "judged_by": measure.words}
    write_json(folder / "trade.json", tables, about(workspace) | seconds)
    errors = {row.name: _errors(row, measure) for row in found.nothing}
    nothing = {name: each for name, each in errors.items() if each is not None}
    points = _points(rows, measure)
    save(draw_trade(points, found.own_seconds, measure.words, nothing), folder / "trade.png")
    _show(workspace, found)
    _show_estimates(workspace, rows)
    for line in trade_advice.beaten(rows, found.nothing, measure):
        report.info(line)
    if advice is not None and tolerance is not None:
        report.info(trade_advice.words(advice, rows, tolerance, measure))
    report.info(f"tables, trade.json and trade.png are in {folder}")


def about(workspace: Workspace) -> dict[str, Any]:
    """Return what a JSON file says of where its tables come from."""
    return {
        "case": workspace.case.name,
        "software": f"sphrom {__version__}",
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "threads": workspace.threads,
    }


def _points(rows: Sequence[ModelRow], measure: Measure) -> list[Point]:
    """Return what is drawn: the stable models but the one that the others are held against."""
    found = []
    for row in rows[1:]:
        errors = _errors(row, measure)
        if row.online_seconds is None or errors is None:
            continue
        label = row.model.removeprefix(f"{row.family}, ")
        fronts = (row.velocity_front, row.pressure_front)
        found.append(Point(row.family, label, row.online_seconds, errors, fronts))
    return found


def _errors(row: Errors, measure: Measure) -> tuple[float, float] | None:
    velocity, pressure = (measure.of(row, quantity) for quantity in QUANTITIES)
    return None if velocity is None or pressure is None else (velocity, pressure)


def _show(workspace: Workspace, found: Found) -> None:
    measure = found.measure
    where = "on the line" if measure.probes == "line" else "over the field"
    own, *others = found.rows
    workspace.context.report.table(
        f"speed against accuracy: relative L2 errors in % {where}, over points and time / at the "
        f"worst instant, pressure less its mean; {ON_FRONT} on the Pareto front of seconds and "
        f"the {'second' if measure.statistic == 'peak' else 'first'} of these; "
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
        [
            _cells(own, measure),
            *(_nothing_cells(row, measure) for row in found.nothing),
            *(_cells(row, measure) for row in others),
        ],
    )


def counted(case: Case) -> str:
    """Return which time the seconds of a run stand for, in words."""
    repeats = case.trade.repeats
    timed = "once" if repeats == 1 else f"{repeats} times"
    recorded = (
        f"online is a run of {recorded_time(case):g} s, without reading and writing: of full runs "
        f"{trade_full.N_TIMED_STEPS} steps from the start, timed {timed}, of reduced runs with "
        f"operators all, timed {timed}, of others at their fastest {STEPS_IN_BLOCK} steps in a row "
        "or a short run again, and the least counts"
    )
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
    offline = "" if row.kind == "full" else _known(row.offline_seconds)
    if not row.stable:
        return (*named, "unstable", "", offline, "", "", "", "")
    return (
        *named,
        _pair(row, "velocity", measure) + (ON_FRONT if row.velocity_front else " "),
        _pair(row, "pressure", measure) + (ON_FRONT if row.pressure_front else " "),
        offline,
        _known(row.online_seconds),
        _known(row.speed_up),
        _known(row.speed_up_largest_step),
        "" if row.kind == "full" else _break_even(row),
    )


def _nothing_cells(row: NothingRow, measure: Measure) -> tuple[str, ...]:
    pairs = (_pair(row, quantity, measure) + " " for quantity in QUANTITIES)
    return (row.name, "", *pairs, "", "", "", "", "")


def _known(figure: float | None) -> str:
    return UNKNOWN if figure is None else format_figure(figure)


def _pair(row: Errors, quantity: str, measure: Measure) -> str:
    each = (Measure(measure.probes, statistic) for statistic in ("overall", "peak"))
    both = (one.of(row, quantity) for one in each)
    return " / ".join(format_figure(error) for error in both)


def _break_even(row: ModelRow) -> str:
    if row.offline_seconds is None or row.speed_up is None:
        return UNKNOWN
    return "never" if row.break_even_runs is None else trade_advice.runs(row.break_even_runs)
