"""Reduced runs on the reference points, whose cost does not depend on the number of particles."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import UnstableError
from sphrom.online.error_estimates import EstimatedRun, Trained, estimate_errors, steady_errors
from sphrom.online.integration import polynomial_integrator
from sphrom.online.measures import fields_of, forces_of, quantities_of
from sphrom.online.reference_model import ReferenceModels
from sphrom.online.steady import seek_steady_state
from sphrom.reduction.integrators import Integrator
from sphrom.reduction.polynomial import spectrum
from sphrom.reduction.polynomial_model import EXPONENTIAL, Runs
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.setup import assembly
from sphrom.setup.assembly import field_measures
from sphrom.store.forces import write_forces
from sphrom.store.measures import write_measured
from sphrom.store.operators import sized
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]

N_TIMED = 5
"""Repetitions of a run that takes far less than a second, to time it."""


def run_point(workspace: Workspace, model: ReducedModelSection, point: ParameterPoint) -> None:
    """Run a model on the reference points at a parameter point."""
    workspace.require(workspace.operators())
    target = workspace.reduced_run(model, point)
    model = sized(workspace, model, point)
    models = ReferenceModels(workspace, model)
    reduced = models.at(point)
    integrator = integrator_of(workspace, model, point, reduced)
    attributes = assembly.run_attributes(workspace.case, point, integrator.time_step)
    report, run = workspace.context.report, f"{model.name}, {point.label}"
    with workspace.create(target, attributes) as artifact:
        if model.from_operators:
            runs, seconds = integrator.timed(N_TIMED, lambda n_snapshots: None)
        else:
            with report.progress(run, reduced.output_times.n_snapshots - 1) as advance:
                runs, seconds = integrator.timed(N_TIMED, advance)
        failure = failure_of(runs)
        _write(workspace, model, point, reduced, runs, artifact)
        artifact.annotate("status", "complete" if failure is None else "unstable")
        if failure is not None:
            artifact.annotate("status_detail", str(failure))
        artifact.annotate("timing/integration", seconds)
        artifact.annotate("integrator", integrator.name)
        _tell(workspace, run, reduced, integrator, runs, seconds)
        if failure is None:
            _examine(workspace, models, EstimatedRun(models, point, reduced, runs), artifact)


def _examine(
    workspace: Workspace, models: ReferenceModels, run: EstimatedRun, artifact: ArtifactWriter
) -> None:
    """Estimate the errors of a run that ended, and seek a steady state if the model asks for it."""
    model, training = models.model, dict[str, Trained]()
    if model.from_operators:
        estimate_errors(workspace, run, artifact, training)
    if model.steady:
        amplitude, times = run.reduced.amplitude, run.runs.time
        seek_steady_state(
            artifact,
            workspace.context.report,
            f"{model.name}, {run.point.label}",
            run.reduced.polynomial,
            run.coordinates[-1],
            0.0 if amplitude is None else float(amplitude(times)[-1]),
            trained=models.training_states(run.point),
            estimated=lambda state: steady_errors(workspace.case, run, training, state),
            measured=lambda states: quantities_of(
                workspace.case, run.point, run.reduced, times[-1:], states
            ),
        )


def integrator_of(
    workspace: Workspace,
    model: ReducedModelSection,
    point: ParameterPoint,
    reduced: ReferenceModel,
) -> Integrator:
    """Return the integrator of a model at a parameter point.

    Raises CaseError when stable steps would be too many for any run to end.
    """
    if model.from_operators:
        return polynomial_integrator(model, reduced, workspace.case.snapshots.every)
    # Rates at points load the kernels of SPH.
    from sphrom.online.point_rates import point_integrator

    return point_integrator(workspace, model, point, reduced)


def run_once(
    workspace: Workspace,
    model: ReducedModelSection,
    point: ParameterPoint,
    reduced: ReferenceModel,
) -> Runs:
    """Run a model at a parameter point as `run_point` does, to the last bit, and write nothing."""
    return integrator_of(workspace, model, point, reduced).run()


def _tell(
    workspace: Workspace,
    run: str,
    reduced: ReferenceModel,
    integrator: Integrator,
    runs: Runs,
    seconds: float,
) -> None:
    """Report the number of steps of a run, their length, and the time that they took."""
    report, step = workspace.context.report, float(runs.time_step[0])
    exponential = integrator.name == EXPONENTIAL
    if not exponential and step > reduced.step_limit:
        report.warn(
            f"{run}: a step of {step:.3g} s is beyond the model's limit of "
            f"{reduced.step_limit:.3g} s"
        )
    if (failure := failure_of(runs)) is not None:
        report.warn(f"{run}: {failure}")
        return
    kind = "exponential steps" if exponential else "steps"
    length = reduced.memory_length
    closure = "" if length is None else f", memory length {length:.3g} s"
    if reduced.leading is not None:
        closure += f", {reduced.n_integrated} of {reduced.basis.n_modes} modes integrated"
    # Rounded first: the last exponential step may reach beyond the end, but not by rounding.
    n_steps = math.ceil(round((runs.time[-1] - runs.time[0]) / step, 6))
    report.info(f"{run}: {n_steps} {kind} of {step:.3g} s in {1e3 * seconds:.3g} ms{closure}")


def failure_of(runs: Runs) -> UnstableError | None:
    """Return why a single run ended early, None where it didn't."""
    at = float(runs.diverged_at[0])
    if np.isnan(at):
        return None
    return UnstableError(
        f"unstable after t = {at:.6g} s: the coordinates are beyond those of a flow as fast as "
        "sound; a smaller time step or another number of modes may help"
    )


def _write(
    workspace: Workspace,
    model: ReducedModelSection,
    point: ParameterPoint,
    reduced: ReferenceModel,
    runs: Runs,
    artifact: ArtifactWriter,
) -> None:
    """Write the coordinates of a run as far as it went, and the fields that the model asks for."""
    n_done = int(np.isfinite(runs.coordinates[0]).all(axis=1).sum())
    times, coordinates = runs.time[:n_done], runs.coordinates[0, :n_done]
    artifact.write("time", times)
    artifact.write("generalized_coordinates", coordinates)
    if runs.correction is not None:
        artifact.write("correction", runs.correction[0, :n_done])
        artifact.annotate("integrated_modes", reduced.n_integrated)
    artifact.annotate("mean_density_fluctuation", reduced.mean_density_fluctuation)
    if math.isfinite(reduced.step_limit):
        artifact.annotate("step_limit", reduced.step_limit)
    if reduced.memory_length is not None:
        artifact.annotate("memory_length", reduced.memory_length)
    growth = spectrum(reduced.polynomial.jacobian(reduced.start)).largest_real_part
    artifact.annotate("largest_real_part", growth)
    about = reduced.forces, reduced.mean_density_fluctuation, times, coordinates
    for name, loads in forces_of(workspace.case, point, *about).items():
        write_forces(artifact, name, loads)
    fields = fields_of(reduced.measures, reduced.mean_density_fluctuation, coordinates)
    write_measured(artifact, field_measures(workspace.case), fields)
    if model.output != "none":
        # Fields load the kernels of splines, and tracers those of interpolation.
        from sphrom.online.rebuilt_run import write_fields, write_probes

        if model.output == "snapshots":
            write_fields(workspace, artifact, reduced, coordinates)
        else:
            write_probes(workspace, model, point, artifact, reduced, times, coordinates)
    if model.tracers:
        from sphrom.online.tracers import write_tracers

        write_tracers(workspace, model, point, artifact, times, coordinates)
