"""Figures of runs: their fields and lines at an instant, and their errors over time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.case.figures import FULL, ErrorFigure, FieldFigure, LineFigure, OfRuns
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.case.studies import Row, rows_of
from sphrom.compare.stored import Snapshot, StoredComparison, StoredRuns
from sphrom.errors import ArtifactError
from sphrom.plots.panels import Curve, Field, Panel, Scales, draw_curve_grid, draw_field_grid
from sphrom.plots.pictures import Frame
from sphrom.scenes.scene import ExactFlow
from sphrom.setup import assembly
from sphrom.setup.draw import solids_within

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Model = ReducedModelSection | None

LABELS = {"speed": "speed [m/s]", "pressure": "pressure [Pa]"}
OVER = {"line": "the line's range", "field": "the field's range"}


def frame_of(case: Case) -> Frame:
    """Return what of the plane the pictures of a case show."""
    box = assembly.domain(case)
    extent = (box.lower[0], box.upper[0], box.lower[1], box.upper[1])
    return Frame(extent, None if box.fills_box else solids_within(box, extent))


def _titles(
    case: Case, figure: OfRuns, rows: list[Row]
) -> Callable[[ParameterPoint, Model, str], str]:
    """Return what panels are called: by all in which they differ."""
    several_points = len({point for _, points in rows for point in points}) > 1
    several_models = len({model and model.name for models, _ in rows for model in models}) > 1
    several_quantities = len(figure.quantities) > 1

    def title(point: ParameterPoint, model: Model, quantity: str) -> str:
        told = [FULL if model is None else model.name] if several_models else []
        told += [point.label] if several_points else []
        return ", ".join(told + ([quantity] if several_quantities else []))

    return title


def draw_snapshots(case: Case, runs: StoredRuns, figure: FieldFigure) -> Figure:
    """Return fields at an instant, one that has become unstable at its last."""
    rows = rows_of(case, figure)
    title = _titles(case, figure, rows)
    points = dict.fromkeys(point for _, some in rows for point in some)
    full = {point: _full(runs, point, figure.time) for point in points}
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
            row.append(Field(told, LABELS[quantity], shown.position, values))
        panels.append(row)
    about = {
        LABELS[quantity]: _range([found.values[quantity] for found in full.values()])
        for quantity in figure.quantities
    }
    times = {f"{found.time:.4g}" for found in full.values()}
    alone = [FULL] if figure.runs == ((FULL,),) else []
    labels = alone + ([point.label for point in points] if len(points) == 1 else [])
    heading = ", ".join([*labels, f"t = {' and '.join(sorted(times))} s"])
    return draw_field_grid(frame_of(case), panels, scales=Scales(about), title=heading)


def _full(runs: StoredRuns, point: ParameterPoint, time: float) -> Snapshot:
    found = runs.snapshot(None, point, time)
    if found is None:
        raise ArtifactError(f"{point.label}: the full run has no snapshot")
    return found


def _range(fields: list[Array]) -> tuple[float, float]:
    return min(float(f.min()) for f in fields), max(float(f.max()) for f in fields)


def draw_lines(case: Case, comparison: StoredComparison, figure: LineFigure) -> Figure:
    """Return profiles on the line at an instant: a row of panels for each value."""
    panels, where, time = [], np.empty((0, 2)), figure.time
    for models, points in rows_of(case, figure):
        for point in points:
            where, full = comparison.line(None, point)
            index = int(np.argmin(np.abs(full.time - figure.time)))
            time, flow = float(full.time[index]), assembly.exact_flow(case, point)
            lines = {m.name: comparison.line(m.name, point)[1] for m in models if m is not None}
            row = []
            for quantity in figure.quantities:
                runs = [
                    _profile(name, where[:, 1], line.time, getattr(line, quantity), index)
                    for name, line in lines.items()
                ]
                full_line = Curve("full", where[:, 1], getattr(full, quantity)[index])
                exact = None if flow is None else _exact(flow, where, time, quantity)
                labels = point.label, "y [m]", LABELS[quantity]
                row.append(Panel(*labels, runs, full_line, exact))
            panels.append(row)
    return draw_curve_grid(panels, title=f"x = {where[0, 0]:.4g} m, t = {time:.4g} s")


def _profile(name: str, y: Array, times: Array, values: Array, index: int) -> Curve:
    """Return a run's profile, or none where it has become unstable before."""
    if index < len(times):
        return Curve(name, y, values[index])
    before = f"after {times[-1]:.3g} s" if len(times) else "at the start"
    return Curve(f"{name} (unstable {before})", np.empty(0), np.empty(0))


def _exact(flow: ExactFlow, where: Array, time: float, quantity: str) -> Curve:
    velocity, pressure = flow.velocity(where, time), flow.pressure(where, time)
    values = np.hypot(*velocity.T) if quantity == "speed" else pressure
    return Curve("exact", where[:, 1], values)


def draw_errors(case: Case, comparison: StoredComparison, figure: ErrorFigure) -> Figure:
    """Return errors over time by Eq. 4.1: a row of panels for each row of runs, all values in it.

    Errors begin where the recorded time does, whatever `compare.from_time` leaves out of means.
    """
    panels = []
    for models, points in rows_of(case, figure):
        row = []
        for quantity in figure.quantities:
            runs = [
                _history(case, comparison, model.name, point, quantity, figure.range, len(points))
                for model, point in product(models, points)
                if model is not None
            ]
            row.append(Panel(quantity, "time [s]", f"Eq. 4.1 by {OVER[figure.range]} [%]", runs))
        panels.append(row)
    return draw_curve_grid(panels, from_zero=True)


def _history(
    case: Case,
    comparison: StoredComparison,
    name: str,
    point: ParameterPoint,
    quantity: str,
    over: str,
    n_points: int,
) -> Curve:
    time, error = comparison.discrepancy(name, point, quantity, over)
    complete = comparison.is_complete(name, point)
    label = f"{name}, {point.label}" if n_points > 1 else name
    if not complete:
        label += f" (unstable after {time[-1]:.3g} s)" if len(time) else " (unstable)"
    return Curve(label, time, error, complete)
