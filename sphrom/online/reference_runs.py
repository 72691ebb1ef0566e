"""Reduced runs on the reference points, whose cost does not depend on the number of particles."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter
from sphrom.case.plan import StepPlan, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import UnstableError
from sphrom.online import evaluated_runs
from sphrom.online.error_estimates import EstimatedRun, Trained, estimate_errors, steady_errors
from sphrom.online.evaluated_runs import Evaluation
from sphrom.online.rebuilt_run import write_fields, write_probes
from sphrom.online.reference_model import ReferenceModel, ReferenceModels
from sphrom.online.steady import seek_steady_state
from sphrom.online.stepping import Stepping, schedule_of, stepping_of, timed
from sphrom.online.tracers import write_tracers
from sphrom.reduction.polynomial import spectrum
from sphrom.reduction.polynomial_model import Runs
from sphrom.setup import assembly
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]

N_TIMED = 5
"""Times that a run is repeated to say what it takes, which is far below a second."""


def run_point(workspace: Workspace, model: ReducedModelSection, point: ParameterPoint) -> None:
    """Run a model on the reference points at a parameter point."""
    case = workspace.case
    workspace.require(workspace.operators())
    models = ReferenceModels(workspace, model)
    reduced = models.at(point)
    plan = step_plan(case)
    evaluated = evaluated_runs.evaluation(workspace, model, point, reduced.basis, reduced.amplitude)
    stepping = stepping_of(model, reduced, plan, points=evaluated is not None)
    time_step = stepping.system.time_step(stepping.n_steps, schedule_of(reduced, plan))
    attributes = assembly.run_attributes(case, point, time_step)
    with workspace.create(workspace.reduced_run(model, point), attributes) as artifact:
        if evaluated is None:
            schedule = schedule_of(reduced, plan)
            runs, seconds = timed(reduced, schedule, stepping.system, stepping.n_steps, N_TIMED)
        else:
            n_steps = stepping.n_steps
            runs, seconds = _evaluated(workspace, model, point, reduced, evaluated, n_steps)
        failure = failure_of(runs)
        n_kept = int(np.isfinite(runs.coordinates[0]).all(axis=1).sum())
        _write(workspace, model, point, reduced, runs, n_kept, artifact)
        if model.tracers:
            kept = runs.time[:n_kept], runs.coordinates[0, :n_kept]
            write_tracers(workspace, model, point, artifact, *kept)
        artifact.annotate("status", "complete" if failure is None else "unstable")
        if failure is not None:
            artifact.annotate("status_detail", str(failure))
        artifact.annotate("timing/integration", seconds)
        artifact.annotate("integrator", stepping.integrator)
        run = f"{model.name}, {point.label}"
        _tell(workspace, run, reduced, stepping, runs, seconds)
        ended = estimated_run(workspace, models, point, reduced, runs)
        training: dict[str, Trained] = {}
        if evaluated is None and failure is None:
            estimate_errors(workspace, ended, artifact, training)
        if model.steady and failure is None:
            last = runs.coordinates[0, -1]
            driven = 0.0 if reduced.amplitude is None else float(reduced.amplitude(runs.time)[-1])
            seek_steady_state(
                artifact,
                workspace.context.report,
                run,
                reduced.polynomial,
                last,
                driven,
                trained=models.training_states(point),
                estimated=lambda state: steady_errors(case, ended, training, state),
            )


def run_once(
    workspace: Workspace,
    model: ReducedModelSection,
    point: ParameterPoint,
    reduced: ReferenceModel,
    plan: StepPlan | None = None,
) -> Runs:
    """Run a model at a parameter point as `run_point` does, to the last bit, and write nothing.

    `plan` is for a run that ends at another time than the case's.
    """
    plan = step_plan(workspace.case) if plan is None else plan
    schedule = schedule_of(reduced, plan)
    evaluated = evaluated_runs.evaluation(workspace, model, point, reduced.basis, reduced.amplitude)
    stepping = stepping_of(model, reduced, plan, points=evaluated is not None)
    if evaluated is not None:
        every = stepping.n_steps // max(1, plan.n_snapshots - 1)
        runs, _ = evaluated_runs.timed(evaluated, reduced.start, schedule, every, lambda done: None)
    else:
        runs = stepping.system.run_in(
            [stepping.n_steps], reduced.start[None], schedule, reduced.amplitude
        )
    return runs


def estimated_run(
    workspace: Workspace,
    models: ReferenceModels,
    point: ParameterPoint,
    reduced: ReferenceModel,
    runs: Runs,
    step_factor: float = 1.0,
) -> EstimatedRun:
    """Return a run that ended, as one whose errors are to be estimated.

    Its steps were `step_factor` times as long as the model's own.
    """
    plan = step_plan(workspace.case)
    basis = workspace.case.basis_for(models.model, point)

    def stepping(other: ReferenceModel) -> Stepping:
        """Return the same kind of steps at other parameters."""
        own = stepping_of(models.model, other, plan, points=False)
        return replace(own, n_steps=max(1, round(own.n_steps / step_factor)))

    return EstimatedRun(
        model=models.model,
        point=point,
        time=runs.time,
        coordinates=runs.coordinates[0],
        reduced=reduced,
        at=lambda other: models.at(other, basis),
        stepping=stepping,
    )


def _tell(
    workspace: Workspace,
    run: str,
    reduced: ReferenceModel,
    stepping: Stepping,
    runs: Runs,
    seconds: float,
) -> None:
    """Say how a run went, and in what steps."""
    report, step = workspace.context.report, float(runs.time_step[0])
    exponential = stepping.linear is not None
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
    report.info(f"{run}: {_taken(runs)} {kind} of {step:.3g} s in {1e3 * seconds:.3g} ms{closure}")


def _taken(runs: Runs) -> int:
    """Return how many steps a run to the end took."""
    # Rounded first: the last exponential step may reach beyond the end, but not by rounding.
    return math.ceil(round((runs.time[-1] - runs.time[0]) / float(runs.time_step[0]), 6))


def _evaluated(
    workspace: Workspace,
    model: ReducedModelSection,
    point: ParameterPoint,
    reduced: ReferenceModel,
    evaluated: Evaluation,
    n_steps: int,
) -> tuple[Runs, float]:
    """Run once with rates that are evaluated at points, and return what it took [s]."""
    report, run = workspace.context.report, f"{model.name}, {point.label}"
    schedule = schedule_of(reduced, step_plan(workspace.case))
    every = n_steps // max(1, schedule.n_snapshots - 1)
    with report.progress(run, schedule.n_snapshots - 1) as advance:
        return evaluated_runs.timed(evaluated, reduced.start, schedule, every, advance)


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
    n_kept: int,
    artifact: ArtifactWriter,
) -> None:
    coordinates = runs.coordinates[0][:n_kept]
    artifact.write("time", runs.time[:n_kept])
    artifact.write("generalized_coordinates", coordinates)
    artifact.annotate("mean_density_fluctuation", reduced.mean_density_fluctuation)
    if math.isfinite(reduced.step_limit):
        artifact.annotate("step_limit", reduced.step_limit)
    if reduced.memory_length is not None:
        artifact.annotate("memory_length", reduced.memory_length)
    growth = spectrum(reduced.polynomial.jacobian(reduced.start)).largest_real_part
    artifact.annotate("largest_real_part", growth)
    mean = reduced.mean_density_fluctuation
    if model.output == "snapshots":
        write_fields(workspace, artifact, reduced.basis, coordinates, mean)
    if model.output == "probes":
        times = runs.time[:n_kept]
        write_probes(workspace, model, point, artifact, reduced.basis, times, coordinates, mean)
