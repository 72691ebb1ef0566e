"""Command `fit`: parameters of a fast model from measured histories; what it shows and writes."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import write_record
from sphrom.artifacts.records.fit import FittedHistory
from sphrom.case.fields import NAME_PATTERN
from sphrom.case.messages import show as quoted
from sphrom.case.studies import fast_model, fit_ranges, fit_values, percent
from sphrom.console import Reporter
from sphrom.errors import CaseError
from sphrom.fit.estimates import Estimate, Fit, box_of, fit
from sphrom.fit.measurements import read_measurements
from sphrom.online.fast_model import FastModel
from sphrom.plots.canvas import COLOURS, INK, label_axes, legend_below, new_figure, save, styled
from sphrom.plots.tables import format_figure, write_csv
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

UNITS = {"kinematic_viscosity": "m2/s", "reynolds": "-"}
"""Of estimates; others are as the case has them."""
SHOWN_DIGITS = 5
MOST_SHOWN = 12
"""Histories in the terminal, and in the figure."""
COLUMNS = 2
BAND = 0.3
"""How opaque intervals are."""


def run(
    context: StageContext,
    measurements: str | os.PathLike[str] | None = None,
    noise: str | float | None = None,
    name: str | None = None,
) -> None:
    """Estimate parameters, show them, and write them with tables and a figure.

    Parameters
    ----------
    measurements : a CSV file, see `sphrom.fit.measurements`.
    noise : standard deviation over each history's range, such as `1%`; None is the case's.
    name : of the files; None is that of the measurements.

    Raises
    ------
    CaseError
        When the measurements can't be read, or the case has no model or no parameter to fit.
    ArtifactError
        When the operators are missing, or there is another fit of this name.
    UnstableError
        When the model is unstable at all starts.
    """
    if measurements is None:
        raise CaseError("measurements: a fit needs some; give the name of a CSV file")
    workspace, case = Workspace(context), context.case
    model = fast_model(case, case.fit.model)
    if model is None:
        raise CaseError("fit.model: no reduced model has evaluation: operators; add one to rom")
    share = case.fit.noise if noise is None else percent(noise, "--noise")
    data = read_measurements(Path(measurements), case, case.plan.model_steps(model), share)
    name = name or Path(data.source).stem
    if not re.fullmatch(NAME_PATTERN, name):
        raise CaseError(f"{quoted(name)} is no name for files; give one with --name")
    target = workspace.fit(name, data.digest, share)
    must_make = workspace.must_make(target)
    workspace.require(workspace.operators())
    box = box_of(fit_ranges(case, model), fit_values(case))
    found = fit(FastModel(workspace, model), box, data)
    if must_make:
        with workspace.create(target) as artifact:
            write_record(artifact, found)
        write_csv(target.path.with_suffix(".csv"), found.estimates)
        draw(found, target.path.with_suffix(".png"))
    show(context.report, found)
    context.report.info(f"a table and a figure are in {target.path.with_suffix('')}.csv, .png")


def show(report: Reporter, fit: Fit) -> None:
    """Show the estimates, their correlation, the histories, and what is wrong with them."""
    report.table(
        f"fit of {fit.model} to {fit.measurements}: 95 % intervals and standard deviations, of "
        "which the noise and the model's errors are parts",
        ("parameter", "value", "from", "to", "deviation", "noise", "model", "[%]", ""),
        [_shown(each) for each in fit.estimates],
    )
    if len(fit.free) > 1:
        rows = [
            (name, *(f"{value:.3f}" for value in row))
            for name, row in zip(fit.free, fit.correlation, strict=True)
        ]
        report.table("correlation", ("", *fit.free), rows)
    shown = fit.histories[:MOST_SHOWN]
    report.table(
        f"histories, {len(shown)} of {len(fit.histories)}",
        ("history", "units", "values", "noise", "residual over noise"),
        [
            (h.name, h.units, str(len(h.fitted)), *map(format_figure, (h.noise.mean(), h.residual)))
            for h in shown
        ],
    )
    dof = fit.degrees_of_freedom
    report.info(
        f"chi^2 per degree of freedom is {fit.chi_square / dof:.3g}; noise and the model's errors "
        f"explain up to {fit.expected_chi_square / dof:.3g}; {fit.starts_led_here} of {fit.starts} "
        "starts led here"
    )
    for problem in fit.problems:
        report.warn(problem)


def _shown(estimate: Estimate) -> tuple[str, ...]:
    unit = UNITS.get(estimate.parameter, "")
    name = f"{estimate.parameter} [{unit}]" if unit else estimate.parameter
    values = (estimate.value, estimate.low, estimate.high)
    parts = (estimate.standard_deviation, estimate.by_noise, estimate.by_model)
    share = 100.0 * estimate.standard_deviation / abs(estimate.value) if estimate.value else None
    return (
        name,
        *(format_figure(value, SHOWN_DIGITS) for value in values),
        *(format_figure(part, 2) for part in parts),
        format_figure(share, 2),
        estimate.remark,
    )


def draw(fit: Fit, path: Path) -> None:
    """Draw data, fit and intervals of every history."""
    # One below the other: a figure of one history is narrow.
    found = [
        f"{each.parameter} {format_figure(each.value, 4)} "
        f"({format_figure(each.low, 4)} to {format_figure(each.high, 4)})"
        for each in fit.estimates
    ]
    title = "\n".join((f"{fit.model} fitted to {fit.measurements}, 95 % intervals", *found))
    save(draw_fit(fit.histories, fit.time, title=title), path)


def draw_fit(histories: Sequence[FittedHistory], time: Array, *, title: str) -> Figure:
    """Return each measured history with the fitted one, and below it the residual over noise."""
    shown = histories[:MOST_SHOWN]
    columns = min(COLUMNS, len(shown))
    rows = math.ceil(len(shown) / columns)
    with styled():
        figure = new_figure(5.2 * columns + 0.8, 3.1 * rows + 1.2)
        grid = figure.subplots(
            2 * rows, columns, squeeze=False, sharex="col", height_ratios=[3.0, 1.0] * rows
        )
        pairs = [pair for row in range(rows) for pair in grid[2 * row : 2 * row + 2].T]
        for (upper, lower), each in zip(pairs, shown, strict=False):
            _draw_history(upper, lower, time, each)
        for axes in np.ravel(pairs[len(shown) :]):
            axes.set_visible(False)
        left_out = len(histories) - len(shown)
        more = f"\n{left_out} more histories are not shown" if left_out else ""
        figure.suptitle(title + more, fontsize=9.5)
        legend_below(figure, grid[0, 0])
        return figure


def _draw_history(upper: Axes, lower: Axes, time: Array, each: FittedHistory) -> None:
    upper.errorbar(
        each.instant, each.measured, each.noise, fmt="o", color=COLOURS[1], markersize=3.0,
        linewidth=0.8, label="measured, with the noise's standard deviation",
    )  # fmt: skip
    low, high = each.curve - each.half_width, each.curve + each.half_width
    upper.fill_between(
        time, low, high, color=COLOURS[0], alpha=BAND, linewidth=0.0, label="95 % interval"
    )
    upper.plot(time, each.curve, color=INK, linewidth=1.2, label="fitted model")
    label_axes(upper, "", f"{each.name} [{each.units}]")
    left = (each.measured - each.fitted) / each.noise
    lower.plot(each.instant, left, "o", color=COLOURS[1], markersize=2.5)
    lower.axhspan(-2.0, 2.0, color="#eeeeee", zorder=0)
    lower.axhline(0.0, color=INK, linewidth=0.8)
    label_axes(lower, "time [s]", "residual\nover noise")
