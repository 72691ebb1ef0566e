"""Estimates of the errors of runs on the reference points, without full runs for comparison.

The model's training runs are repeated, the estimate is fitted to their errors (see
`sphrom.reduction.error_calibration`) and then applied to any run. This takes about as long as the
runs, independently of the number of points, and the fit is the same for all parameters.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import ArtifactWriter, write_record
from sphrom.artifacts.records.runs import ErrorEstimate as StoredEstimate
from sphrom.artifacts.records.runs import OscillationEstimate
from sphrom.metrics.histories import QUANTITIES
from sphrom.metrics.measures import Quantities
from sphrom.models.estimates import ErrorEstimate, measured_over_time, report_measured
from sphrom.plots.tables import format_figure
from sphrom.reduction.error_calibration import field_of

if TYPE_CHECKING:
    from sphrom.models.points.fast_model import FastRun


@dataclass(frozen=True)
class SteadyErrors:
    """The estimated errors of a steady state."""

    residual: float
    """Norm of the residual of the rates [/s]."""
    errors: Array
    """(2,) root mean square errors of the velocity [m/s] and the pressure [Pa]."""
    relative: Array
    """(2,) errors of velocity and pressure, relative to the root mean squares of the fields."""
    distance: float
    """Distance from the nearest state between training runs, as `distance_from` measures it."""


def estimate_errors(run: FastRun, artifact: ArtifactWriter) -> None:
    """Estimate the errors of a run, write and report them, if the case has estimates."""
    report = run.model.workspace.context.report
    started = time.perf_counter()
    model = run.model.at_point(run.point)
    trained = model.errors
    fitted = model.fitted_errors(run.point)
    if trained is None:
        return
    estimated = run.estimate
    if fitted is None or estimated is None:
        artifact.write("residual", residual_of(run, run.time, run.coordinates))
        return
    assert estimated.residual is not None
    artifact.write("residual", estimated.residual)
    factors = [None, None]
    if fitted.factors is not None and not estimated.extrapolated:
        factors = fitted.factors.tolist()
    constants = (fitted.constants * trained.units).tolist()
    stored = StoredEstimate(
        velocity=estimated.velocity,
        pressure=estimated.pressure,
        change=fitted.changes(run.coordinates),
        decay_rate=fitted.decay_rate,
        training="outside" if estimated.extrapolated else "inside",
        velocity_constant=constants[0],
        pressure_constant=constants[1],
        velocity_factor=factors[0],
        pressure_factor=factors[1],
        measure=measured_over_time(run),
        oscillation={n: OscillationEstimate(**e) for n, e in run.oscillation_errors.items()},
    )
    write_record(artifact, stored, "error_estimate")
    artifact.annotate("timing/error_estimate", time.perf_counter() - started)
    report.info(_described(run, estimated, factors))
    report_measured(run)
    plan = run.model.workspace.case.plan
    for name, each in run.oscillation_errors.items():
        units = plan.oscillations[name].units_of
        listed = ", ".join(f"{f} {format_figure(error)} {units(f)}" for f, error in each.items())
        report.info(f"{run.name}: estimated errors of {name}: {listed}")


def estimate(run: FastRun) -> ErrorEstimate | None:
    """Estimate the errors of a run; None if the case has no estimates or none can be fitted.

    Runs of one model share the fits to its training runs.
    """
    model = run.on_basis
    trained = model.errors
    fitted = model.fitted_errors(run.point)
    if trained is None or fitted is None:
        return None
    residual = residual_of(run, run.time, run.coordinates)
    errors = fitted.errors(run.time, residual, run.coordinates)
    sizes = trained.products.sizes(run.states)
    squares = np.mean(errors**2, axis=-2) / np.mean(sizes**2, axis=-2)
    velocity_percent, pressure_percent = np.moveaxis(100.0 * np.sqrt(squares), -1, 0).tolist()
    velocity, pressure = np.moveaxis(errors * trained.units, -1, 0)
    return ErrorEstimate(
        velocity=velocity,
        pressure=pressure,
        velocity_percent=velocity_percent,
        pressure_percent=pressure_percent,
        extrapolated=fitted.extrapolates(len(run.time)).tolist(),
        residual=residual,
        errors=errors,
        sizes=sizes,
    )


def measured_errors(run: FastRun) -> dict[str, Quantities]:
    """Estimate the errors of all measurements of a run (n_snapshots, ...).

    Empty if the run has no estimates.
    """
    model = run.on_basis
    estimated = run.estimate
    if estimated is None:
        return {}
    fields = estimated.velocity, estimated.pressure
    return {
        name: {q: each.at(fields[field_of(q)]) for q, each in quantities.items()}
        for name, quantities in model.output_errors.items()
    }


def residual_of(run: FastRun, times: Array, coordinates: Array) -> Array:
    """Return the norm (n_states,) [/s] of the residual of a run's model at coordinates."""
    model = run.on_basis
    assert model.errors is not None
    return model.residual(model.errors, run.point, run.reduced, times, coordinates)


def steady_errors(run: FastRun, state: Array) -> SteadyErrors | None:
    """Estimate the errors of a steady state (n_modes,) that was found from the end of a run.

    None if the run has no estimates.
    """
    model = run.model.at_point(run.point)
    trained = model.errors
    fitted = model.fitted_errors(run.point)
    if trained is None or fitted is None:
        return None
    residual = float(residual_of(run, run.time[-1:], state[None])[0])
    change = fitted.changes(run.coordinates)[-1]
    later = float(np.linalg.norm(state - run.coordinates[-1]))
    errors = fitted.steady_errors(residual, change, later)
    at_end = run.reduced.with_pressure(run.time[-1:], state[None])
    relative = errors / trained.products.sizes(at_end)[0]
    distance = distance_from(fitted.expected, state)
    return SteadyErrors(residual, errors * trained.units, relative, distance)


def distance_from(states: Array, state: Array) -> float:
    """Return the relative distance of a state (n_modes,) from the nearest of `states`."""
    nearest = float(np.linalg.norm(states - state, axis=1).min())
    size = float(np.linalg.norm(state))
    return nearest / size if size > 0.0 else float(nearest > 0.0)


def _described(run: FastRun, estimated: ErrorEstimate, factors: Sequence[float | None]) -> str:
    """Return an estimate in words, in % of the fields' root mean squares over the run."""
    at_end = 100.0 * estimated.errors[-1] / estimated.sizes[-1]
    parts = []
    means = estimated.velocity_percent, estimated.pressure_percent
    for name, mean, end, factor in zip(QUANTITIES, means, at_end, factors, strict=True):
        trust = "" if factor is None else f", within a factor of {factor:.2g} in training"
        parts.append(f"{name} {format_figure(mean)} % ({format_figure(end)} % at the end{trust})")
    outside = ("extrapolated", *run.outside) if estimated.extrapolated else ()
    return "; ".join((f"{run.name}: estimated errors: {', '.join(parts)}", *outside))
