"""Stage `rom`: reduced runs (Alg. 3.4-3.5), trajectories of the same schema as the full ones."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import ReducedModelSection
from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.errors import UnstableError
from sphrom.reduction.online import ParticleModel, automatic_memory_length
from sphrom.reduction.projection import AdjointPetrovGalerkin
from sphrom.reduction.trial_basis import TrialBasis, kept_modes, project, truncate
from sphrom.stages import assembly
from sphrom.stages.context import StageContext
from sphrom.stages.fit_psi import read_splines, select
from sphrom.stages.fom import initial_positions
from sphrom.stages.pod import read_basis
from sphrom.stages.trajectory import TrajectoryWriter, check_state, watched_step
from sphrom.stages.workspace import Workspace

Array = NDArray[np.float64]


def run(context: StageContext) -> None:
    """Run every reduced model of the case at the chosen parameter points.

    Raises
    ------
    UnstableError
        After all of them have run, when one diverged; its trajectory says so.
    """
    workspace = Workspace(context)
    unstable = []
    runs = [(m, p) for m in context.case.rom for p in context.chosen(context.case.rom_points(m))]
    if not runs:
        context.report.info("no reduced model to run")
    for model, point in runs:
        target = workspace.reduced_run(model, point)
        if workspace.wanted(target):
            _run_point(workspace, model, point)
        with workspace.open(target) as trajectory:
            if trajectory.text("status") != "complete":
                detail = trajectory.text("status_detail")
                unstable.append(f"{model.name}, {point.label}: {detail}")
    if unstable:
        raise UnstableError("\n".join(unstable))


def build_model(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint, position: Array
) -> tuple[ParticleModel, Array]:
    """Return a reduced model at a parameter point, and its state at the start.

    The initial condition is the scene's, mapped onto the reference space and projected.
    """
    case = workspace.case
    whole = read_basis(workspace, model.basis)
    basis = truncate(whole, model.n_modes)
    splines = select(
        read_splines(workspace, model.basis),
        spline_columns(whole, kept_modes(whole, model.n_modes)),
    )
    reduced = ParticleModel(
        assembly.functional(case, point),
        splines,
        basis.inner_product,
        n_modes=basis.n_modes,
        advection=model.advection,
    )
    with workspace.open(workspace.basis()) as artifact:
        points = artifact.read("reference_position")
    fields = assembly.map_onto(case, points)(
        position, *assembly.initial_fields(case, point, position)
    )
    return reduced, reduced.initial_state(project(basis, *fields), position)


def spline_columns(basis: TrialBasis, modes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the columns of splines that belong to some modes, and to the mean of the basis."""
    if basis.offset is not None:
        modes = np.append(modes, basis.n_modes)
    return (3 * modes[:, None] + np.arange(3)).ravel()


def _with_closure(
    workspace: Workspace, model: ReducedModelSection, reduced: ParticleModel, state: Array
) -> ParticleModel:
    """Return the model with the closure that the case asks for."""
    if model.projection == "galerkin":
        return reduced
    memory = (
        automatic_memory_length(reduced, state)
        if model.memory_length == "auto"
        else model.memory_length
    )
    workspace.context.report.info(f"{model.name}: memory length {memory:.3g} s")
    closure = AdjointPetrovGalerkin(memory, model.jacobian_step)
    return ParticleModel(
        reduced.functional,
        reduced.modes,
        reduced.product,
        n_modes=reduced.n_modes,
        advection=reduced.advection,
        closure=closure,
    )


def _run_point(workspace: Workspace, model: ReducedModelSection, point: ParameterPoint) -> None:
    case = workspace.case
    plan = step_plan(case)
    time_step = assembly.reduced_time_step(model, plan.time_step)
    every = round(plan.snapshot_interval / time_step)
    n_steps = (plan.n_snapshots - 1) * every
    workspace.require(workspace.basis())
    workspace.require(workspace.splines())
    position = initial_positions(workspace)
    reduced, state = build_model(workspace, model, point, position)
    attributes = assembly.run_attributes(case, point, time_step)
    failure: UnstableError | None = None
    with (
        workspace.create(workspace.reduced_run(model, point), attributes) as artifact,
        workspace.context.report.progress(f"{model.name}, {point.label}", n_steps) as advance,
    ):
        reduced = _with_closure(workspace, model, reduced, state)
        if reduced.closure is not None:
            artifact.annotate("memory_length", reduced.closure.memory_length)
        trajectory = TrajectoryWriter(
            artifact, plan.n_snapshots, len(position), case.sound_speed, reduced.n_modes
        )
        started = time.perf_counter()
        try:
            for step in range(n_steps + 1):
                if step > 0:
                    state = watched_step(reduced, state, time_step, step)
                    advance(1)
                if step % every == 0:
                    _keep(case.fluid.reference_density, reduced, state, trajectory, step, time_step)
        except UnstableError as error:
            failure = error
        trajectory.finish(failure, time.perf_counter() - started)
    if failure is not None:
        workspace.context.report.warn(f"{model.name}, {point.label}: {failure}")


def _keep(
    reference_density: float,
    model: ParticleModel,
    state: Array,
    trajectory: TrajectoryWriter,
    step: int,
    time_step: float,
) -> None:
    """Rebuild the fields, check them, and write a snapshot."""
    fields = model.fields(state)
    position = model.functional.domain.wrap(model.position(state).T).T
    full = np.vstack((position, fields.density_fluctuation, fields.velocity))
    check_state(full, reference_density, step, step * time_step)
    trajectory.append(
        step * time_step,
        step,
        position,
        fields.density_fluctuation,
        fields.velocity,
        model.coordinates(state),
    )
