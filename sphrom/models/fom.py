"""Stage `fom`: full-order runs, one trajectory per parameter point (Eq. 2.17-2.18).

A run may have a spin-up, in which the flow develops and nothing is recorded. Its last state is an
artifact of its own, from which the recorded part can be run again.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from dataclasses import replace

from sphrom.arrays import Array
from sphrom.artifacts import write_record
from sphrom.artifacts.records.runs import Packing, Start
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import UnstableError
from sphrom.models.starts import scene_start, start
from sphrom.setup import assembly, particles
from sphrom.setup.context import StageContext
from sphrom.setup.cost import describe_cost, described_run, require_room
from sphrom.setup.particles import MeasuredParticles
from sphrom.sph.packing import MAX_ITERATIONS, pack
from sphrom.sph.time_loop import Clock, Model, TimeSteps, march, runge_kutta_step
from sphrom.store.checkpoints import Checkpoints, integrate, remove_checkpoints
from sphrom.store.stored_run import inflow_of
from sphrom.store.tasks import Failure, Task, Told, recorded
from sphrom.store.trajectory import TrajectoryWriter
from sphrom.store.workers import made_by_workers
from sphrom.store.workspace import Target, Workspace

N_TIMED_STEPS = 10
"""Number of steps per timing, because only some steps search for neighbours."""


def run(context: StageContext) -> None:
    """Run the full model at the chosen parameter points.

    Raises UnstableError if a run becomes unstable; its earlier snapshots are kept.
    """
    workspace = Workspace(context)
    require_room(context.case, workspace.out, context.only)
    describe_cost(context.case, context.report)
    ensure_packed(workspace)
    points = context.chosen(context.case.plan.points)
    theirs = [p.label for p in points if workspace.imported(workspace.full_run(p))]
    ours = [point.label for point in points if point.label not in theirs]
    if theirs and ours:
        context.report.warn(
            f"runs at {'; '.join(theirs)} were imported, those at {'; '.join(ours)} are simulated "
            "here: models are trained on both, and compared with both"
        )
    context, failed = _made_by_workers(workspace, points)
    for failure in failed:
        raise UnstableError(failure.reason)
    workspace = Workspace(context)
    for point in points:
        target = ensure_run(workspace, point)
        remove_checkpoints(target)
        with workspace.open(target) as trajectory:
            if trajectory.text("status") != "complete":
                raise UnstableError(f"{point.label}: {trajectory.text('status_detail')}")
            inflow = inflow_of(context.case, point, trajectory)
        for finding in workspace.unphysical(point):
            context.report.warn(f"{point.label}: the run is unphysical: {finding}")
        if inflow is not None and (problem := inflow.problem) is not None:
            if inflow.is_wrong and not workspace.imported(target):
                raise UnstableError(problem)
            context.report.warn(problem)
        elif inflow is not None:
            context.report.info(inflow.text)


def run_each(context: StageContext, points: Sequence[ParameterPoint]) -> dict[ParameterPoint, str]:
    """Run the full model at points, and return the reasons of unstable runs by point."""
    workspace = Workspace(context)
    require_room(context.case, workspace.out, points, "fom")
    ensure_packed(workspace)
    context, failed = _made_by_workers(workspace, points)
    problems = {failure.point: failure.reason for failure in failed}
    for point in points:
        if point not in problems:
            try:
                run(replace(context, only=(point,)))
            except UnstableError as error:
                problems[point] = str(error).removeprefix(f"{point.label}: ")
    return problems


def _made_by_workers(
    workspace: Workspace, points: Iterable[ParameterPoint]
) -> tuple[StageContext, list[Failure]]:
    targets = {(point, ""): workspace.full_run(point) for point in points}
    return made_by_workers(workspace, "full runs", make_run, targets)


def make_run(task: Task) -> Told:
    """Make the full run of a task."""
    return recorded(task, lambda work: remove_checkpoints(ensure_run(work, task.points[0])))


def ensure_run(workspace: Workspace, point: ParameterPoint) -> Target:
    """Run the full model at a parameter point unless its run is up to date.

    With `resume`, a finished run that ends earlier is continued.

    Raises UnstableError if its spin-up is unstable; ArtifactError if there is an earlier run that
    must not be overwritten, or can't be continued.
    """
    _ensure_spun_up(workspace, point)
    target = workspace.full_run(point)
    shorter = workspace.shorter_run(point)
    if shorter is not None or workspace.must_make(target):
        workspace.context.report.info(described_run(workspace.case, point))
        _run_point(workspace, point, shorter)
    return target


def ensure_packed(workspace: Workspace) -> None:
    """Pack the starting positions unless they are up to date."""
    case = workspace.case
    target = workspace.packing()
    if not case.plan.packed or workspace.reason_to_make(target) is None:
        return
    if not workspace.must_make(target):
        return
    settings = case.discretization.packing
    walls = particles.walls(case, case.plan.flow(case.plan.points[0]))
    with (
        workspace.create(target) as artifact,
        workspace.context.report.progress("packing particles", MAX_ITERATIONS) as advance,
    ):
        packing = pack(
            case.scene.domain,
            case.plan.discretization,
            ghosts=None if walls is None else walls.position,
            seed=settings.seed,
            tolerance=settings.tolerance,
            advance=advance,
        )
        stored = Packing.of(
            packing,
            particle_spacing=case.plan.particle_spacing,
            smoothing_length=case.plan.smoothing_length,
            box_length=case.scene.domain.lengths,
        )
        write_record(artifact, stored)
    workspace.context.report.info(
        f"packed {len(packing.position)} particles: residual {packing.residual[-1]:.2g} after "
        f"{len(packing.residual) - 1} iterations"
    )
    if packing.residual[-1] > settings.tolerance:
        workspace.context.report.warn(
            f"packing stopped after {MAX_ITERATIONS} iterations with a residual above its "
            f"tolerance of {settings.tolerance:g}"
        )


def _ensure_spun_up(workspace: Workspace, point: ParameterPoint) -> None:
    """Run the spin-up, if the case has one, unless it is up to date.

    Reduced runs need its last state too, so it is made even if the full run exists. A valid one is
    kept even with `force`, so that only the recorded part is run again.
    """
    if workspace.case.time.spin_up == 0.0:
        return
    target = workspace.spin_up(point)
    if workspace.reason_to_make(target) is None:
        workspace.context.report.info(f"{target.path.name}: up to date, kept")
    elif workspace.must_make(target):
        _spin_up(workspace, point)
    remove_checkpoints(target)


def _spin_up(workspace: Workspace, point: ParameterPoint) -> None:
    """Run until the flow is developed, and store only the last state."""
    case = workspace.case
    plan = case.plan.steps
    n_steps = plan.n_spin_up_steps
    steps = TimeSteps(plan.time_step, n_steps, every=n_steps)
    begin = scene_start(workspace, point)
    target = workspace.spin_up(point)
    clock = Clock()
    with workspace.create(target, assembly.run_attributes(case, point, plan.time_step)) as artifact:
        checkpoints = Checkpoints(workspace, target, artifact)
        model = particles.functional(case, point)
        density = case.fluid.reference_density
        with (
            checkpoints.progress(f"spin-up, {point.label}", n_steps) as advance,
            checkpoints.kept_if_stopped(),
        ):
            from_step = checkpoints.begin
            reached = checkpoints.reached
            end = begin.state if from_step is None else from_step.state
            try:
                for _, kept in march(
                    model, begin.state, steps, density, clock, advance, from_step, reached
                ):
                    end = kept
            except UnstableError as error:
                raise UnstableError(f"{point.label}, spin-up: {error}") from error
        last = model.snapshot(end)
        stored = Start(
            position=last.position.T,
            density_fluctuation=last.density_fluctuation,
            velocity=last.velocity.T,
        )
        write_record(artifact, stored)
        artifact.annotate("time", steps.time(n_steps))
        artifact.annotate("timing/integration", clock.seconds)


def _run_point(workspace: Workspace, point: ParameterPoint, shorter: Target | None) -> None:
    case = workspace.case
    steps = case.plan.steps
    begin = start(workspace, point)
    target = workspace.full_run(point)
    attributes = assembly.run_attributes(case, point, steps.time_step)
    with workspace.create(target, attributes, over=shorter is not None) as artifact:
        checkpoints = Checkpoints(workspace, target, artifact, shorter)
        with checkpoints.progress(f"full run, {point.label}", steps.n_steps) as advance:
            functional = particles.functional(case, point)
            integrate(
                functional,
                begin.state,
                steps,
                case.fluid.reference_density,
                TrajectoryWriter(
                    artifact,
                    steps.n_snapshots,
                    len(begin.position),
                    case.plan.sound_speed,
                    n_dim=begin.position.shape[1],
                    walls=functional.walls,
                    forces=particles.wall_forces(case, point, functional),
                    fields=MeasuredParticles.of(case, point),
                    watch=particles.watch(case, point),
                ),
                advance,
                checkpoints,
            )


def seconds_of_steps(case: Case, model: Model, state: Array, step: float, counted: float) -> float:
    """Return the processor time [s] of a run on particles in steps of `counted` [s].

    It times some steps of another length [s], because the cost of a step doesn't depend on it.
    """
    begin = case.plan.steps.start_time
    now = model.wrapped(state)
    started = time.process_time()
    for number in range(N_TIMED_STEPS):
        now = runge_kutta_step(model.rates, now, begin + number * step, step)
    seconds = time.process_time() - started
    return seconds / N_TIMED_STEPS * (case.plan.recorded_time / counted)
