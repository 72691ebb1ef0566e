"""Estimates of the errors of runs on the reference points, without a full run to compare with.

The model's training runs are repeated, the estimate is fitted to their errors (see
`sphrom.reduction.error_calibration`), and then applied to any run. All of it takes about as long as
the runs do, whatever the number of points is, and the fit is the same for all parameters.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter, read_record, write_record
from sphrom.artifacts.records.coordinates import ErrorEstimate
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.plots.tables import format_figure
from sphrom.reduction.error_calibration import (
    FIELDS,
    LocalCalibration,
    calibrate,
    compared_snapshots,
)
from sphrom.reduction.held_out import UnheldShares
from sphrom.reduction.reduced_operators import ResidualFactor, residual_norm
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.setup.assembly import places_of
from sphrom.store.trained_operators import read_operators

if TYPE_CHECKING:
    from sphrom.online.basis_model import BasisModel
    from sphrom.online.fast_model import FastRun

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Estimate:
    """The estimated errors of a run without a full run."""

    residual: Array
    """(n_snapshots,) its norm [/s]."""
    fitted: LocalCalibration | None
    """None where training runs have no errors, or all of them diverge."""
    errors: Array | None
    """(n_snapshots, 2) root mean squares of the errors of velocity and c0 rho'/rho0 [m/s]."""
    sizes: Array
    """(n_snapshots, 2) root mean squares of the fields themselves [m/s]."""
    extrapolates: bool
    """Whether the run is outside of the trained parameters and times."""
    units: Array
    """(2,) from errors in [m/s] to those of velocity [m/s] and pressure [Pa]."""

    @property
    def velocity_and_pressure(self) -> Array:
        """(n_snapshots, 2) the errors in [m/s] and [Pa]."""
        assert self.errors is not None
        return self.errors * self.units

    @property
    def percent(self) -> Array:
        """(2,) the errors over the fields' sizes, both root mean squares over the run [%]."""
        assert self.errors is not None
        squares = np.mean(self.errors**2, axis=0) / np.mean(self.sizes**2, axis=0)
        return np.asarray(100.0 * np.sqrt(squares))


@dataclass(frozen=True)
class SteadyErrors:
    """The estimated errors of a steady state."""

    residual: float
    """Norm of the part of the rates that the basis leaves out [/s]."""
    errors: Array
    """(2,) root mean squares of the velocity's [m/s] and the pressure's [Pa]."""
    relative: Array
    """(2,) the same over the fields' own root mean squares."""
    distance: float
    """From the nearest state between training runs, as `distance_from` measures it."""


def estimate_errors(run: FastRun, artifact: ArtifactWriter) -> None:
    """Estimate the errors of a run, write and report them.

    It does nothing where the case asks for no estimates.
    """
    workspace, started = run.model.workspace, time.perf_counter()
    found = estimate(run)
    if found is None:
        return
    artifact.write("residual", found.residual)
    if found.fitted is None or found.errors is None:
        workspace.context.report.warn(
            f"{run.name}: no estimate of errors: the training runs have "
            "none, or all of them diverge"
        )
        return
    _write(artifact, run, found, found.fitted)
    artifact.annotate("timing/error_estimate", time.perf_counter() - started)
    workspace.context.report.info(_told(run, found, found.fitted, found.errors))


def estimate(run: FastRun) -> Estimate | None:
    """Estimate the errors of a run; None where the case wants no estimates.

    Runs of one model share the fits to its training runs.
    """
    case, model = run.model.workspace.case, run.model.at_point(run.point)
    if model.trained_errors is None:
        if not case.plan.has_error_estimate(model.name):
            return None
        model.trained_errors = TrainedErrors(model)
    trained, units = model.trained_errors, units_of(case)
    residual = trained.residual(run.point, run.reduced, run.time, run.coordinates)
    sizes, local = trained.products.sizes(run.coordinates), trained.at(run.point)
    if local is None:
        return Estimate(residual, None, None, sizes, True, units)
    errors = local.errors(run.time, residual, run.coordinates)
    return Estimate(residual, local, errors, sizes, local.extrapolates(run.time), units)


def steady_errors(run: FastRun, state: Array) -> SteadyErrors | None:
    """Estimate the errors of a steady state (n_modes,) that was found from where a run ended.

    None where the run has no estimates.
    """
    trained = run.model.at_point(run.point).trained_errors
    local = None if trained is None else trained.at(run.point)
    if trained is None or local is None:
        return None
    residual = trained.residual(run.point, run.reduced, run.time[-1:], state[None])[0]
    change = local.changes(run.time, run.coordinates)[-1]
    later = float(np.linalg.norm(state - run.coordinates[-1]))
    errors = local.steady_errors(float(residual), change, later)
    relative = errors / trained.products.sizes(state[None])[0]
    distance = distance_from(local.expected, state)
    units = units_of(run.model.workspace.case)
    return SteadyErrors(float(residual), errors * units, relative, distance)


def distance_from(states: Array, state: Array) -> float:
    """Return the distance of a state (n_modes,) from the nearest of some, over its norm."""
    nearest = float(np.linalg.norm(states - state, axis=1).min())
    size = float(np.linalg.norm(state))
    return nearest / size if size > 0.0 else float(nearest > 0.0)


def units_of(case: Case) -> Array:
    """Return the factors (2,) from errors in [m/s] to those of velocity [m/s] and pressure [Pa]."""
    return np.array([1.0, case.fluid.reference_density * case.plan.sound_speed])


class TrainedErrors:
    """The errors of a model with one basis in training, and the fit of estimates to them.

    `fitted` is None where the training runs have no errors, or all of them diverge.
    """

    def __init__(self, model: BasisModel) -> None:
        workspace, name, points = model.workspace, model.name, model.points
        self._model, self._case = model, workspace.case
        compared = compared_snapshots(self._case.plan.steps.n_snapshots)
        group = f"bases/{name}/estimate"
        with workspace.open(workspace.operators()) as artifact:
            self._whole = whole = read_operators(artifact, name)
            self._factor = read_record(
                artifact, ResidualFactor, f"bases/{name}/residual", walls_driven=whole.walls_driven
            )
            unheld = read_record(artifact, UnheldShares, f"{group}/unheld")
        self.products = model.products
        correction, places = model.correction, places_of(self._case, points)
        coordinates, residuals, errors = [], [], []
        for k, (reduced, found) in enumerate(model.trained):
            held_out, own = found, found
            if correction is not None:
                # With its own correction a training run is the full run: its error tells nothing.
                held_out = found + correction.held_out(places[k])
                own = found + correction.at(places[k])
            coordinates.append(own)
            time = reduced.output_times.time
            residuals.append(self.residual(points[k], reduced, time, held_out))
            errors.append(self.products.errors(k, held_out[compared]))
        self.fitted = calibrate(
            time,
            np.stack(coordinates),
            np.stack(residuals),
            np.stack(errors),
            compared,
            places,
            unheld.of_size(model.section.size),
        )

    def at(self, point: ParameterPoint) -> LocalCalibration | None:
        """Return the fit at a parameter point."""
        place = places_of(self._case, [point])[0]
        return None if self.fitted is None else self.fitted.at(place)

    def residual(
        self, point: ParameterPoint, reduced: ReferenceModel, times: Array, coordinates: Array
    ) -> Array:
        """Return the residual's norm (n_states,) [/s] at coordinates of a model at a point."""
        viscosity, factors = self._case.plan.kinematic_viscosity(point), point.factors
        projected = self._model.operators.at(viscosity, factors=factors)
        added = reduced.polynomial.plus(projected, -1.0)
        nothing = not any(tensor.any() for tensors in added.powers for tensor in tensors)
        closure = None if nothing else added
        modes = self._model.modes
        norm = residual_norm(
            self._factor, self._whole, modes, viscosity, closure=closure, factors=factors
        )
        return norm(coordinates, None if reduced.amplitude is None else reduced.amplitude(times))


def _write(
    artifact: ArtifactWriter, run: FastRun, found: Estimate, fitted: LocalCalibration
) -> None:
    """Write an estimate: root mean squares in [m/s] and [Pa], and the fitted constants."""
    velocity, pressure = found.velocity_and_pressure.T
    constants = [float(constant) for constant in fitted.constants * found.units]
    factors: list[float] | list[None] = [None, None]
    if fitted.factors is not None and not found.extrapolates:
        factors = [float(factor) for factor in fitted.factors]
    stored = ErrorEstimate(
        velocity=velocity,
        pressure=pressure,
        change=fitted.changes(run.time, run.coordinates),
        decay_rate=fitted.decay_rate,
        training="outside" if found.extrapolates else "inside",
        velocity_constant=constants[0],
        pressure_constant=constants[1],
        velocity_factor=factors[0],
        pressure_factor=factors[1],
    )
    write_record(artifact, stored, "error_estimate")


def _told(run: FastRun, found: Estimate, fitted: LocalCalibration, errors: Array) -> str:
    """Return an estimate in words: in % of the fields' root mean squares over the run."""
    at_end = 100.0 * errors[-1] / found.sizes[-1]
    trusted = [""] * len(FIELDS)
    if fitted.factors is not None and not found.extrapolates:
        trusted = [f", right to a factor of {factor:.2g} in training" for factor in fitted.factors]
    parts = [
        f"{field} {format_figure(mean)} % ({format_figure(end)} % at the end{trust})"
        for field, mean, end, trust in zip(FIELDS, found.percent, at_end, trusted, strict=True)
    ]
    text = f"{run.name}: estimated errors: {', '.join(parts)}"
    if not found.extrapolates:
        return text
    return f"{text}; extrapolated, as the model was trained on {_trained_on(run)} only"


def _trained_on(run: FastRun) -> str:
    """Return the parameters that the basis of a run was trained on, in words."""
    points = [point.as_dict() for point in run.model.at_point(run.point).points]
    words = []
    for name in points[0]:
        values = sorted({point[name] for point in points})
        ends = f"{values[0]:g}" if len(values) == 1 else f"{values[0]:g} to {values[-1]:g}"
        words.append(f"{name} {ends}")
    return ", ".join(words)
