"""Reduced runs on moving particles (Alg. 3.4-3.5), with trajectories like those of full runs."""

from __future__ import annotations

import numpy as np

from sphrom.arrays import Array
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import UnstableError
from sphrom.models.reference.stored import read_modes, read_points
from sphrom.models.stable_ranges import against
from sphrom.models.starts import start
from sphrom.reduction.particle_model import ParticleModel, reduced_jacobian
from sphrom.reduction.trial_basis import mean_density_fluctuation, project
from sphrom.setup import assembly, particles
from sphrom.setup.assembly import memory_length_of
from sphrom.setup.particles import MeasuredParticles
from sphrom.sph.time_loop import TimeSteps
from sphrom.store.checkpoints import Checkpoints, integrate
from sphrom.store.trajectory import TrajectoryWriter
from sphrom.store.workspace import Workspace

LONGEST_STEP = 4.0
"""Largest accurate step of models on particles relative to the full model's
(`docs/stability.md`)."""


def build_model(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint
) -> tuple[ParticleModel, Array]:
    """Return a reduced model at a parameter point, without its closure, and its initial state.

    The initial condition is that of the full run, mapped onto the reference space and projected.
    """
    case = workspace.case
    name = case.plan.basis_for(model, point)
    basis, splines = read_modes(workspace, name, model.size)
    reduced = ParticleModel(
        particles.functional(case, point),
        splines,
        basis.inner_product,
        advection=model.advection,
        separate_mean=basis.separate_mean,
    )
    points = read_points(workspace)
    begin = start(workspace, case.plan.start_point(point))
    density, velocity = particles.map_onto(case, points)(
        begin.position, begin.density_fluctuation, begin.velocity
    )
    state = reduced.initial_state(
        project(basis, density, velocity),
        begin.position,
        float(mean_density_fluctuation(basis, density)),
    )
    return reduced, state


def close(
    case: Case, model: ReducedModelSection, reduced: ParticleModel, state: Array, time: float
) -> None:
    """Set up the closure of a model, if the case has one, at a state and time [s]."""
    if model.has_memory:
        reduced.memory_length = memory_length_of(
            case, model, lambda: reduced_jacobian(reduced, state, time)
        )


def doubts_of_step(factor: float) -> list[str]:
    """Return doubts about steps that are `factor` times as long as the full model's."""
    if factor <= LONGEST_STEP:
        return []
    return [
        f"steps {factor:.3g} times as long as the full model's lose sound, and with it pressure"
    ]


def run_point(workspace: Workspace, model: ReducedModelSection, point: ParameterPoint) -> None:
    """Run a model on particles at a parameter point."""
    case = workspace.case
    plan = case.plan.steps
    time_step = plan.time_step if isinstance(model.time_step, str) else model.time_step
    every = round(plan.snapshot_interval / time_step)
    n_steps = (plan.n_snapshots - 1) * every
    steps = TimeSteps(time_step, n_steps, every, plan.start_time, check_every=every)
    workspace.require(workspace.basis())
    workspace.require(workspace.splines())
    for text in (*against(workspace, model, point), *doubts_of_step(time_step / plan.time_step)):
        workspace.context.report.warn(f"{model.name}, {point.label}: {text}")
    reduced, state = build_model(workspace, model, point)
    target = workspace.reduced_run(model, point)
    with workspace.create(target, assembly.run_attributes(case, point, time_step)) as artifact:
        checkpoints = Checkpoints(workspace, target, artifact)
        ghosts = reduced.functional.ghosts
        trajectory = TrajectoryWriter(
            artifact,
            plan.n_snapshots,
            reduced.position(state).shape[1],
            case.plan.sound_speed,
            reduced.n_modes,
            separate_mean=reduced.separate_mean,
            walls=None if ghosts is None else ghosts.walls,
            forces=particles.wall_forces(case, point, reduced.functional),
            fields=MeasuredParticles.of(case, point),
        )
        with checkpoints.progress(f"{model.name}, {point.label}", n_steps) as advance:
            try:
                close(case, model, reduced, state, steps.start_time)
            except (np.linalg.LinAlgError, ValueError, UnstableError) as error:
                failure: UnstableError | None = UnstableError(f"unstable at the start: {error}")
                trajectory.finish(failure, 0.0)
            else:
                if (length := reduced.memory_length) is not None:
                    artifact.annotate("memory_length", length)
                    workspace.context.report.info(f"{model.name}: memory length {length:.3g} s")
                density = case.fluid.reference_density
                failure = integrate(
                    reduced, state, steps, density, trajectory, advance, checkpoints
                )
    if failure is not None:
        workspace.context.report.warn(f"{model.name}, {point.label}: {failure}")
