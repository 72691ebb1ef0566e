"""Stage `fom`: full-order runs, one trajectory for each parameter point (Eq. 2.17-2.18).

A run may have a spin-up, in which the flow develops and nothing is recorded. Its last state is an
artifact of its own, from which the recorded part can be run again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.errors import UnstableError
from sphrom.sph.domain import Domain
from sphrom.sph.functional import Functional
from sphrom.sph.neighbourhood import Neighbourhood
from sphrom.sph.packing import lattice, pack
from sphrom.stages import assembly
from sphrom.stages.check import describe_cost, describe_run, require_room
from sphrom.stages.checkpoints import Checkpoints, last_good, remove_checkpoints
from sphrom.stages.context import StageContext
from sphrom.stages.trajectory import (
    Clock,
    Snapshot,
    Steps,
    TrajectoryWriter,
    integrate,
    march,
)
from sphrom.stages.workspace import Target, Workspace

Array = NDArray[np.float64]


def run(context: StageContext) -> None:
    """Run the full model at the chosen parameter points.

    Raises
    ------
    UnstableError
        When a run leaves the range of its model; what came before is kept.
    """
    workspace = Workspace(context)
    require_room(context.case, workspace.out, context.only)
    describe_cost(context.case, context.report)
    ensure_packed(workspace)
    for point in context.chosen(context.case.points):
        target = ensure_run(workspace, point)
        with workspace.open(target) as trajectory:
            if trajectory.text("status") != "complete":
                detail = trajectory.text("status_detail") + last_good(workspace, target)
                raise UnstableError(f"{point.label}: {detail}")
        remove_checkpoints(workspace, target)


def ensure_run(workspace: Workspace, point: ParameterPoint) -> Target:
    """Run the full model at a parameter point if that is yet to be done.

    Raises UnstableError when its spin-up is unstable.
    """
    _ensure_spun_up(workspace, point)
    target = workspace.full_run(point)
    if workspace.wanted(target):
        describe_run(workspace.case, point, workspace.context.report)
        _run_point(workspace, point)
    return target


def initial_positions(workspace: Workspace) -> Array:
    """Return where particles start (n_particles, 2) [m].

    Raises
    ------
    ArtifactError
        When they have to be packed first.
    """
    case = workspace.case
    if case.discretization.initial_particles == "lattice":
        return lattice(assembly.domain(case), case.particle_spacing)
    with workspace.open(workspace.packing()) as artifact:
        return np.asarray(artifact.read("position"))


def ensure_packed(workspace: Workspace) -> None:
    """Pack the starting positions if that is yet to be done."""
    target = workspace.packing()
    packed = workspace.case.discretization.initial_particles == "packed"
    if packed and workspace.reason_to_make(target) is not None and workspace.wanted(target):
        _pack(workspace)


def _ensure_spun_up(workspace: Workspace, point: ParameterPoint) -> None:
    """Run the spin-up if there is to be one and it is yet to be done.

    A reduced run needs its end too, so it is made though the full run may be there. With `force` a
    valid one is kept: the recorded part alone is then run again.
    """
    if workspace.case.time.spin_up == 0.0:
        return
    target = workspace.spin_up(point)
    if workspace.reason_to_make(target) is None:
        workspace.context.report.info(f"{target.path.name}: there, and of this case: kept")
    elif workspace.wanted(target):
        _spin_up(workspace, point)
    remove_checkpoints(workspace, target)


def _pack(workspace: Workspace) -> None:
    case = workspace.case
    settings = case.discretization.packing
    attributes = {
        "particle_spacing": case.particle_spacing,
        "smoothing_length": case.smoothing_length,
        "box_length": assembly.domain(case).lengths,
    }
    with (
        workspace.create(workspace.packing(), attributes) as artifact,
        workspace.context.report.progress("packing particles", settings.max_iterations) as advance,
    ):
        packing = pack(
            assembly.domain(case),
            assembly.discretization(case),
            seed=settings.seed,
            perturbation=settings.perturbation,
            tolerance=settings.tolerance,
            max_iterations=settings.max_iterations,
            advance=advance,
        )
        artifact.write("position", packing.position)
        artifact.write("residual", packing.residual)
    workspace.context.report.info(
        f"packed {len(packing.position)} particles: residual {packing.residual[-1]:.2g} after "
        f"{len(packing.residual) - 1} iterations"
    )
    if packing.residual[-1] > settings.tolerance:
        workspace.context.report.warn(
            f"packing stopped at discretization.packing.max_iterations = {settings.max_iterations} "
            f"with a residual above its tolerance of {settings.tolerance:g}"
        )


@dataclass(frozen=True)
class Start:
    """The state that the recorded part of a run starts from."""

    position: Array
    """(n_particles, 2) [m]."""
    density_fluctuation: Array
    """(n_particles,) [kg/m3]."""
    velocity: Array
    """(n_particles, 2) [m/s]."""

    @property
    def state(self) -> Array:
        """The full state (5, n_particles)."""
        return np.vstack((self.position.T, self.density_fluctuation, self.velocity.T))


def start(workspace: Workspace, point: ParameterPoint) -> Start:
    """Return what the recorded part of a run starts from: the scene's state, or the spin-up's end.

    Raises
    ------
    ArtifactError
        When the spin-up, or the packed particles, have to be made first.
    """
    if workspace.case.time.spin_up == 0.0:
        return _scene_start(workspace, point)
    with workspace.open(workspace.spin_up(point)) as artifact:
        return Start(
            artifact.read("position"),
            artifact.read("density_fluctuation"),
            artifact.read("velocity"),
        )


def _scene_start(workspace: Workspace, point: ParameterPoint) -> Start:
    position = initial_positions(workspace)
    return Start(position, *assembly.initial_fields(workspace.case, point, position))


class FullModel:
    """The full model as the time loop sees it; states are (5, n_particles)."""

    def __init__(self, functional: Functional) -> None:
        self._functional = functional

    @property
    def domain(self) -> Domain:
        """Where the fluid is."""
        return self._functional.domain

    @property
    def neighbourhood(self) -> Neighbourhood:
        """The list of neighbours that rates are summed over."""
        return self._functional.neighbourhood

    def rates(self, state: Array, time: float) -> Array:
        """Return the rates of a state (Eq. 2.17)."""
        return self._functional(state, time)

    def position(self, state: Array) -> Array:
        """Return the positions (2, n_particles) [m]."""
        return state[:2]

    def wrapped(self, state: Array) -> Array:
        """Return the state with its particles in the box, and forget their neighbours."""
        self._functional.neighbourhood.forget()
        return np.vstack((self._functional.domain.wrap(state[:2].T).T, state[2:]))

    def snapshot(self, state: Array) -> Snapshot:
        """Return the fields of a state."""
        return Snapshot(state[:2], state[2], state[3:])


def _spin_up(workspace: Workspace, point: ParameterPoint) -> None:
    """Run until the flow is developed, and keep the last state alone."""
    case = workspace.case
    plan = step_plan(case)
    n_steps = plan.n_spin_up_steps
    steps = Steps(plan.time_step, n_steps, every=n_steps, watch_every=1)
    begin = _scene_start(workspace, point)
    target = workspace.spin_up(point)
    clock = Clock()
    with workspace.create(target, assembly.run_attributes(case, point, plan.time_step)) as artifact:
        checkpoints = Checkpoints(workspace, target, artifact)
        model = FullModel(assembly.functional(case, point))
        density = case.fluid.reference_density
        with (
            checkpoints.progress(f"spin-up, {point.label}", n_steps) as advance,
            checkpoints.kept_if_stopped(),
        ):
            end = begin.state if checkpoints.begin is None else checkpoints.begin.state
            try:
                for _, kept in march(
                    model, begin.state, steps, density, clock, advance, checkpoints
                ):
                    end = kept
            except UnstableError as error:
                detail = f"{error}{last_good(workspace, target)}"
                raise UnstableError(f"{point.label}, spin-up: {detail}") from error
        artifact.write("position", end[:2].T)
        artifact.write("density_fluctuation", end[2])
        artifact.write("velocity", end[3:].T)
        artifact.annotate("time", steps.time(n_steps))
        artifact.annotate("timing/integration", clock.seconds)


def _run_point(workspace: Workspace, point: ParameterPoint) -> None:
    case = workspace.case
    plan = step_plan(case)
    begin = start(workspace, point)
    steps = Steps(plan.time_step, plan.n_steps, plan.every, 1, start_time=plan.start_time)
    target = workspace.full_run(point)
    with workspace.create(target, assembly.run_attributes(case, point, plan.time_step)) as artifact:
        checkpoints = Checkpoints(workspace, target, artifact)
        with checkpoints.progress(f"full run, {point.label}", plan.n_steps) as advance:
            integrate(
                FullModel(assembly.functional(case, point)),
                begin.state,
                steps,
                case.fluid.reference_density,
                TrajectoryWriter(
                    artifact,
                    plan.n_snapshots,
                    len(begin.position),
                    case.sound_speed,
                    walls=assembly.walls(case, assembly.scene(case, point)),
                ),
                advance,
                checkpoints,
            )
