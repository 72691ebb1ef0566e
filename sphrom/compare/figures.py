"""Command `figures`: draw the figures that a case lists, from its existing artifacts.

No models run: fields come from the runs, lines and errors from the comparison, modes and singular
values from the bases.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.case.studies import place_of, rows_of
from sphrom.case.study_sections import (
    FULL,
    ErrorFigure,
    FieldFigure,
    FigureSection,
    LineFigure,
    ModeFigure,
    SpectrumFigure,
)
from sphrom.compare.comparison_figures import (
    LABELS,
    draw_lines,
    draw_spectrum,
    frame_of,
    lettered,
    mode_fields,
)
from sphrom.compare.stored_comparison import StoredComparison
from sphrom.models.stored_run import StoredRun
from sphrom.plots.panels import COLOURS, Curve, Field, Panel, draw_grid, save
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER = "figures"
"""Folder of the figures, beside the artifacts."""

Snapshot = tuple[float, str, Array, dict[str, Array]]
"""Time [s], a remark for the title if the run became unstable earlier, points (n_points, 2) [m],
and their `speed` [m/s] and `pressure` [Pa], if there is a snapshot."""


def _snapshot(
    workspace: Workspace, model: ReducedModelSection | None, point: ParameterPoint, time: float
) -> Snapshot:
    """Return the fields of a run at the snapshot nearest to a time [s]."""
    with StoredRun.opened(workspace, point, model) as run:
        if not len(run.time):
            return 0.0, "\nunstable at the start", np.empty((0, 2)), {}
        index = int(np.argmin(np.abs(run.time - time)))
        remark = ""
        if not run.is_complete and time > run.time[-1]:
            remark = f"\nunstable, last at t = {run.time[-1]:.3g} s"
        velocity, pressure = run.fields(index)
        values = {"speed": np.hypot(*velocity.T), "pressure": pressure}
        return float(run.time[index]), remark, run.position(index), values


def run(context: StageContext) -> None:
    """Draw all figures that the case lists into the folder `figures`.

    Raises ArtifactError when a necessary run, basis or the comparison is missing.
    """
    workspace = Workspace(context)
    wanted = context.case.compare.figures
    if not wanted:
        context.report.info("compare.figures lists no figures")
        return
    folder = workspace.folder(FOLDER)
    with (
        StoredComparison.of(workspace) as comparison,
        context.report.progress("figures", len(wanted)) as advance,
    ):
        for figure in wanted:
            save(_draw(workspace, comparison, figure), folder / f"{figure.name}.png")
            advance(1)
    context.report.info(f"{len(wanted)} figures are in {folder}")


def _draw(workspace: Workspace, comparison: StoredComparison, figure: FigureSection) -> Figure:
    case = workspace.case
    match figure:
        case FieldFigure():
            return _draw_fields(workspace, figure)
        case LineFigure():
            rows = rows_of(case, figure)
            return draw_lines(case, comparison, rows, figure.time, figure.quantities)
        case ErrorFigure():
            return _draw_errors(case, comparison, figure)
        case SpectrumFigure():
            return draw_spectrum(workspace, figure.basis, figure.modes, with_shares=True)
        case ModeFigure():
            fields = mode_fields(workspace, figure.basis, figure.field, figure.modes)
            return draw_grid([*fields.values()][::-1], frame_of(case))


def _draw_fields(workspace: Workspace, figure: FieldFigure) -> Figure:
    """Draw fields at a time; those of unstable runs are at their last snapshot."""
    rows = rows_of(workspace.case, figure)
    frame = frame_of(workspace.case)
    points = dict.fromkeys(point for _, some in rows for point in some)
    full = {point: _snapshot(workspace, None, point, figure.time) for point in points}
    panels = []
    for models, some in rows:
        row = []
        for quantity, point, model in product(figure.quantities, some, models):
            run = full[point] if model is None else _snapshot(workspace, model, point, figure.time)
            _, unstable, position, fields = run
            title = f"{FULL if model is None else model.name}\n{point.label}{unstable}"
            picture = np.full((1, 1), np.nan)
            if fields:
                picture = frame.raster(position)(fields[quantity])
            title = lettered(figure.quantities, quantity, title)
            row.append(Field(title, LABELS[quantity], picture, complete=not unstable))
        panels.append(row)
    scales = {}
    for quantity in figure.quantities:
        values = np.concatenate([fields[quantity] for *_, fields in full.values()])
        scales[LABELS[quantity]] = (float(values.min()), float(values.max()))
    times = {f"{time:.4g}" for time, *_ in full.values()}
    title = f"t = {' and '.join(sorted(times))} s"
    return draw_grid(panels, frame, scales=scales, title=title)


def _draw_errors(case: Case, comparison: StoredComparison, figure: ErrorFigure) -> Figure:
    """Draw errors of Eq. 4.1 over time, with a row of panels per row of runs.

    Errors are drawn from the start, also before `compare.from_time`. Axes are logarithmic, because
    errors of models of different sizes differ by orders of magnitude.
    """
    panels = []
    for models, points in rows_of(case, figure):
        row = []
        for quantity in figure.quantities:
            runs = []
            for model, (k, point) in product(models, enumerate(points)):
                if model is not None:
                    time, error = comparison.discrepancy(model.name, point, quantity, figure.range)
                    series = comparison.errors(model.name, point)
                    label = f"{model.name}, {point.label}" if len(points) > 1 else model.name
                    if series is None or series.status != "complete":
                        after = f" after {time[-1]:.3g} s" if len(time) else ""
                        label += f" (unstable{after})"
                    look = place_of(case, model.name) + k * len(COLOURS)  # other dashes
                    runs.append(Curve(label, time, error, place=look))
            label = f"mean error over the {figure.range}'s range (Eq. 4.1) [%]"
            title = lettered(figure.quantities, quantity, quantity)
            row.append(Panel(title, "time [s]", label, runs, "logarithmic"))
        panels.append(row)
    return draw_grid(panels)
