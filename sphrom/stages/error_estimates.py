"""Estimates of what runs on the reference points are wrong by, without a full run to hold against.

A model's training runs are repeated, the estimate is fitted to their errors (see
`sphrom.reduction.error_calibration`), and then applied to the run. All of it takes about as long as
the runs do, whatever the number of points is.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.models import Case
from sphrom.case.plan import has_error_estimate, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.reduction.error_calibration import (
    Calibration,
    FieldProducts,
    calibrate,
    compared_snapshots,
)
from sphrom.reduction.error_estimate import ResidualFactor, residual_norm
from sphrom.reduction.exponential import ExponentialModel
from sphrom.reduction.memory_operators import with_memory
from sphrom.reduction.operators import ReducedOperators
from sphrom.reduction.polynomial import Polynomial
from sphrom.reduction.polynomial_model import Amplitude, PolynomialModel, Schedule, step_limit
from sphrom.report.tables import format_figure
from sphrom.stages import memory
from sphrom.stages.operators import read_operators
from sphrom.stages.residuals import read_factor, read_products
from sphrom.stages.workspace import Workspace

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FIELDS = ("velocity", "pressure")


@dataclass(frozen=True)
class EstimatedRun:
    """A run that ended, and what training runs of the same model need."""

    model: ReducedModelSection
    point: ParameterPoint
    time: Array
    """(n_snapshots,) [s]."""
    coordinates: Array
    """(n_snapshots, n_modes)."""
    kinematic_viscosity: float
    """[m2/s]."""
    polynomial: Polynomial
    """Its rates."""
    n_parts: int
    """Parts of its basis, each with as many modes."""
    amplitude: Amplitude | None
    """Of what drives the flow, where that changes."""
    memory_length: float | None
    """tau of Eq. 3.22 [s], of a model with the closure."""
    largest_norm: float
    """Of coordinates, beyond which a run has diverged."""
    n_steps: Callable[[float], int]
    """Steps of a whole run, from the largest stable step [s]."""
    linear: Array | None = None
    """(n_modes, n_modes) [1/s] what exponential steps carry; None for Runge-Kutta's."""

    @property
    def pushes(self) -> Array | None:
        """The amplitude (n_snapshots,) at the snapshots, where it changes."""
        return None if self.amplitude is None else self.amplitude(self.time)


def estimate_errors(workspace: Workspace, run: EstimatedRun, artifact: ArtifactWriter) -> None:
    """Estimate the errors of a run, write them and say what they are.

    Nothing is done where the case wants no estimates.
    """
    started = time.perf_counter()
    found = estimate(workspace, run)
    if found is None:
        return
    artifact.write("residual", found.residual)
    if found.fitted is None:
        workspace.context.report.warn(
            f"{run.model.name}, {run.point.label}: no estimate of errors: the training runs have "
            "none, or all of them diverge"
        )
        return
    errors = found.fitted.errors(run.time, found.residual)
    _write(workspace.case, artifact, found.fitted, errors)
    artifact.annotate("timing/error_estimate", time.perf_counter() - started)
    workspace.context.report.info(_told(run, found.fitted, errors, found.sizes))


@dataclass(frozen=True)
class Estimate:
    """What is known of a run's errors without a full run."""

    residual: Array
    """(n_snapshots,) its norm [/s]."""
    fitted: Calibration | None
    """Errors from residuals; None where training runs have no errors, or all of them diverge."""
    sizes: Array
    """(n_snapshots, 2) root mean squares of the run's velocity and c0 rho'/rho0 [m/s]."""


def estimate(
    workspace: Workspace, run: EstimatedRun, kept: dict[str, Stored] | None = None
) -> Estimate | None:
    """Estimate the errors of a run; None where the case wants no estimates.

    What runs of one model share is read into `kept`, by basis, where that is given.
    """
    case = workspace.case
    name = case.basis_for(run.model, run.point)
    if not has_error_estimate(case, name):
        return None
    kept = {} if kept is None else kept
    if name not in kept:
        with workspace.open(workspace.operators()) as operators:
            kept[name] = Stored.read(operators, name, run)
    stored = kept[name]
    residual = stored.residual(run.kinematic_viscosity, run, run.coordinates)
    fitted = _calibrated(case, name, stored, run)
    return Estimate(residual, fitted, stored.products.sizes(run.coordinates))


def shares(errors: Array, sizes: Array) -> Array:
    """Return errors (n_snapshots, 2) over the fields' sizes, root mean squares over a run (2,)."""
    return np.asarray(np.sqrt(np.mean(errors**2, axis=0) / np.mean(sizes**2, axis=0)))


def estimated_errors(workspace: Workspace, run: EstimatedRun) -> Array | None:
    """Return estimates (n_snapshots, 2) of a run's errors, root mean squares [m/s] and [Pa].

    None where the case wants no estimates, or can't have them.
    """
    found = estimate(workspace, run)
    if found is None or found.fitted is None:
        return None
    return found.fitted.errors(run.time, found.residual) * _units(workspace.case)


def _units(case: Case) -> Array:
    """Return what makes errors, all in [m/s], those of velocity [m/s] and pressure [Pa]."""
    return np.array([1.0, case.fluid.reference_density * case.sound_speed])


@dataclass(frozen=True)
class Stored:
    """What the operators' artifact holds for a model."""

    modes: Indices
    """Those of the basis that the model uses."""
    factor: ResidualFactor
    whole: ReducedOperators
    """Of all modes."""
    operators: ReducedOperators
    """Of the model's modes, like all that follows."""
    closure: memory.MemoryOperators | None
    products: FieldProducts
    starts: Array
    """(n_runs, n_modes) of the training runs."""
    states: Array
    """(n_states, n_modes) around which steps have to be stable."""

    @classmethod
    def read(cls, artifact: Artifact, name: str, run: EstimatedRun) -> Stored:
        """Read what a run needs."""
        group, n_modes = f"bases/{name}", run.model.n_modes
        n_all = int(artifact.dataset(f"{group}/acoustic").shape[0])
        parts = np.arange(run.n_parts)[:, None] * (n_all // run.n_parts)
        modes = (parts + np.arange(n_modes)).ravel()
        closure = None
        if run.memory_length is not None:
            closure = memory.read_memory(artifact, memory.memory_group(name, n_modes))
        return cls(
            modes=modes,
            factor=read_factor(artifact, name),
            whole=read_operators(artifact, name, np.arange(n_all)),
            operators=read_operators(artifact, name, modes),
            closure=closure,
            products=read_products(artifact, name).only(modes, n_all),
            starts=artifact.read(f"{group}/estimate/start")[:, modes],
            states=artifact.read(f"{group}/states")[:, modes],
        )

    def rates(self, viscosity: float, run: EstimatedRun) -> Polynomial:
        """Return the rates of the run's model at another viscosity [m2/s]."""
        return with_memory(self.operators.at(viscosity), self._added(viscosity, run), 1.0)

    def residual(self, viscosity: float, run: EstimatedRun, coordinates: Array) -> Array:
        """Return the residual's norm (n_snapshots,) [/s] along coordinates."""
        added = self._added(viscosity, run)
        nothing = not any(tensor.any() for tensors in added.powers for tensor in tensors)
        closure = None if nothing else added
        norm = residual_norm(self.factor, self.whole, self.modes, viscosity, closure=closure)
        return norm(coordinates, run.pushes)

    def _added(self, viscosity: float, run: EstimatedRun) -> Polynomial:
        """Return what a model adds to the projected rates: nothing, if it is Galerkin's."""
        added = with_memory(run.polynomial, self.operators.at(run.kinematic_viscosity), -1.0)
        if self.closure is None or run.memory_length is None:
            return added
        here, there = self.closure.at(run.kinematic_viscosity), self.closure.at(viscosity)
        return with_memory(added, with_memory(there, here, -1.0), run.memory_length)


def _calibrated(case: Case, name: str, stored: Stored, run: EstimatedRun) -> Calibration | None:
    """Repeat the training runs with a run's model, and fit the estimate to their errors."""
    viscosities = [case.kinematic_viscosity(point) for point in case.bases[name]]
    rates = [stored.rates(viscosity, run) for viscosity in viscosities]
    pushes = run.pushes
    strongest = 0.0 if pushes is None else float(np.max(np.abs(pushes)))
    steps = [
        run.n_steps(step_limit(each, np.vstack((start, stored.states)), strongest))
        for each, start in zip(rates, stored.starts, strict=True)
    ]
    plan = step_plan(case)
    schedule = Schedule(plan.snapshot_interval, plan.n_snapshots, plan.start_time, run.largest_norm)
    exact = run.linear
    system = PolynomialModel(rates) if exact is None else ExponentialModel(rates, exact)
    runs = system.run_in(steps, stored.starts, schedule, run.amplitude)
    compared = compared_snapshots(plan.n_snapshots)
    residuals, errors = [], []
    for k, (viscosity, coordinates) in enumerate(zip(viscosities, runs.coordinates, strict=True)):
        residuals.append(stored.residual(viscosity, run, coordinates))
        errors.append(stored.products.errors(k, coordinates[compared]))
    return calibrate(runs.time, residuals, errors, compared)


def _write(case: Case, artifact: ArtifactWriter, fitted: Calibration, errors: Array) -> None:
    """Write an estimate: root mean squares in [m/s] and [Pa], and what it was fitted with."""
    units = _units(case)
    for field, error in zip(FIELDS, (errors * units).T, strict=True):
        artifact.write(f"error_estimate/{field}", error)
    artifact.annotate("error_estimate/decay_rate", fitted.decay_rate)
    for field, constant, factor in zip(
        FIELDS, fitted.constants * units, fitted.factors, strict=True
    ):
        artifact.annotate(f"error_estimate/{field}_constant", constant)
        artifact.annotate(f"error_estimate/{field}_factor", factor)


def _told(run: EstimatedRun, fitted: Calibration, errors: Array, sizes: Array) -> str:
    """Return an estimate in words: in % of the fields' root mean squares over the run."""
    of_run = 100.0 * shares(errors, sizes)
    at_end = 100.0 * errors[-1] / sizes[-1]
    parts = [
        f"{field} {format_figure(mean)} % ({format_figure(end)} % at the end, right to a factor "
        f"of {factor:.2g} in training)"
        for field, mean, end, factor in zip(FIELDS, of_run, at_end, fitted.factors, strict=True)
    ]
    return f"{run.model.name}, {run.point.label}: estimated errors: {', '.join(parts)}"
