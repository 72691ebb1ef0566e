"""The results of `trade`: the table of models, CSV and JSON, the plot, and the model to take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sphrom.case.models import Case
from sphrom.metrics.histories import Errors
from sphrom.plots.canvas import plain_logarithmic, save
from sphrom.plots.panels import Curve, Panel, draw_grid
from sphrom.plots.tables import UNKNOWN, about, format_figure, write_csv, write_json
from sphrom.store.workspace import Workspace
from sphrom.text import counted
from sphrom.trade import advice as trade_advice
from sphrom.trade.advice import Tolerance
from sphrom.trade.models import FOLDER, N_TIMED_STEPS
from sphrom.trade.table import Alternative, Measure, ModelRow, RunRow, front_name

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIDE_MARGIN = 0.2
"""Beside models, for their names, over the axis."""
GAIN = 0.95
"""The largest error over that of the point named before, for a point to be named."""
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
    save(draw_trade(results), folder / "trade.png")
    _show(workspace, results)
    for line in conclusions:
        report.info(line)
    report.info(f"tables, trade.json and trade.png are in {folder}")


def _show(workspace: Workspace, results: Results) -> None:
    """Show all models."""
    measure, (own, *others) = results.measure, results.rows
    table = workspace.context.report.table
    quantities = [_words(quantity) for quantity in measure.quantities]
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


def timed_words(case: Case) -> str:
    """Return how the seconds of a run are measured, in words."""
    repeats = case.trade.repeats
    timed = "once" if repeats == 1 else f"{repeats} times"
    recorded = (
        f"online is a run of {case.plan.recorded_time:g} s, without reading and writing: of full "
        f"runs {N_TIMED_STEPS} steps from the start, timed {timed}, of reduced runs all, timed "
        f"{timed}, and the least counts"
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
    pays = "never" if row.break_even_runs is None else counted(row.break_even_runs, "run")
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


def _words(quantity: str) -> str:
    return quantity.replace("_", " ")


def draw_trade(results: Results) -> Figure:
    """Return errors against seconds of a run with their Pareto fronts, a panel for each quantity.

    It shows the stable models, but for the full run that they are compared with, and alternatives
    without a model. Named are the last point of a front and earlier ones that gain in accuracy.
    """
    quantities = results.measure.quantities
    panels = [_panel(results, quantity) for quantity in quantities]
    figure = draw_grid([panels], title=results.measure.words)
    for axes, quantity in zip(figure.axes, quantities, strict=True):
        axes.margins(x=SIDE_MARGIN, y=SIDE_MARGIN)
        plain_logarithmic(axes.yaxis, *axes.get_ylim())
        middle = float(np.sqrt(np.prod(axes.get_xlim())))
        least, front = float("inf"), _front(results, quantity)
        for place in front:
            if place[1] < GAIN * least or place == front[-1]:
                least, point = place[1], place[:2]
                side, way = ("right", -4) if point[0] > middle else ("left", 4)
                where: Any = {"textcoords": "offset points", "ha": side, "fontsize": 7.5}
                axes.annotate(place[2], point, (way, 4), **where)
    return figure


def _panel(results: Results, quantity: str) -> Panel:
    measure, places = results.measure, _places(results, quantity)
    curves = []
    for family in dict.fromkeys(row.family for *_, row in places):
        x, y = np.array([[s, e] for s, e, _, row in places if row.family == family]).T
        curves.append(Curve(family, x, y, "reference"))
    if front := _front(results, quantity):
        # Steps: no model between two of them is better than the slower one.
        x, y = np.array([place[:2] for place in front]).T
        curves.append(Curve("Pareto front", np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1], "level"))
    seconds = [s for s, *_ in places] + [results.own_seconds or 1.0]
    for each in results.without:
        error = np.full(2, measure.of(each.errors, quantity) or np.nan)
        curves.append(Curve(each.name, np.array([min(seconds), max(seconds)]), error, "level"))
    errors = [e for _, e, *_ in places]
    if results.own_seconds is not None and errors:
        ends = np.array([min(errors), max(errors)])
        curves.append(Curve("full run", np.full(2, results.own_seconds), ends, "full"))
    label = f"{_words(quantity)}, error [%]"
    return Panel("", "seconds of a run [s]", label, curves, "both logarithmic")


def _places(results: Results, quantity: str) -> list[tuple[float, float, str, ModelRow]]:
    """Return seconds, error and short name of the stable models whose error isn't zero."""
    return [
        (row.online_seconds, error, row.model.removeprefix(f"{row.family}, "), row)
        for row in results.rows[1:]
        if row.online_seconds is not None and (error := results.measure.of(row.errors, quantity))
    ]


def _front(results: Results, quantity: str) -> list[tuple[float, float, str]]:
    places = _places(results, quantity)
    return sorted(place[:3] for place in places if getattr(place[3], front_name(quantity)))
