"""Stage `fom`: full-order runs, one trajectory for each parameter point (Eq. 2.17-2.18)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.errors import UnstableError
from sphrom.sph.functional import Functional
from sphrom.sph.packing import lattice, pack
from sphrom.stages import assembly
from sphrom.stages.check import describe_cost, describe_run, require_room
from sphrom.stages.context import StageContext
from sphrom.stages.trajectory import Snapshot, Steps, TrajectoryWriter, integrate
from sphrom.stages.workspace import Workspace

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
    position = _packed_positions(workspace)
    for point in context.chosen(context.case.points):
        target = workspace.full_run(point)
        if workspace.wanted(target):
            describe_run(context.case, point, context.report)
            _run_point(workspace, point, position)
        with workspace.open(target) as trajectory:
            if trajectory.text("status") != "complete":
                raise UnstableError(f"{point.label}: {trajectory.text('status_detail')}")


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


def _packed_positions(workspace: Workspace) -> Array:
    """Return where particles start, packing them if that is yet to be done."""
    target = workspace.packing()
    packed = workspace.case.discretization.initial_particles == "packed"
    if packed and workspace.reason_to_make(target) is not None and workspace.wanted(target):
        _pack(workspace)
    return initial_positions(workspace)


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


class FullModel:
    """The full model as the time loop sees it; states are (5, n_particles)."""

    def __init__(self, functional: Functional) -> None:
        self._functional = functional

    def rates(self, state: Array) -> Array:
        """Return the rates of a state (Eq. 2.17)."""
        return self._functional(state)

    def wrapped(self, state: Array) -> Array:
        """Return the state with its particles in the box, and forget their neighbours."""
        self._functional.neighbourhood.forget()
        return np.vstack((self._functional.domain.wrap(state[:2].T).T, state[2:]))

    def snapshot(self, state: Array) -> Snapshot:
        """Return the fields of a state."""
        return Snapshot(state[:2], state[2], state[3:])


def _run_point(workspace: Workspace, point: ParameterPoint, start: Array) -> None:
    case = workspace.case
    plan = step_plan(case)
    fluctuation, velocity = assembly.initial_fields(case, point, start)
    with (
        workspace.create(
            workspace.full_run(point), assembly.run_attributes(case, point, plan.time_step)
        ) as artifact,
        workspace.context.report.progress(f"full run, {point.label}", plan.n_steps) as advance,
    ):
        integrate(
            FullModel(assembly.functional(case, point)),
            np.vstack((start.T, fluctuation, velocity.T)),
            Steps(plan.time_step, plan.n_steps, plan.every, watch_every=1),
            case.fluid.reference_density,
            TrajectoryWriter(artifact, plan.n_snapshots, len(start), case.sound_speed),
            advance,
        )
