"""The results of `trade`: the table of models, CSV and JSON, the plot, and the model to take."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sphrom.case.models import Case
from sphrom.metrics.histories import Errors
from sphrom.plots.canvas import (
    INK,
    label_axes,
    legend_below,
    line_of,
    new_figure,
    plain_logarithmic,
    save,
    styled,
)
from sphrom.plots.tables import UNKNOWN, about, format_figure, write_csv, write_json
from sphrom.store.workspace import Workspace
from sphrom.trade import advice as trade_advice
from sphrom.trade.advice import Tolerance
from sphrom.trade.models import FOLDER, N_TIMED_STEPS
from sphrom.trade.table import ESTIMATES, Alternative, Measure, ModelRow, RunRow, front_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST_MARGIN = 1.3
"""Around errors on a logarithmic axis, as a factor."""
SIDE_MARGIN = 0.2
"""Beside models, for their names, over the axis."""
GAIN = 0.95
"""The largest error over that of the point named before, for a point to be named."""
FRONT: dict[str, Any] = {
    "color": "#777777",
    "linewidth": 4.0,
    "alpha": 0.35,
    "drawstyle": "steps-post",
    "label": "Pareto front (models filled)",
    "zorder": 1,
}
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
    """Show all models, and estimated beside true errors of those that estimate them."""
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


def _words(quantity: str) -> str:
    return quantity.replace("_", " ")


def draw_trade(results: Results) -> Figure:
    """Return errors against seconds of a run with their Pareto fronts, a panel for each quantity.

    It shows the stable models, but for the full run that they are compared with, and alternatives
    without a model.
    """
    measure, rows = results.measure, [row for row in results.rows[1:] if row.stable]
    groups, quantities = list(dict.fromkeys(row.family for row in rows)), measure.quantities
    with styled():
        figure = new_figure(5.5 * max(len(quantities), 1.3), 5.2)
        panels = figure.subplots(1, len(quantities), sharex=True, squeeze=False)[0]
        for axes, quantity in zip(panels, quantities, strict=True):
            # An error of zero, of a run that is the full one, has no place on a logarithmic axis.
            shown = [row for row in rows if measure.of(row.errors, quantity)]
            known = ((each.name, measure.of(each.errors, quantity)) for each in results.without)
            levels = {name: error for name, error in known if error}
            axes.set_xscale("log")
            if shown:
                _set_room(axes, [*_places(shown, measure, quantity)[1], *levels.values()])
            _draw_front(axes, shown, measure, quantity)
            for number, group in enumerate(groups):
                _draw_group(
                    axes, [r for r in shown if r.family == group], measure, quantity, number
                )
            if results.own_seconds is not None:
                look = {"color": INK, "linewidth": 1.0, "linestyle": ":"}
                axes.axvline(results.own_seconds, label="full run", **look)
            for (name, error), dashes in zip(levels.items(), ("--", "-."), strict=False):
                axes.axhline(error, color=INK, linewidth=0.9, linestyle=dashes, label=name)
            label_axes(axes, "seconds of a run [s]", f"{_words(quantity)}, {measure.words} [%]")
        legend_below(figure, panels[0])
        return figure


def _places(
    rows: Sequence[ModelRow], measure: Measure, quantity: str
) -> tuple[list[float], list[float]]:
    """Return the seconds and the errors of models."""
    errors = (measure.of(row.errors, quantity) for row in rows)
    return [row.online_seconds or 0.0 for row in rows], [error or 0.0 for error in errors]


def _set_room(axes: Axes, errors: Sequence[float]) -> None:
    """Set limits of logarithmic axes with room around errors, a decade at least."""
    low, high = min(errors), max(errors)
    margin = max(LEAST_MARGIN, (10.0 * low / high) ** 0.5)
    axes.set_yscale("log")
    axes.set_ylim(low / margin, high * margin)
    axes.margins(x=SIDE_MARGIN)
    plain_logarithmic(axes.yaxis, *axes.get_ylim())


def _draw_front(axes: Axes, rows: Sequence[ModelRow], measure: Measure, quantity: str) -> None:
    """Draw a front, and name its last point and earlier ones that gain in accuracy."""
    on_it = [row for row in rows if getattr(row, front_name(quantity))]
    names = [row.model.removeprefix(f"{row.family}, ") for row in on_it]
    front = sorted(zip(*_places(on_it, measure, quantity), names, strict=True))
    if not front:
        return
    axes.plot([seconds for seconds, *_ in front], [error for _, error, _ in front], **FRONT)
    least = float("inf")
    for seconds, error, name in front:
        if error < GAIN * least or (seconds, error, name) == front[-1]:
            least = error
            place: dict[str, Any] = {"xytext": (4, 4), "textcoords": "offset points"}
            axes.annotate(name, (seconds, error), fontsize=7.5, **place)


def _draw_group(
    axes: Axes, rows: Sequence[ModelRow], measure: Measure, quantity: str, number: int
) -> None:
    """Draw a marker for each model of a family, filled on the front."""
    line = line_of(number)
    for on_front in (False, True):
        drawn = [row for row in rows if getattr(row, front_name(quantity)) is on_front]
        axes.plot(
            *_places(drawn, measure, quantity),
            color=line.color,
            marker=line.marker,
            linestyle="none",
            markersize=5.5,
            markerfacecolor=line.color if on_front else "white",
            zorder=3 if on_front else 2,
            label=None if on_front or not rows else rows[0].family,
        )
