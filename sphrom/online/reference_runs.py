"""Reduced runs on the reference points, whose cost does not depend on the number of particles."""

from __future__ import annotations

import math

import numpy as np

from sphrom.artifacts import ArtifactWriter
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.online.error_estimates import estimate_errors, steady_errors
from sphrom.online.fast_model import FastModel, FastRun
from sphrom.online.measures import fields_of, forces_of, quantities_of
from sphrom.online.steady import seek_steady_state
from sphrom.reduction.integrators import Integrator
from sphrom.reduction.polynomial import spectrum
from sphrom.reduction.polynomial_model import EXPONENTIAL
from sphrom.setup import assembly
from sphrom.setup.assembly import field_measures
from sphrom.store.forces import write_forces
from sphrom.store.measures import write_measured
from sphrom.store.workspace import Workspace

N_TIMED = 5
"""Repetitions of a run, to time it."""


def run_point(workspace: Workspace, section: ReducedModelSection, point: ParameterPoint) -> None:
    """Run a model from operators at a parameter point, and write its artifact."""
    workspace.require(workspace.operators())
    target = workspace.reduced_run(section, point)
    model = FastModel(workspace, section)
    reduced = model.at(point)
    integrator = model.integrator(reduced)
    attributes = assembly.run_attributes(workspace.case, point, integrator.time_step)
    with workspace.create(target, attributes) as artifact:
        runs, seconds = integrator.timed(N_TIMED)
        run = FastRun(model, point, reduced, runs)
        _write(run, artifact)
        artifact.annotate("status", "complete" if run.failure is None else "unstable")
        if run.failure is not None:
            artifact.annotate("status_detail", str(run.failure))
        artifact.annotate("timing/integration", seconds)
        artifact.annotate("integrator", integrator.name)
        _tell(run, integrator, seconds)
        if run.failure is None:
            estimate_errors(run, artifact)
            if section.steady:
                _seek_steady_state(run, artifact)


def _seek_steady_state(run: FastRun, artifact: ArtifactWriter) -> None:
    amplitude, case = run.reduced.amplitude, run.model.workspace.case
    seek_steady_state(
        artifact,
        run.model.workspace.context.report,
        run.name,
        run.reduced.polynomial,
        run.coordinates[-1],
        0.0 if amplitude is None else float(amplitude(run.time)[-1]),
        trained=run.model.training_states(run.point),
        estimated=lambda state: steady_errors(run, state),
        measured=lambda states: quantities_of(case, run.point, run.reduced, run.time[-1:], states),
    )


def _tell(run: FastRun, integrator: Integrator, seconds: float) -> None:
    """Report the number of steps of a run, their length, and the time that they took."""
    report, reduced, step = run.model.workspace.context.report, run.reduced, run.time_step
    exponential = integrator.name == EXPONENTIAL
    if not exponential and step > reduced.step_limit:
        report.warn(
            f"{run.name}: a step of {step:.3g} s is beyond the model's limit of "
            f"{reduced.step_limit:.3g} s"
        )
    if run.failure is not None:
        report.warn(f"{run.name}: {run.failure}")
        return
    kind = "exponential steps" if exponential else "steps"
    length = reduced.memory_length
    closure = "" if length is None else f", memory length {length:.3g} s"
    if reduced.leading is not None:
        closure += f", {reduced.n_integrated} of {reduced.basis.n_modes} modes integrated"
    # Rounded first: the last exponential step may reach beyond the end, but not by rounding.
    n_steps = math.ceil(round((run.time[-1] - run.time[0]) / step, 6))
    report.info(f"{run.name}: {n_steps} {kind} of {step:.3g} s in {1e3 * seconds:.3g} ms{closure}")


def _write(run: FastRun, artifact: ArtifactWriter) -> None:
    """Write the coordinates of a run as far as it went, and the fields that the model asks for."""
    workspace, reduced, point = run.model.workspace, run.reduced, run.point
    section = run.model.sized(point)
    n_done = int(np.isfinite(run.coordinates).all(axis=1).sum())
    times, coordinates = run.time[:n_done], run.coordinates[:n_done]
    artifact.write("time", times)
    artifact.write("generalized_coordinates", coordinates)
    if run.correction is not None:
        artifact.write("correction", run.correction[:n_done])
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
    if section.output != "none":
        # Fields load the kernels of splines, and tracers those of interpolation.
        from sphrom.online.rebuilt_run import write_fields, write_probes

        if section.output == "snapshots":
            write_fields(workspace, artifact, reduced, coordinates)
        else:
            write_probes(workspace, section, point, artifact, reduced, times, coordinates)
    if section.tracers:
        from sphrom.online.tracers import write_tracers

        write_tracers(workspace, section, point, artifact, times, coordinates)
