"""The estimated errors of a run, which models of several families have."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts.records.runs import MeasuredOnce
from sphrom.metrics.measures import ONLY_NOISE, Quantities
from sphrom.metrics.quantities import COEFFICIENT
from sphrom.plots.tables import format_figure

if TYPE_CHECKING:
    from sphrom.models.contract import ModelRun

Pair = tuple[float, float]
"""Mean squares of an error and of the quantity's change."""


@dataclass(frozen=True, kw_only=True)
class ErrorEstimate:
    """Estimated errors of a run.

    Root mean square errors at each snapshot (n_snapshots,) are `velocity` [m/s] and `pressure`, of
    the pressure minus its mean [Pa]. Over the whole run, and relative to the root mean squares of
    the fields, they are `velocity_percent` and `pressure_percent` [%]. `extrapolated` says whether
    the run is outside the trained parameters or times. `residual` is the norm of the residual of
    the rates (n_snapshots,) [/s], None with a free surface. `Model.run_many` also returns the
    estimated errors of measurements.
    """

    velocity: Array = field(repr=False)
    """(n_snapshots,) root mean square error of the velocity over the fluid [m/s]."""
    pressure: Array = field(repr=False)
    """(n_snapshots,) root mean square error of the pressure minus its mean [Pa]."""
    velocity_percent: float
    """Velocity error over the whole run, relative to the velocity's root mean square [%]."""
    pressure_percent: float
    """Error over the whole run of the pressure minus its mean, relative to its root mean square
    [%]."""
    extrapolated: bool
    """Whether the run is outside the trained parameters or times."""
    residual: Array | None = field(repr=False, default=None)
    """(n_snapshots,) norm of the residual of the rates [/s]; None with a free surface."""
    errors: Array = field(repr=False)
    """(n_snapshots, 2) root mean square errors of velocity and c0 rho'/rho0 [m/s]."""
    sizes: Array = field(repr=False)
    """(n_snapshots, 2) root mean squares of the fields themselves [m/s]."""


def measured_once(quantities: Quantities) -> MeasuredOnce:
    """Return measurements at one instant (1, ...) in the form of artifacts."""
    recorded = {q: v for q, v in quantities.items() if q != COEFFICIENT}
    return MeasuredOnce(
        arrays={q: values[0] for q, values in recorded.items() if values.ndim > 1},
        numbers={q: float(values[0]) for q, values in recorded.items() if values.ndim == 1},
    )


def measured_over_time(run: ModelRun) -> dict[str, MeasuredOnce]:
    """Return root mean squares over time of a run's estimated errors, by measurement."""
    counted_at = run.model.workspace.case.plan.counted
    return {
        name: measured_once(
            {q: np.sqrt(np.mean(e[counted] ** 2, axis=0))[None] for q, e in each.items()}
        )
        for name, each in run.measured_errors.items()
        if (counted := counted_at(name, run.time)).any()
    }


def report_measured(run: ModelRun) -> None:
    """Report the estimated errors of a run's measurements, if it has any."""
    if known := run.measured_shares:
        words = {n: ONLY_NOISE if v is None else f"{format_figure(v)} %" for n, v in known.items()}
        listed = ", ".join(f"{name} {share}" for name, share in words.items())
        report = run.model.workspace.context.report
        report.info(f"{run.name}: estimated errors of measurements, over their changes: {listed}")
