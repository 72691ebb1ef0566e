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
from sphrom.reduction.online import ParticleModel, automatic_memory_length
from sphrom.reduction.projection import AdjointPetrovGalerkin
from sphrom.reduction.trial_basis import (
    kept_modes,
    mean_density_fluctuation,
    project,
    truncate,
)
from sphrom.sph.domain import Domain
from sphrom.sph.neighbourhood import Neighbourhood
from sphrom.stages import assembly, reference_runs
from sphrom.stages.check import require_room
from sphrom.stages.checkpoints import Checkpoints, last_good, remove_checkpoints
from sphrom.stages.context import StageContext
from sphrom.stages.fit_psi import read_splines, select, spline_columns
from sphrom.stages.fom import start
from sphrom.stages.pod import read_basis
from sphrom.stages.trajectory import Snapshot, Steps, TrajectoryWriter, integrate
from sphrom.stages.workspace import Target, Workspace

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
        run_point = _run_point if model.frame == "particles" else reference_runs.run_point
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
    whole = read_basis(workspace, name)
    basis = truncate(whole, model.n_modes)
    splines = select(
        read_splines(workspace, name),
        spline_columns(whole, kept_modes(whole, model.n_modes)),
    )
    reduced = ParticleModel(
        assembly.functional(case, point),
        splines,
        basis.inner_product,
        n_modes=basis.n_modes,
        advection=model.advection,
        gauge=basis.gauge,
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
    closure = AdjointPetrovGalerkin(memory, model.jacobian_step)
    return ParticleModel(
        reduced.functional,
        reduced.modes,
        reduced.product,
        n_modes=reduced.n_modes,
        advection=reduced.advection,
        gauge=reduced.gauge,
        closure=closure,
    )


class SteppedModel:
    """A reduced model as the time loop sees it."""

    def __init__(self, model: ParticleModel) -> None:
        self._model = model

    @property
    def domain(self) -> Domain:
        """Where the fluid is."""
        return self._model.functional.domain

    @property
    def neighbourhood(self) -> Neighbourhood:
        """The list of neighbours that rates are summed over."""
        return self._model.functional.neighbourhood

    def position(self, state: Array) -> Array:
        """Return the positions (2, n_particles) [m]."""
        return self._model.position(state)

    def rates(self, state: Array, time: float) -> Array:
        """Return the rates of a state (Eq. 3.21 or 3.22, and 3.23)."""
        return self._model(state, time)

    def wrapped(self, state: Array) -> Array:
        """Return the state with its particles in the box, and forget their neighbours."""
        self._model.functional.neighbourhood.forget()
        position = self._model.functional.domain.wrap(self._model.position(state).T)
        return self._model.initial_state(
            self._model.coordinates(state),
            position,
            self._model.mean_density_fluctuation(state),
        )

    def snapshot(self, state: Array) -> Snapshot:
        """Rebuild the fields of a state."""
        fields = self._model.fields(state)
        return Snapshot(
            self._model.position(state),
            fields.density_fluctuation,
            fields.velocity,
            self._model.coordinates(state),
            self._model.mean_density_fluctuation(state),
        )


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
            gauge=reduced.gauge,
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
