"""Command `figures`: the figures that a case asks for by name, from what its runs left.

Nothing is run: fields come from the runs, lines and errors from the comparison, modes and singular
values from the bases.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.case.studies import Row, rows_of
from sphrom.case.study_sections import (
    FULL,
    ErrorFigure,
    FieldFigure,
    FigureSection,
    LineFigure,
    ModeFigure,
    SpectrumFigure,
)
from sphrom.compare.default_figures import LABELS, draw_spectrum, frame_of, line_panels, mode_fields
from sphrom.compare.results import StoredComparison
from sphrom.errors import ArtifactError
from sphrom.metrics.samples import Samples
from sphrom.online.rebuilt_run import RebuiltRun
from sphrom.plots.canvas import save
from sphrom.plots.panels import Curve, Field, Panel, draw_grid
from sphrom.reduction.trial_basis import TrialBasis, truncate
from sphrom.setup.context import StageContext
from sphrom.store.bases import read_basis, read_points
from sphrom.store.trained_operators import sized
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Model = ReducedModelSection | None

FOLDER = "figures"
"""Where the pictures are, beside the artifacts."""
OVER = {"line": "the line's range", "field": "the field's range"}


@dataclass(frozen=True)
class Snapshot:
    """The fields of a run at one instant, where they are known."""

    time: float
    """[s]"""
    last: bool
    """Whether the run became unstable before the instant that was asked for."""
    position: Array
    """(n_points, 2) [m]"""
    values: Mapping[str, Array]
    """(n_points,) `speed` [m/s] and `pressure` [Pa]."""


class StoredRuns:
    """The runs of a case, full and reduced, as their artifacts have them."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._case = workspace.case
        self._bases: dict[str, TrialBasis] = {}
        self._points: Array | None = None

    def snapshot(
        self, model: ReducedModelSection | None, point: ParameterPoint, time: float
    ) -> Snapshot | None:
        """Return the fields of a run, None for the full one, nearest to an instant [s].

        None where the run became unstable before it began.
        """
        if model is None:
            target = self._workspace.full_run(point)
        else:
            target = self._workspace.reduced_run(model, point)
        with self._workspace.open(target) as run:
            times = run.read("time")
            if not len(times):
                return None
            index = int(np.argmin(np.abs(times - time)))
            last = run.text("status") != "complete" and time > times[-1]
            if model is None or model.on_particles:
                position = run.dataset("position")[index]
                velocity = run.dataset("velocity")[index]
                pressure = run.dataset("pressure")[index]
            else:
                position = self._reference_points()
                velocity, pressure = self._rebuilt(model, point, run).fields(index)
        values = {"speed": np.hypot(*np.asarray(velocity).T), "pressure": np.asarray(pressure)}
        return Snapshot(float(times[index]), last, np.asarray(position), values)

    def _reference_points(self) -> Array:
        if self._points is None:
            self._points = read_points(self._workspace)
        return self._points

    def _rebuilt(
        self, model: ReducedModelSection, point: ParameterPoint, run: Artifact
    ) -> RebuiltRun:
        name = self._case.plan.basis_for(model, point)
        if name not in self._bases:
            self._bases[name] = read_basis(self._workspace, name)
        n_modes = sized(self._workspace, model, point).size
        return RebuiltRun(run, truncate(self._bases[name], n_modes), self._case.plan.sound_speed)


def run(context: StageContext) -> None:
    """Draw every figure that the case asks for into the folder `figures`.

    Raises ArtifactError where a run, a basis or the comparison that one shows is missing.
    """
    workspace, wanted = Workspace(context), context.case.compare.figures
    if not wanted:
        context.report.info("compare.figures asks for no figure")
        return
    runs, folder = StoredRuns(workspace), workspace.folder(FOLDER)
    with (
        StoredComparison.of(workspace) as comparison,
        context.report.progress("figures", len(wanted)) as advance,
    ):
        for figure in wanted:
            drawn = _draw(workspace, runs, comparison, figure)
            save(drawn, folder / f"{figure.name}.png")
            advance(1)
    context.report.info(f"{len(wanted)} figures are in {folder}")


def _draw(
    workspace: Workspace, runs: StoredRuns, comparison: StoredComparison, figure: FigureSection
) -> Figure:
    match figure:
        case FieldFigure():
            return _draw_fields(workspace.case, runs, figure)
        case LineFigure():
            return _draw_lines(workspace.case, comparison, figure)
        case ErrorFigure():
            return _draw_errors(workspace.case, comparison, figure)
        case SpectrumFigure():
            return draw_spectrum(workspace, figure.basis, figure.modes, with_shares=True)
        case ModeFigure():
            fields = mode_fields(workspace, figure.basis, figure.field, figure.modes)
            return draw_grid([*fields.values()][::-1], frame_of(workspace.case))


def _draw_fields(case: Case, runs: StoredRuns, figure: FieldFigure) -> Figure:
    """Return fields at an instant, one that has become unstable at its last."""
    rows, frame = rows_of(case, figure), frame_of(case)
    title = _titles(figure, rows)
    full: dict[ParameterPoint, Snapshot] = {}
    for point in dict.fromkeys(point for _, some in rows for point in some):
        if (found := runs.snapshot(None, point, figure.time)) is None:
            raise ArtifactError(f"{point.label}: the full run has no snapshot")
        full[point] = found
    panels = []
    for models, some in rows:
        row = []
        for quantity, point, model in product(figure.quantities, some, models):
            found = full[point] if model is None else runs.snapshot(model, point, figure.time)
            told, shown = title(point, model, quantity), found or full[point]
            values = shown.values[quantity]
            if found is None:
                told, values = f"{told}\nunstable at the start", np.full(len(values), np.nan)
            elif found.last:
                told += f"\nunstable, its last: t = {found.time:.3g} s"
            picture = frame.raster(shown.position).picture(values)
            row.append(Field(told, LABELS[quantity], picture))
        panels.append(row)
    scales = {}
    for quantity in figure.quantities:
        values = np.concatenate([found.values[quantity] for found in full.values()])
        scales[LABELS[quantity]] = (float(values.min()), float(values.max()))
    times = {f"{found.time:.4g}" for found in full.values()}
    alone = [FULL] if figure.runs == ((FULL,),) else []
    labels = alone + ([point.label for point in full] if len(full) == 1 else [])
    heading = ", ".join([*labels, f"t = {' and '.join(sorted(times))} s"])
    return draw_grid(panels, frame, scales=scales, title=heading)


def _titles(figure: FieldFigure, rows: list[Row]) -> Callable[[ParameterPoint, Model, str], str]:
    """Return the function that names panels: by all in which they differ."""
    several_points = len({point for _, points in rows for point in points}) > 1
    several_models = len({model and model.name for models, _ in rows for model in models}) > 1

    def title(point: ParameterPoint, model: Model, quantity: str) -> str:
        told = [FULL if model is None else model.name] if several_models else []
        told += [point.label] if several_points else []
        return ", ".join(told + ([quantity] if len(figure.quantities) > 1 else []))

    return title


def _draw_lines(case: Case, comparison: StoredComparison, figure: LineFigure) -> Figure:
    """Return profiles on the line at an instant: a row of panels for each value."""
    panels, where, time = [], np.empty((0, 2)), figure.time
    for models, points in rows_of(case, figure):
        for point in points:
            where, full = comparison.line(None, point)
            index = int(np.argmin(np.abs(full.time - figure.time)))
            time, exact = float(full.time[index]), None
            if (flow := case.plan.flow(point).exact) is not None:
                fields = flow.velocity(where, time), flow.pressure(where, time)
                exact = Samples(np.array([time]), fields[0][None], fields[1][None])
            lines = {m.name: comparison.line(m.name, point)[1] for m in models if m is not None}
            lines = {FULL: full, **lines}
            label, across = point.label, where[:, 1]
            panels.append(line_panels(label, across, lines, index, figure.quantities, exact))
    return draw_grid(panels, title=f"x = {where[0, 0]:.4g} m, t = {time:.4g} s")


def _draw_errors(case: Case, comparison: StoredComparison, figure: ErrorFigure) -> Figure:
    """Return errors over time by Eq. 4.1: a row of panels for each row of runs, all values in it.

    Errors begin where the recorded time does, whatever `compare.from_time` leaves out of means.
    """
    panels = []
    for models, points in rows_of(case, figure):
        row = []
        for quantity in figure.quantities:
            runs = [
                _history(comparison, model.name, point, quantity, figure.range, len(points) > 1)
                for model, point in product(models, points)
                if model is not None
            ]
            label = f"Eq. 4.1 by {OVER[figure.range]} [%]"
            row.append(Panel(quantity, "time [s]", label, runs, "from zero"))
        panels.append(row)
    return draw_grid(panels)


def _history(
    comparison: StoredComparison,
    name: str,
    point: ParameterPoint,
    quantity: str,
    over: str,
    several_points: bool,
) -> Curve:
    time, error = comparison.discrepancy(name, point, quantity, over)
    complete = comparison.is_complete(name, point)
    label = f"{name}, {point.label}" if several_points else name
    if not complete:
        label += f" (unstable after {time[-1]:.3g} s)" if len(time) else " (unstable)"
    return Curve(label, time, error, complete=complete)
