"""What a case costs and how near it is to its limits, told before anything runs."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.errors import ResourceError
from sphrom.sph.fluid import step_limits
from sphrom.stages import assembly
from sphrom.stages.context import Reporter, StageContext
from sphrom.stages.machine import physical_memory

BYTES = 8
STATE_ARRAYS = 60
"""Arrays of n_particles numbers that are alive at once in a run, sources and images included."""
TRAJECTORY_ARRAYS = 6
"""Position, velocity, density fluctuation and pressure."""
MAPPED_ARRAYS = 3


@dataclass(frozen=True)
class Cost:
    """What the stages of a case need, in bytes."""

    n_particles: int
    memory: int
    disk: int


def run(context: StageContext) -> None:
    """Print what a case costs, and its margins (`sphrom case check`)."""
    case = context.case
    for point in case.points:
        describe_run(case, point, context.report)
    describe_cost(case, context.report)


def describe_run(case: Case, point: ParameterPoint, report: Reporter) -> None:
    """Print the numbers of one full run."""
    plan = step_plan(case)
    discretization = assembly.discretization(case)
    fluid = assembly.fluid(case, point)
    limits = step_limits(fluid, discretization)
    cost = estimate(case)
    acoustic = plan.time_step / limits.acoustic
    viscous = plan.time_step / limits.viscous
    report.info(
        f"{point.label}: {cost.n_particles} particles, {discretization.n_neighbours:.0f} "
        f"neighbours each, c0 = {fluid.sound_speed:g} m/s, nu = {fluid.kinematic_viscosity:.4g} "
        f"m2/s; {plan.n_steps} steps of {plan.time_step:.4g} s, {acoustic:.0%} of the acoustic "
        f"limit and {viscous:.0%} of the viscous one; {plan.n_snapshots} snapshots"
    )


def describe_cost(case: Case, report: Reporter) -> None:
    """Print what all stages of a case need."""
    cost = estimate(case)
    reduced = sum(len(case.rom_points(model)) for model in case.rom)
    report.info(
        f"{len(case.points)} full runs and {reduced} reduced runs: about {_size(cost.memory)} of "
        f"memory, {_size(cost.disk)} on disk"
    )


def estimate(case: Case) -> Cost:
    """Return what the stages of a case need."""
    n_particles = case.discretization.resolution**2
    n_snapshots = step_plan(case).n_snapshots
    field = BYTES * n_particles
    runs = len(case.points) + sum(len(case.rom_points(model)) for model in case.rom)
    trajectories = runs * n_snapshots * TRAJECTORY_ARRAYS * field
    mapped = len(case.points) * n_snapshots * MAPPED_ARRAYS * field
    modes = sum(3 * case.n_modes * field for _ in case.bases)
    # Splines keep a weight for every point of a cell and its neighbours.
    splines = 9 * modes
    basis_factor = 3 * BYTES * (len(case.train_points) * n_snapshots) ** 2
    return Cost(
        n_particles=n_particles,
        memory=STATE_ARRAYS * field + modes + splines + basis_factor,
        disk=trajectories + mapped + modes + splines,
    )


def require_room(case: Case, out: Path) -> None:
    """Raise ResourceError when a case would not fit this machine's memory or disk."""
    cost = estimate(case)
    memory = physical_memory()
    if cost.memory > memory:
        raise ResourceError(
            f"the case needs about {_size(cost.memory)} of memory, this machine has "
            f"{_size(memory)}: lower discretization.resolution"
        )
    folder = out
    while not folder.exists():
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    written = sum(f.stat().st_size for f in out.glob("*.h5")) if out.is_dir() else 0
    if cost.disk - written > free:
        raise ResourceError(
            f"the case writes about {_size(cost.disk)}, the disk of {out} has {_size(free)} free: "
            "raise snapshots.every, or choose another disk with `--out`"
        )


def _size(n_bytes: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if n_bytes < 1000.0:
            return f"{n_bytes:.3g} {unit}"
        n_bytes /= 1000.0
    return f"{n_bytes:.3g} TB"
