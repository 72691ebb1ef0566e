"""Reduced runs on the reference points, whose cost does not depend on the number of particles."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter
from sphrom.case.discretization_checks import MAX_STEPS
from sphrom.case.models import Case
from sphrom.case.plan import StepPlan, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import CaseError, UnstableError
from sphrom.reduction.memory_operators import with_memory
from sphrom.reduction.polynomial import Polynomial, spectrum
from sphrom.reduction.polynomial_model import (
    Amplitude,
    PolynomialModel,
    Runs,
    Schedule,
    step_limit,
    steps_within,
)
from sphrom.reduction.step_choice import accurate_steps, step_tolerance
from sphrom.reduction.trial_basis import (
    TrialBasis,
    kept_modes,
    mean_density_fluctuation,
    project,
    truncate,
)
from sphrom.stages import assembly, calibration, memory, sampled_runs
from sphrom.stages.error_estimates import EstimatedRun, estimate_errors
from sphrom.stages.fom import start
from sphrom.stages.operators import read_operators
from sphrom.stages.pod import read_basis
from sphrom.stages.rebuilt_run import write_fields, write_probes
from sphrom.stages.sampled_runs import Evaluation
from sphrom.stages.steady import seek_steady_state
from sphrom.stages.tracers import write_tracers
from sphrom.stages.workspace import Workspace

Array = NDArray[np.float64]

N_TIMED = 5
"""Times that a run is repeated to say what it takes, which is far below a second."""


@dataclass(frozen=True)
class ReferenceModel:
    """A reduced model on the reference points, ready to run."""

    polynomial: Polynomial
    basis: TrialBasis
    start: Array
    """(n_modes,) the coordinates at the start."""
    mean_density_fluctuation: float
    """[kg/m3], carried apart."""
    step_limit: float
    """[s], of the start and of some training states."""
    largest_norm: float
    """Of coordinates, beyond which a run has diverged."""
    amplitude: Amplitude | None = None
    """Of what drives the flow, where that changes."""
    memory_length: float | None = None
    """tau of Eq. 3.22 [s], of a model with the closure."""


def build_reference_model(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint
) -> ReferenceModel:
    """Return a model on the reference points at a parameter point, which need not be trained.

    The initial condition is the scene's at that point, or the end of the spin-up, that of the
    nearest trained value where there is none; mapped onto the reference space and projected.
    """
    case = workspace.case
    name = case.basis_for(model, point)
    whole = read_basis(workspace, name)
    modes = kept_modes(whole, model.n_modes)
    basis = truncate(whole, model.n_modes)
    coordinates, mean = _initial_state(workspace, basis, point)
    amplitude = _amplitude(workspace, point)
    strongest = 0.0 if amplitude is None else float(np.max(np.abs(amplitude(_times(case)))))
    with workspace.open(workspace.operators()) as artifact:
        operators = read_operators(artifact, name, modes)
        states = artifact.read(f"bases/{name}/states")[:, modes]
        polynomial = operators.at(case.kinematic_viscosity(point))
        memory_length = None
        if model.projection == "apg":
            jacobian = polynomial.jacobian(coordinates, strongest)
            memory_length = _memory_length(case, model, jacobian)
            closure = memory.read_memory(artifact, memory.memory_group(name, model.n_modes))
            added = closure.at(case.kinematic_viscosity(point))
            polynomial = with_memory(polynomial, added, memory_length)
        if model.calibrated:
            learnt = calibration.read_calibration(case, artifact, name, operators, modes)
            polynomial = learnt.at(case.kinematic_viscosity(point)).added_to(polynomial)
    return ReferenceModel(
        polynomial=polynomial,
        basis=basis,
        start=coordinates,
        mean_density_fluctuation=mean,
        step_limit=step_limit(polynomial, np.vstack((coordinates, states)), strongest),
        largest_norm=_largest_norm(case, basis),
        amplitude=amplitude,
        memory_length=memory_length,
    )


def _initial_state(
    workspace: Workspace, basis: TrialBasis, point: ParameterPoint
) -> tuple[Array, float]:
    """Return the coordinates (n_modes,) at the start, and the mean that is carried apart."""
    case = workspace.case
    with workspace.open(workspace.basis()) as artifact:
        points = artifact.read("reference_position")
    begin = start(workspace, case.start_point(point))
    density, velocity = assembly.map_onto(case, points)(
        begin.position, begin.density_fluctuation, begin.velocity
    )
    mean = float(mean_density_fluctuation(basis, density))
    return project(basis, density, velocity), mean


def _amplitude(workspace: Workspace, point: ParameterPoint) -> Amplitude | None:
    amplitude = assembly.scene(workspace.case, point).amplitude
    if amplitude is None:
        return None
    return lambda times: np.array([amplitude(float(t)) for t in times])


def _times(case: Case) -> Array:
    """Return the times of snapshots (n_snapshots,) [s]."""
    plan = step_plan(case)
    return Schedule(plan.snapshot_interval, plan.n_snapshots, plan.start_time).time


def _memory_length(case: Case, model: ReducedModelSection, jacobian: Array) -> float:
    if model.memory_length == "auto":
        return memory.automatic_memory_length(case, jacobian)
    return model.memory_length


def _largest_norm(case: Case, basis: TrialBasis) -> float:
    """Return the norm of a flow as fast as sound at twice its density: no weak compression."""
    density = float(basis.inner_product.first_field(np.array(case.fluid.reference_density)))
    return math.sqrt(float(basis.weights.sum())) * math.hypot(case.sound_speed, density)


def run_point(workspace: Workspace, model: ReducedModelSection, point: ParameterPoint) -> None:
    """Run a model on the reference points at a parameter point."""
    case = workspace.case
    workspace.require(workspace.operators())
    reduced = build_reference_model(workspace, model, point)
    plan = step_plan(case)
    n_steps = _n_steps(model, reduced, plan)
    evaluated = sampled_runs.evaluation(
        workspace, model, point, reduced.basis, reduced.polynomial, reduced.amplitude
    )
    if evaluated is not None:
        n_steps = whole_steps(n_steps, plan.n_snapshots)
    time_step = plan.snapshot_interval * max(1, plan.n_snapshots - 1) / max(1, n_steps)
    attributes = assembly.run_attributes(case, point, time_step)
    with workspace.create(workspace.reduced_run(model, point), attributes) as artifact:
        if evaluated is None:
            runs, seconds = _timed(reduced, plan, n_steps)
        else:
            runs, seconds = _evaluated(workspace, model, point, reduced, evaluated, n_steps)
            sampled_runs.write_samples(artifact, evaluated)
        failure = _failure(runs)
        n_kept = int(np.isfinite(runs.coordinates[0]).all(axis=1).sum())
        _write(workspace, model, point, reduced, runs, n_kept, artifact)
        if model.tracers:
            kept = runs.time[:n_kept], runs.coordinates[0, :n_kept]
            write_tracers(workspace, model, point, artifact, *kept)
        artifact.annotate("status", "complete" if failure is None else "unstable")
        if failure is not None:
            artifact.annotate("status_detail", str(failure))
        artifact.annotate("timing/integration", seconds)
        run = f"{model.name}, {point.label}"
        _tell(workspace, run, reduced, runs, seconds)
        if evaluated is None and failure is None:
            estimate_errors(
                workspace, estimated_run(workspace, model, point, reduced, runs), artifact
            )
        if model.steady and failure is None:
            report, last = workspace.context.report, runs.coordinates[0, -1]
            driven = 0.0 if reduced.amplitude is None else float(reduced.amplitude(runs.time)[-1])
            seek_steady_state(artifact, report, run, reduced.polynomial, last, driven)


def estimated_run(
    workspace: Workspace,
    model: ReducedModelSection,
    point: ParameterPoint,
    reduced: ReferenceModel,
    runs: Runs,
) -> EstimatedRun:
    """Return a run that ended, as one whose errors are to be estimated."""
    n_steps = _taken(runs)

    def n_steps_within(limit: float) -> int:
        """Take the same share of a limit as the run, unless steps are given."""
        if model.time_step != "auto" or not math.isfinite(reduced.step_limit / limit):
            return n_steps
        return math.ceil(n_steps * reduced.step_limit / limit)

    return EstimatedRun(
        model=model,
        point=point,
        time=runs.time,
        coordinates=runs.coordinates[0],
        kinematic_viscosity=workspace.case.kinematic_viscosity(point),
        polynomial=reduced.polynomial,
        n_parts=len(reduced.basis.singular_values),
        amplitude=reduced.amplitude,
        memory_length=reduced.memory_length,
        largest_norm=reduced.largest_norm,
        n_steps=n_steps_within,
    )


def _tell(
    workspace: Workspace, run: str, reduced: ReferenceModel, runs: Runs, seconds: float
) -> None:
    """Say how a run went, and in what steps."""
    report, step = workspace.context.report, float(runs.time_step[0])
    if step > reduced.step_limit:
        report.warn(
            f"{run}: a step of {step:.3g} s is beyond the model's limit of "
            f"{reduced.step_limit:.3g} s"
        )
    if (failure := _failure(runs)) is not None:
        report.warn(f"{run}: {failure}")
        return
    n_steps = _taken(runs)
    length = reduced.memory_length
    closure = "" if length is None else f", memory length {length:.3g} s"
    report.info(f"{run}: {n_steps} steps of {step:.3g} s in {1e3 * seconds:.3g} ms{closure}")


def _taken(runs: Runs) -> int:
    """Return how many steps a run to the end took."""
    return round((runs.time[-1] - runs.time[0]) / float(runs.time_step[0]))


def _n_steps(model: ReducedModelSection, reduced: ReferenceModel, plan: StepPlan) -> int:
    """Return the steps of a whole run.

    Raises CaseError when stable steps would be too many for any run to end.
    """
    n_intervals = plan.n_snapshots - 1
    if model.time_step == "fom":
        return plan.every * n_intervals
    if model.time_step != "auto":
        return round(plan.snapshot_interval / model.time_step) * n_intervals
    if plan.snapshot_interval * n_intervals > MAX_STEPS * reduced.step_limit:
        raise CaseError(
            f"rom: {model.name} is stable with steps of {reduced.step_limit:.3g} s only, which are "
            f"more than {MAX_STEPS:g} in all; choose fewer modes, a shorter memory_length or a "
            "time_step"
        )
    return automatic_steps(reduced, plan)


def automatic_steps(reduced: ReferenceModel, plan: StepPlan) -> int:
    """Return the steps of a whole run that are stable, and fine enough for the basis."""
    schedule = _schedule(reduced, plan)
    n_stable = steps_within(plan.snapshot_interval * (plan.n_snapshots - 1), reduced.step_limit)
    tolerance = step_tolerance(reduced.basis)
    return accurate_steps(
        reduced.polynomial, reduced.start, schedule, tolerance, n_stable, reduced.amplitude
    )


def whole_steps(n_steps: int, n_snapshots: int) -> int:
    """Return as many steps or a few more, so that steps end on every snapshot."""
    n_intervals = n_snapshots - 1
    return n_intervals * math.ceil(n_steps / max(1, n_intervals))


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
    if evaluated.samples is not None:
        report.info(
            f"{run}: {len(evaluated.samples)} sampled points, whose rates between training states "
            f"are {100.0 * (evaluated.sampling_error or 0.0):.2g} % off those of all points"
        )
    schedule = _schedule(reduced, step_plan(workspace.case))
    every = n_steps // max(1, schedule.n_snapshots - 1)
    with report.progress(run, schedule.n_snapshots - 1) as advance:
        return sampled_runs.timed(evaluated, reduced.start, schedule, every, advance)


def _timed(reduced: ReferenceModel, plan: StepPlan, n_steps: int) -> tuple[Runs, float]:
    """Run, and return what it took [s]: the median of some runs once all is compiled.

    Points are run one by one, though a batch would share them out over threads: what a run takes
    is then its own, and runs of milliseconds are over before threads have started.
    """
    system = PolynomialModel([reduced.polynomial])
    schedule = _schedule(reduced, plan)
    runs = system.run_in([n_steps], reduced.start[None], schedule, reduced.amplitude)
    seconds = []
    for _ in range(N_TIMED):
        started = time.perf_counter()
        runs = system.run_in([n_steps], reduced.start[None], schedule, reduced.amplitude)
        seconds.append(time.perf_counter() - started)
    return runs, float(np.median(seconds))


def _schedule(reduced: ReferenceModel, plan: StepPlan) -> Schedule:
    return Schedule(plan.snapshot_interval, plan.n_snapshots, plan.start_time, reduced.largest_norm)


def _failure(runs: Runs) -> UnstableError | None:
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
