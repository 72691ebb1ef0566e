"""The results of `trade`: the table of models, CSV and JSON, the plot, and the model to take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sphrom.case.models import Case
from sphrom.metrics.histories import Errors
from sphrom.plots.canvas import save
from sphrom.plots.tables import UNKNOWN, about, format_figure, write_csv, write_json
from sphrom.plots.trade import Point, draw_trade
from sphrom.sph.time_loop import STEPS_IN_BLOCK
from sphrom.store.workspace import Workspace
from sphrom.trade import advice as trade_advice
from sphrom.trade.advice import Tolerance
from sphrom.trade.table import ESTIMATES, Alternative, Measure, ModelRow, RunRow, front_name

FOLDER = "trade"
"""Of a trade, below that of the case's artifacts."""
N_TIMED_STEPS = 10
"""Steps of the full model that are timed at once."""
ON_FRONT = "*"
"""Marks an error that no model gives in less time."""


@dataclass(frozen=True)
class Results:
    """The rows of a trade."""

    rows: Sequence[ModelRow]
    """The case's own full run first."""
    without: Sequence[Alternative]
    runs: Sequence[RunRow]
    measure: Measure
    own_seconds: float | None
    """Of the case's own full run [s]; None where nobody knows."""


def publish(workspace: Workspace, results: Results, tolerance: Tolerance | None) -> None:
    """Write tables and the plot, and show the table and its conclusions."""
    report, folder = workspace.context.report, workspace.folder(FOLDER)
    rows, without, measure = results.rows, results.without, results.measure
    tables: dict[str, Sequence[Any]] = {"models": rows, "runs": results.runs}
    tables["doing_nothing"] = without
    for name, each in tables.items():
        write_csv(folder / f"{name}.csv", each)
    conclusions = list(trade_advice.beaten(rows, without, measure))
    if tolerance is not None:
        advice = trade_advice.recommend(rows, without, tolerance, measure)
        tables["recommendation"] = [advice]
        conclusions.append(trade_advice.words(advice, rows, tolerance, measure))
    origin = about(workspace.case.name, workspace.threads)
    origin |= {"seconds": timed_words(workspace.case), "judged_by": measure.words}
    write_json(folder / "trade.json", tables, origin)
    _draw(results, folder / "trade.png")
    _show(workspace, results)
    for line in conclusions:
        report.info(line)
    report.info(f"tables, trade.json and trade.png are in {folder}")


def _draw(results: Results, path: Path) -> None:
    """Draw the stable models, but the full run that they are compared with, and no model at all."""
    measure, points = results.measure, []
    for row in results.rows[1:]:
        errors = measure.all_of(row.errors)
        if row.online_seconds is not None and errors is not None:
            label = row.model.removeprefix(f"{row.family}, ")
            fronts = tuple(getattr(row, front_name(q)) for q in measure.quantities)
            points.append(Point(row.family, label, row.online_seconds, errors, fronts))
    known = {other.name: measure.all_of(other.errors) for other in results.without}
    levels = {name: errors for name, errors in known.items() if errors is not None}
    quantities = [quantity.replace("_", " ") for quantity in measure.quantities]
    save(draw_trade(points, results.own_seconds, measure.words, levels, quantities), path)


def _show(workspace: Workspace, results: Results) -> None:
    """Show all models, and estimated beside true errors of those that estimate them."""
    measure, (own, *others) = results.measure, results.rows
    table = workspace.context.report.table
    quantities = [quantity.replace("_", " ") for quantity in measure.quantities]
    known = [
        (each.name, "", *_errors(each.errors, measure), "", "", "", "", "")
        for each in results.without
    ]
    table(
        f"speed against accuracy: relative L2 errors in % {measure.where}, over points and time / "
        f"at the worst instant, pressure less its mean; {ON_FRONT} on the Pareto front of seconds "
        f"and the first of these; "
        f"{timed_words(workspace.case)}",
        ("model", "step [s]", *quantities, "offline [s]", "online [s]", "speed-up",
         "over largest step", "break-even"),
        [_cells(own, measure), *known, *(_cells(row, measure) for row in others)],
    )  # fmt: skip
    estimated = [row for row in others if None not in row.estimates.values()]
    if estimated:
        table(
            "estimated errors beside true ones: root mean squares over the grid and time, in % of "
            "the full run's",
            ("model", "velocity: estimate", "error", "pressure: estimate", "error"),
            [
                (row.model, *(format_figure(row.estimates[name]) for name in ESTIMATES))
                for row in estimated
            ],
        )


def timed_words(case: Case) -> str:
    """Return how the seconds of a run are measured, in words."""
    repeats = case.trade.repeats
    timed = "once" if repeats == 1 else f"{repeats} times"
    recorded = (
        f"online is a run of {case.plan.recorded_time:g} s, without reading and writing: of full "
        f"runs {N_TIMED_STEPS} steps from the start, timed {timed}, of reduced runs with operators "
        f"all, timed {timed}, of others at their fastest {STEPS_IN_BLOCK} steps in a row or a "
        "short run again, and the least counts"
    )
    if case.time.spin_up == 0.0:
        return recorded
    return (
        f"{recorded}, full or reduced, from the end of a spin-up of {case.time.spin_up:g} s, which "
        "counts as offline where models learn and nowhere else"
    )


def _cells(row: ModelRow, measure: Measure) -> tuple[str, ...]:
    named = (row.model, format_figure(row.time_step))
    reduced = row.kind != "full"
    offline = _known(row.offline_seconds) if reduced else ""
    if not row.stable:
        blank = ("",) * (len(measure.quantities) - 1)
        return (*named, "unstable", *blank, offline, "", "", "", "")
    marks = [ON_FRONT if getattr(row, front_name(q)) else " " for q in measure.quantities]
    pays = "never" if row.break_even_runs is None else trade_advice.runs(row.break_even_runs)
    if row.offline_seconds is None or row.speed_up is None:
        pays = UNKNOWN
    gains = map(_known, (row.online_seconds, row.speed_up, row.speed_up_largest_step))
    errors = _errors(row.errors, measure, marks)
    return (*named, *errors, offline, *gains, pays if reduced else "")


def _errors(errors: Errors, measure: Measure, marks: Sequence[str] = (" ", " ")) -> Iterator[str]:
    """Yield the errors that count: overall / at worst, and a mark."""
    for quantity, mark in zip(measure.quantities, marks, strict=False):
        both = (measure.of(errors, quantity, peak=peak) for peak in (False, True))
        yield " / ".join(map(format_figure, both)) + mark


def _known(figure: float | None) -> str:
    return UNKNOWN if figure is None else format_figure(figure)
