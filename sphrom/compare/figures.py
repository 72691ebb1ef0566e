"""Command `figures`: draw the figures that a case lists, from its existing artifacts.

No models run: fields come from the runs, lines and errors from the comparison, modes and singular
values from the bases.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import place_of, rows_of
from sphrom.case.study_sections import (
    ErrorFigure,
    FieldFigure,
    FigureSection,
    LineFigure,
    ModeFigure,
    SpectrumFigure,
)
from sphrom.compare.basis_figures import draw_spectrum, mode_fields
from sphrom.compare.comparison_figures import LABELS, RunFigures, lettered
from sphrom.compare.stored_comparison import StoredComparison
from sphrom.models.stored_run import StoredRun
from sphrom.plots.panels import COLOURS, Curve, Field, Panel, draw_grid, save
from sphrom.setup.context import StageContext
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FOLDER = "figures"
"""Folder of the figures, beside the artifacts."""


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
        StoredComparison.of(workspace) as stored,
        context.report.progress("figures", len(wanted)) as advance,
    ):
        figures = _ListedFigures(stored)
        for figure in wanted:
            save(figures.draw(figure), folder / f"{figure.name}.png")
            advance(1)
    context.report.info(f"{len(wanted)} figures are in {folder}")


@dataclass(frozen=True)
class _Snapshot:
    """The fields of a run at one instant; none of a run that was unstable at the start."""

    run: str
    time: float = 0.0
    """[s]"""
    remark: str = "\nunstable at the start"
    """An addition to the title if the run became unstable earlier."""
    position: Array = field(default_factory=lambda: np.empty((0, 2)))
    """(n_points, n_dim) [m]."""
    values: Mapping[str, Array] = field(default_factory=dict)
    """`speed` [m/s] and `pressure` [Pa] (n_points,)."""


class _ListedFigures(RunFigures):
    """The figures that a case lists, by their kind."""

    def draw(self, figure: FigureSection) -> Figure:
        """Draw a figure."""
        workspace = self.workspace
        match figure:
            case FieldFigure():
                return self._fields(figure)
            case LineFigure():
                return self.lines(rows_of(self.case, figure), figure.time, figure.quantities)
            case ErrorFigure():
                return self._errors(figure)
            case SpectrumFigure():
                return draw_spectrum(workspace, figure.basis, figure.modes, with_shares=True)
            case ModeFigure():
                fields = mode_fields(workspace, figure.basis, figure.field, figure.modes)
                return draw_grid([*fields.values()][::-1], self.frame)

    def _snapshot(
        self, model: ReducedModelSection | None, point: ParameterPoint, time: float
    ) -> _Snapshot:
        """Return the fields of a run at the snapshot nearest to a time [s]."""
        with StoredRun.opened(self.workspace, point, model) as run:
            if not len(run.time):
                return _Snapshot(run.name)
            index = int(np.argmin(np.abs(run.time - time)))
            remark = ""
            if not run.is_complete and time > run.time[-1]:
                remark = f"\nunstable, last at t = {run.time[-1]:.3g} s"
            velocity, pressure = run.fields(index)
            values = {"speed": np.hypot.reduce(velocity, axis=1), "pressure": pressure}
            return _Snapshot(run.name, float(run.time[index]), remark, run.position(index), values)

    def _fields(self, figure: FieldFigure) -> Figure:
        """Draw fields at a time; those of unstable runs are at their last snapshot."""
        snapshot = cache(partial(self._snapshot, time=figure.time))
        rows = rows_of(self.case, figure)
        panels = [
            [
                self._field(figure.quantities, quantity, point, snapshot(model, point))
                for quantity, point, model in product(figure.quantities, points, models)
            ]
            for models, points in rows
        ]
        full = [snapshot(None, point) for _, points in rows for point in points]
        scales = {}
        for quantity in figure.quantities:
            values = np.concatenate([run.values[quantity] for run in full])
            scales[LABELS[quantity]] = (float(values.min()), float(values.max()))
        times = {f"{run.time:.4g}" for run in full}
        title = f"t = {' and '.join(sorted(times))} s"
        return draw_grid(panels, self.frame, scales=scales, title=title)

    def _field(
        self, quantities: Sequence[str], quantity: str, point: ParameterPoint, shown: _Snapshot
    ) -> Field:
        picture = np.full((1, 1), np.nan)
        if shown.values:
            picture = self.frame.raster(shown.position)(shown.values[quantity])
        title = lettered(
            quantities, quantity, f"{shown.run}\n{self.case.plan.title(point)}{shown.remark}"
        )
        return Field(title, LABELS[quantity], picture, complete=not shown.remark)

    def _errors(self, figure: ErrorFigure) -> Figure:
        """Draw errors of Eq. 4.1 over time, with a row of panels per row of runs.

        Errors are drawn from the start, also before `compare.from_time`. Axes are logarithmic,
        because errors of models of different sizes differ by orders of magnitude.
        """
        panels = []
        for models, points in rows_of(self.case, figure):
            row = []
            for quantity in figure.quantities:
                curves = []
                for model, (k, point) in product(filter(None, models), enumerate(points)):
                    name = model.name
                    time, error = self.stored.discrepancy(name, point, quantity, figure.range)
                    series = self.stored.errors(name, point)
                    label = f"{name}, {self.case.plan.title(point)}" if len(points) > 1 else name
                    if series is None or series.status != "complete":
                        after = f" after {time[-1]:.3g} s" if len(time) else ""
                        label += f" (unstable{after})"
                    place = place_of(self.case, name) + k * len(COLOURS)  # other dashes
                    curves.append(Curve(label, time, error, place=place))
                label = f"mean error over the {figure.range}'s range (Eq. 4.1) [%]"
                title = lettered(figure.quantities, quantity, quantity)
                row.append(Panel(title, "time [s]", label, curves, "logarithmic"))
            panels.append(row)
        return draw_grid(panels)
