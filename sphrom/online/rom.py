"""Stage `rom`: reduced runs, on moving particles (Alg. 3.4-3.5) or on the reference points.

Those on particles are trajectories of the same schema as the full ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter
from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import UnstableError
from sphrom.online import reference_runs
from sphrom.reduction.online import ParticleModel, automatic_memory_length
from sphrom.reduction.particle_run import SteppedModel, with_closure
from sphrom.reduction.trial_basis import (
    mean_density_fluctuation,
    project,
)
from sphrom.setup import assembly
from sphrom.setup.check import require_room
from sphrom.setup.context import StageContext
from sphrom.sph.time_loop import Steps, integrate
from sphrom.store.checkpoints import Checkpoints, last_good, remove_checkpoints
from sphrom.store.splines import read_modes
from sphrom.store.start import start
from sphrom.store.trajectory import TrajectoryWriter
from sphrom.store.workspace import Target, Workspace

Array = NDArray[np.float64]


def run(context: StageContext) -> None:
    """Run every reduced model of the case at the chosen parameter points.

    Raises
    ------
    UnstableError
        After all of them have run, when one diverged; its trajectory says so.
    """
    workspace = Workspace(context)
    require_room(context.case, workspace.out, context.only, "rom")
    unstable = []
    runs = [(m, p) for m in context.case.rom for p in context.chosen(context.case.rom_points(m))]
    if not runs:
        context.report.info("no reduced model to run")
    for model, point in runs:
        target = ensure_run(workspace, model, point)
        with workspace.open(target) as trajectory:
            if trajectory.text("status") != "complete":
                detail = trajectory.text("status_detail") + last_good(workspace, target)
                unstable.append(f"{model.name}, {point.label}: {detail}")
                continue
        remove_checkpoints(workspace, target)
    if unstable:
        raise UnstableError("\n".join(unstable))


def ensure_run(workspace: Workspace, model: ReducedModelSection, point: ParameterPoint) -> Target:
    """Run a reduced model at a parameter point if that is yet to be done."""
    target = workspace.reduced_run(model, point)
    if workspace.wanted(target):
        run_point = _run_point if model.on_particles else reference_runs.run_point
        run_point(workspace, model, point)
    return target


def build_model(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint
) -> tuple[ParticleModel, Array]:
    """Return a reduced model at a parameter point, and its state at the start.

    The initial condition is the full run's, the scene's or the end of the spin-up, mapped onto the
    reference space and projected.
    """
    case = workspace.case
    name = case.basis_for(model, point)
    basis, splines = read_modes(workspace, name, model.n_modes)
    reduced = ParticleModel(
        assembly.functional(case, point),
        splines,
        basis.inner_product,
        n_modes=basis.n_modes,
        advection=model.advection,
        separate_mean=basis.separate_mean,
    )
    with workspace.open(workspace.basis()) as artifact:
        points = artifact.read("reference_position")
    begin = start(workspace, case.start_point(point))
    density, velocity = assembly.map_onto(case, points)(
        begin.position, begin.density_fluctuation, begin.velocity
    )
    state = reduced.initial_state(
        project(basis, density, velocity),
        begin.position,
        float(mean_density_fluctuation(basis, density)),
    )
    return reduced, state


def _with_closure(
    workspace: Workspace,
    model: ReducedModelSection,
    reduced: ParticleModel,
    state: Array,
    time: float,
    artifact: ArtifactWriter,
) -> ParticleModel:
    """Return the model with the closure that the case asks for."""
    if model.projection == "galerkin":
        return reduced
    memory = (
        automatic_memory_length(reduced, state, time)
        if model.memory_length == "auto"
        else model.memory_length
    )
    artifact.annotate("memory_length", memory)
    workspace.context.report.info(f"{model.name}: memory length {memory:.3g} s")
    return with_closure(reduced, memory, model.jacobian_step)


def _run_point(workspace: Workspace, model: ReducedModelSection, point: ParameterPoint) -> None:
    case = workspace.case
    plan = step_plan(case)
    time_step = assembly.reduced_time_step(model, plan.time_step)
    every = round(plan.snapshot_interval / time_step)
    n_steps = (plan.n_snapshots - 1) * every
    steps = Steps(time_step, n_steps, every, watch_every=every, start_time=plan.start_time)
    workspace.require(workspace.basis())
    workspace.require(workspace.splines())
    reduced, state = build_model(workspace, model, point)
    target = workspace.reduced_run(model, point)
    with workspace.create(target, assembly.run_attributes(case, point, time_step)) as artifact:
        checkpoints = Checkpoints(workspace, target, artifact)
        trajectory = TrajectoryWriter(
            artifact,
            plan.n_snapshots,
            reduced.position(state).shape[1],
            case.sound_speed,
            reduced.n_modes,
            separate_mean=reduced.separate_mean,
            walls=None if reduced.functional.ghosts is None else reduced.functional.ghosts.walls,
        )
        with checkpoints.progress(f"{model.name}, {point.label}", n_steps) as advance:
            try:
                closed = _with_closure(workspace, model, reduced, state, steps.start_time, artifact)
            except (np.linalg.LinAlgError, ValueError, UnstableError) as error:
                failure: UnstableError | None = UnstableError(f"unstable at the start: {error}")
                trajectory.finish(failure, 0.0)
            else:
                failure = integrate(
                    SteppedModel(closed),
                    state,
                    steps,
                    case.fluid.reference_density,
                    trajectory,
                    advance,
                    checkpoints,
                )
    if failure is not None:
        workspace.context.report.warn(f"{model.name}, {point.label}: {failure}")
