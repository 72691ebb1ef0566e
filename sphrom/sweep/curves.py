"""The figure of a sweep along a line of parameter values: results over the first varying parameter.

Bands are estimated errors. Those of measurements are root mean squares over time of the error of
the history, which the error of the mean does not exceed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.case.models import Case
from sphrom.plots.panels import Curve, Panel, draw_grid, save
from sphrom.sweep.batches import MEASURED_ERRORS, RunRecord
from sphrom.sweep.statistics import COLUMNS
from sphrom.sweep.table import Cells, columns_of
from sphrom.text import exact

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CAPTION = (
    "Results of all runs over the varying parameter; mean, greatest and least value are those of "
    "each run over time. Bands are estimated errors. Around a mean, they are the root mean square "
    "of the error over time, which the error of the mean does not exceed."
)
STATISTICS = ("mean", "greatest", "least")
"""The statistics of a measurement that are shown."""
OF_OSCILLATIONS = ("frequency", "amplitude")
OF_FIELDS = ("kinetic_energy", "largest_speed")
"""The columns that are shown if a case has no measurements."""
ESTIMATES = {field: f"error_estimate_{field}" for field in ("velocity", "pressure")}
"""The columns of the estimated errors of fields, by their labels."""


def publish(case: Case, path: Path, records: Sequence[RunRecord], rows: Sequence[Cells]) -> None:
    """Draw the figure beside a sweep's artifact, or remove an old one if there is none to draw."""
    picture = path.with_suffix(".png")
    points = np.array([[*record.point.as_dict().values()] for record in records])
    varying = varying_parameter(points)
    if varying is None or case.compare.plots is False or not any(r.values for r in records):
        picture.unlink(missing_ok=True)
        return
    order = np.argsort(points[:, varying], kind="stable").tolist()
    ordered = [records[k] for k in order]
    curves = Curves(
        parameter=case.plan.parameter_names[varying],
        points=dict(zip(case.plan.parameter_names, points[order].T, strict=True)),
        units=columns_of(case, records),
        rows=[rows[k] for k in order],
        errors=_errors(case, ordered),
    )
    save(curves.draw(), picture)


def varying_parameter(points: Array) -> int | None:
    """Return the index of the first parameter that varies among points (n_points, n_parameters).

    Returns None if there is none, or if another parameter varies without rising or falling with it,
    because the results are then not a curve over one parameter.
    """
    varying = np.flatnonzero(np.ptp(points, axis=0) > 0.0)
    if not len(varying):
        return None
    first = int(varying[0])
    steps = np.diff(points[np.argsort(points[:, first])][:, varying], axis=0)
    monotonic = (steps > 0.0).all(axis=0) | (steps < 0.0).all(axis=0)
    return first if len(varying) == 1 or monotonic.all() else None


def _errors(case: Case, records: Sequence[RunRecord]) -> dict[str, Array]:
    """Return the estimated errors of measurements (n_runs,) in their units, by column."""
    path = MEASURED_ERRORS[0]
    columns = list(case.scene.columns)
    unknown = np.full(len(columns), np.nan)
    found = np.array([record.values.get(path, unknown) for record in records])
    return {f"{name}_mean": found[:, k] for k, name in enumerate(columns)}


@dataclass(frozen=True)
class Curves:
    """The results of runs in the order of a varying parameter."""

    parameter: str
    points: Mapping[str, Array]
    """(n_runs,) values of all parameters, by name."""
    units: Mapping[str, str | None]
    """The units of the table's columns."""
    rows: Sequence[Cells]
    errors: Mapping[str, Array]
    """(n_runs,) estimated errors of columns in their units; they may be missing or NaN."""

    def draw(self) -> Figure:
        """Draw a panel for each result, and one for the estimated errors of the fields.

        The results are those of measurements; without any, kinetic energy and largest speed.
        """
        panels = [*self._measurements()] or [self._panel(name, {"": name}) for name in OF_FIELDS]
        if any(np.isfinite(self._column(name)).any() for name in ESTIMATES.values()):
            panels.append(self._panel("estimated errors of the fields", ESTIMATES))
        rows = [panels[k : k + COLUMNS] for k in range(0, len(panels), COLUMNS)]
        return draw_grid(rows, title=", ".join(self._other_parameters()))

    def _measurements(self) -> Iterator[Panel]:
        """Yield panels of measurements and oscillations that runs have."""
        for column in self.units:
            name, _, figure = column.rpartition("_")
            if figure == STATISTICS[0] and f"{name}_{STATISTICS[1]}" in self.units:
                yield self._panel(name, {s: f"{name}_{s}" for s in STATISTICS})
            elif figure in OF_OSCILLATIONS and not name.startswith("error_estimate"):
                yield self._panel(column, {figure: column})

    def _panel(self, title: str, columns: Mapping[str, str]) -> Panel:
        """Return a panel of columns with one unit, by their labels."""
        x = self.points[self.parameter]
        curves = []
        for label, name in columns.items():
            y = self._column(name)
            error = self.errors.get(name, self._column(f"error_estimate_{name}"))
            curves.append(Curve(label, x, y, interval=np.stack((y - error, y + error))))
        unit = self.units[next(iter(columns.values()))]
        return Panel(title.replace("_", " "), self.parameter, f"[{unit}]", curves)

    def _column(self, name: str) -> Array:
        """Return a column of the table (n_runs,), with NaN for missing figures."""
        cells = [row.get(name) for row in self.rows]
        return np.array([cell if isinstance(cell, float) else np.nan for cell in cells])

    def _other_parameters(self) -> Iterator[str]:
        """Yield the values of the other parameters in words."""
        for name, values in self.points.items():
            first, last = map(exact, values[[0, -1]].tolist())
            if name != self.parameter:
                yield f"{name} = {first}" if first == last else f"{name} from {first} to {last}"
