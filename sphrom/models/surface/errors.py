"""Errors of models with a free surface in full runs, and estimates of them without.

Each training run is left out in turn: a basis and a model are made from the others, and predict it.
`sphrom.reduction.surface_errors` estimates the errors of other runs from these, and from those of
the repeated training runs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array, Mask
from sphrom.case.points import ParameterPoint
from sphrom.metrics.histories import without_mean
from sphrom.metrics.measures import (
    Measured,
    Quantities,
    Samples,
    combined,
    items,
    with_coefficients,
    without_weight,
)
from sphrom.models.estimates import ErrorEstimate
from sphrom.models.stored_run import StoredRun
from sphrom.reduction.surface_errors import RunErrors, RunMeasure, SurfaceErrors
from sphrom.setup.assembly import scaled_parameters
from sphrom.store.stored_run import probes_of
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from sphrom.models.surface.model import SurfaceModel, SurfaceRun

FullRun = tuple[Samples, dict[str, Quantities]]
"""The fields of a full run on the grid of comparisons, and its measurements."""


def full_run(workspace: Workspace, point: ParameterPoint) -> FullRun:
    """Read a full run."""
    with StoredRun.opened(workspace, point) as run:
        samples = run.sampled(probes_of(workspace.case).grid)
        return samples, {name: run.measured(name) for name in workspace.case.scene.recorded}


def run_errors(runs: Sequence[SurfaceRun], full: dict[ParameterPoint, FullRun]) -> RunErrors | None:
    """Return the errors of runs at points with full runs; None if none was completed."""
    runs = [run for run in runs if run.failure is None]
    if not runs:
        return None
    case = runs[0].model.workspace.case
    fields = [field_errors(run, full[run.point][0]) for run in runs]
    measured = [combined(full[run.point][1], run.recorded, -1.0) for run in runs]
    return RunErrors(
        places=scaled_parameters(case, [run.point for run in runs]),
        amplitude=np.stack([run.amplitude for run in runs]),
        fields=np.stack([errors for errors, _ in fields]),
        sizes=np.stack([sizes for _, sizes in fields]),
        measure={
            name: RunMeasure(quantities={q: np.stack([m[name][q] for m in measured]) for q in each})
            for name, each in measured[0].items()
        },
    )


def field_errors(run: SurfaceRun, full: Samples) -> tuple[Array, Array]:
    """Return root mean squares (n_snapshots, 2) of errors and of a full run's fields [m/s, Pa].

    They are over the grid of comparisons, of the velocity, and of the pressure without the weight
    of fluid at rest and minus its mean.
    """
    workspace = run.model.workspace
    grid = probes_of(workspace.case).grid
    weight = workspace.case.plan.weight_at(run.point, grid)
    assert weight is not None
    own, reference = without_weight(run.sampled(grid), full, weight)
    pressures = without_mean(own.pressure), without_mean(reference.pressure)
    errors = _roots(own.velocity - reference.velocity, pressures[0] - pressures[1])
    return errors, _roots(reference.velocity, pressures[1])


def _roots(velocity: Array, pressure: Array) -> Array:
    squares = np.sum(velocity**2, axis=2), pressure**2
    return np.sqrt(np.stack([each.mean(axis=1) for each in squares], axis=1))


def compared(
    model: SurfaceModel,
    point: ParameterPoint,
    run: SurfaceRun | None,
    counted: Callable[[Array], Mask],
) -> tuple[Array, Array, Array, Callable[[], Measured]]:
    """Return sums of squares (2,) over times: of a run's errors, of the nearest states', of fields.

    The first are zero without a run. The last result returns the nearest states' measurements.
    """
    samples, _ = full_run(model.workspace, point)
    late = counted(samples.time)
    nearest = model.nearest(point)
    of_nearest, sizes = (np.sum(e[late] ** 2, axis=0) for e in field_errors(nearest, samples))
    errors = np.zeros(2)
    if run is not None:
        errors = np.sum(field_errors(run, samples)[0][late] ** 2, axis=0)
    return errors, of_nearest, sizes, lambda: items(nearest.measured, np.flatnonzero(late))


def estimate(run: SurfaceRun) -> ErrorEstimate | None:
    """Estimate the errors of a run; None without estimates, or if it ended early."""
    errors = run.model.errors
    if errors is None or run.failure is not None:
        return None
    over_amplitude = errors.at(_place(run))
    scale = errors.scale(run.amplitude)[:, None]
    found = scale * over_amplitude(lambda runs: runs.fields)
    repeated = SurfaceErrors(repeated=errors.repeated, held_out=errors.repeated)
    sizes = errors.waves(run.amplitude)[:, None] * repeated.at(_place(run))(lambda runs: runs.sizes)
    percents = 100.0 * np.sqrt(np.mean(found**2, axis=0) / np.mean(sizes**2, axis=0))
    case = run.model.workspace.case
    units = np.array([1.0, case.fluid.reference_density * case.plan.sound_speed])
    return ErrorEstimate(
        velocity=found[:, 0],
        pressure=found[:, 1],
        velocity_percent=float(percents[0]),
        pressure_percent=float(percents[1]),
        extrapolated=bool(run.outside),
        errors=found / units,
        sizes=sizes / units,
    )


def measured_errors(run: SurfaceRun) -> dict[str, Quantities]:
    """Estimate the errors of all measurements of a run; empty without estimates."""
    errors = run.model.errors
    if errors is None or run.estimate is None:
        return {}
    over_amplitude = errors.at(_place(run))
    scale = errors.scale(run.amplitude)

    def error_of(name: str, quantity: str) -> Array:
        share = over_amplitude(lambda runs: runs.measure[name].quantities[quantity])
        return np.asarray(np.multiply.outer(scale, share))

    known = errors.repeated.measure.items()
    found = {name: {q: error_of(name, q) for q in each.quantities} for name, each in known}
    return with_coefficients(found, run.model.workspace.case.plan.coefficients)


def _place(run: SurfaceRun) -> Array:
    return np.asarray(scaled_parameters(run.model.workspace.case, [run.point])[0])
