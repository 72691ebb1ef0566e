"""Stage `fom`: full-order runs, one trajectory for each parameter point (Eq. 2.17-2.18)."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.errors import UnstableError
from sphrom.sph.packing import lattice, pack
from sphrom.stages import assembly
from sphrom.stages.check import describe_cost, describe_run, require_room
from sphrom.stages.context import StageContext
from sphrom.stages.trajectory import TrajectoryWriter, check_state, watched_step
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
    require_room(context.case, workspace.out)
    describe_cost(context.case, context.report)
    position = initial_positions(workspace)
    for point in context.chosen(context.case.points):
        target = workspace.full_run(point)
        if workspace.wanted(target):
            describe_run(context.case, point, context.report)
            _run_point(workspace, point, position)
        with workspace.open(target) as trajectory:
            if trajectory.text("status") != "complete":
                raise UnstableError(f"{point.label}: {trajectory.text('status_detail')}")


def initial_positions(workspace: Workspace) -> Array:
    """Return where particles start (n_particles, 2) [m], packing them if that is yet to be done."""
    case = workspace.case
    section = case.discretization
    domain = assembly.domain(case)
    if section.initial_particles == "lattice":
        return lattice(domain, case.particle_spacing)
    target = workspace.packing()
    if workspace.reason_to_make(target) is not None and workspace.wanted(target):
        _pack(workspace)
    with workspace.open(target) as artifact:
        return np.asarray(artifact.read("position"))


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


def _run_point(workspace: Workspace, point: ParameterPoint, start: Array) -> None:
    case = workspace.case
    plan = step_plan(case)
    functional = assembly.functional(case, point)
    fluctuation, velocity = assembly.initial_fields(case, point, start)
    state = np.vstack((start.T, fluctuation, velocity.T))
    attributes = assembly.run_attributes(case, point, plan.time_step)
    failure: UnstableError | None = None
    with (
        workspace.create(workspace.full_run(point), attributes) as artifact,
        workspace.context.report.progress(f"full run, {point.label}", plan.n_steps) as advance,
    ):
        trajectory = TrajectoryWriter(artifact, plan.n_snapshots, start.shape[0], case.sound_speed)
        started = time.perf_counter()
        try:
            for step in range(plan.n_steps + 1):
                if step > 0:
                    state = watched_step(functional, state, plan.time_step, step)
                    check_state(state, case.fluid.reference_density, step, step * plan.time_step)
                    advance(1)
                if step % plan.every == 0:
                    # A run that goes on from a snapshot must see the same neighbours.
                    state[:2] = functional.domain.wrap(state[:2].T).T
                    functional.neighbourhood.forget()
                    trajectory.append(step * plan.time_step, step, state[:2], state[2], state[3:])
        except UnstableError as error:
            failure = error
        trajectory.finish(failure, time.perf_counter() - started)
