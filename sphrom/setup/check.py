"""What a case costs and how near it is to its limits, told before anything runs."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path

from sphrom.case.geometry import n_ghosts, n_particles
from sphrom.case.hints import few_snapshots, slow_sweep, sweep_beyond_training
from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import sweep_model, sweep_points
from sphrom.errors import ResourceError
from sphrom.kernels import SUPPORT_RATIO
from sphrom.machine import physical_ram
from sphrom.setup import assembly
from sphrom.setup.context import Reporter, StageContext
from sphrom.setup.cost import Cost, estimate, estimate_stage
from sphrom.sph.fluid import step_limits
from sphrom.text import counted, duration

REMEDIES = {
    "fom": "lower discretization.resolution",
    "map": "lower discretization.resolution",
    "pod": "raise snapshots.every, or lower discretization.resolution or basis.n_modes",
    "fit-psi": "lower discretization.resolution, basis.n_modes or psi.cell_width_ratio",
    "operators": "lower discretization.resolution, basis.n_modes, or the n_modes of models with "
    "projection: apg",
    "rom": "lower discretization.resolution or basis.n_modes",
    "compare": "lower compare.grid or compare.line_points, or raise snapshots.every",
}
"""What makes the memory of a stage less."""
FILES = {
    "fom": ("packing.h5", "spin-up-*.h5", "fom-*.h5"),
    "map": ("map-*.h5",),
    "pod": ("pod.h5",),
    "fit-psi": ("psi.h5",),
    "operators": ("operators.h5",),
    "rom": ("rom-*.h5",),
    "compare": ("compare.h5",),
}
"""What each stage writes."""


def run(context: StageContext) -> None:
    """Print what a case costs, and its margins (`sphrom case check`).

    Raises ResourceError when it would not fit this machine.
    """
    case = context.case
    for point in case.points:
        describe_run(case, point, context.report)
    _describe_shape(case, context.report)
    for warning in few_snapshots(case):
        context.report.warn(warning)
    describe_cost(case, context.report)
    _describe_sweep(case, context.report)
    require_room(case, context.out)
    _describe_time(case, context.report)


def describe_run(case: Case, point: ParameterPoint, report: Reporter) -> None:
    """Print the numbers of one full run."""
    plan = step_plan(case)
    discretization = assembly.discretization(case)
    fluid, n_ghosts_ = assembly.fluid(case, point), n_ghosts(case)
    ghosts = f" and {n_ghosts_} ghosts" if n_ghosts_ else ""
    steps = counted(plan.n_steps, "step")
    if plan.n_spin_up_steps:
        steps = f"{counted(plan.n_spin_up_steps, 'step')} to spin up and {steps} to record,"
    report.info(
        f"{point.label}: {n_particles(case)} particles{ghosts}, {discretization.n_neighbours:.0f} "
        f"neighbours each, c0 = {fluid.sound_speed:g} m/s, nu = {fluid.kinematic_viscosity:.4g} "
        f"m2/s; {steps} of {plan.time_step:.4g} s, {_margins(case, point)}; "
        f"{counted(plan.n_snapshots, 'snapshot')}"
    )


def _margins(case: Case, point: ParameterPoint) -> str:
    """Return how near the time step is to its limits, in words."""
    fluid, discretization = assembly.fluid(case, point), assembly.discretization(case)
    walls = case.scene.domain.has_walls
    limits = step_limits(fluid, discretization, case.largest_body_force, walls)
    step = step_plan(case).time_step
    told = [
        f"{_percent(step / limits.acoustic)} of the acoustic limit",
        f"{_percent(step / limits.viscous)} of the viscous one",
    ]
    if math.isfinite(limits.body_force):
        told.append(f"{_percent(step / limits.body_force)} of the body force's")
    return ", ".join(told[:-1]) + f" and {told[-1]}"


def _percent(share: float) -> str:
    return "less than 1%" if share < 0.01 else f"{share:.0%}"


def _describe_shape(case: Case, report: Reporter) -> None:
    """Print the area of the fluid, and how many supports its narrowest places are wide."""
    domain, support = case.scene.domain, SUPPORT_RATIO * case.smoothing_length
    widths = {
        "narrowest gap" if domain.has_walls else "shortest period": domain.narrowest_gap,
        "thinnest solid": domain.thinnest_solid,
    }
    told = [
        f"{name} {width:.3g} m, {width / support:.3g} times the support's radius"
        for name, width in widths.items()
        if math.isfinite(width)
    ]
    report.info("; ".join((f"the fluid's area is {domain.area:.4g} m2", *told)))


def _describe_time(case: Case, report: Reporter) -> None:
    """Print how long the stages would take, from a few steps of the first full run."""
    # To take some steps loads the kernels of SPH.
    from sphrom.setup.times import seconds_per_step, sweep_seconds, wall_times

    step = seconds_per_step(case)
    if step is None:
        return
    times = wall_times(case, step)
    runs = counted(len(case.points), "full run")
    report.info(
        f"{runs}: about {duration(times['fom'])} on this machine as it is now, {duration(step)} "
        "a step"
    )
    later = ", ".join(f"{name} {duration(times[name])}" for name in times if name != "fom")
    report.info(
        f"then, within a factor of two or so: {later}; all of `sphrom run` about "
        f"{duration(sum(times.values()))}"
    )
    if sweep_points(case):
        report.info(f"the sweep: about {duration(sweep_seconds(case, step))} of one core")


def describe_cost(case: Case, report: Reporter) -> None:
    """Print what all stages of a case need."""
    cost = estimate(case)
    reduced = sum(len(case.rom_points(model)) for model in case.rom)
    report.info(
        f"{counted(len(case.points), 'full run')} and {counted(reduced, 'reduced run')}: about "
        f"{_size(cost.ram)} of memory, which {cost.largest} needs most of, {_size(cost.disk)} "
        "on disk"
    )


def _describe_sweep(case: Case, report: Reporter) -> None:
    """Print what `sphrom sweep` would run, if the case says so."""
    if points := sweep_points(case):
        model = sweep_model(case)
        what = "the full model" if model is None else model.name
        if (advice := slow_sweep(case)) is not None:
            report.info(advice)
        report.info(
            f"a sweep of {what}: {counted(len(points), 'run')}, from {min(points).label} to "
            f"{max(points).label}"
        )
        if (warning := sweep_beyond_training(case)) is not None:
            report.warn(warning)


def require_room(
    case: Case,
    out: Path,
    points: Sequence[ParameterPoint] | None = None,
    stage: str | None = None,
) -> None:
    """Raise ResourceError when a case would not fit this machine's memory or disk.

    All stages are judged, or `stage` alone; at some parameter `points`, it is the full runs there
    unless another stage is named. What is there already needs no room on the disk again.
    """
    if points is not None and set(points) >= set(case.points):
        points = None
    if stage is None and points is not None:
        stage = "fom"
    cost = estimate(case) if stage is None else Cost({stage: estimate_stage(case, stage, points)})
    ram = physical_ram()
    if cost.ram > ram:
        raise ResourceError(
            f"the case needs about {_size(cost.ram)} of memory in {cost.largest}, this machine "
            f"has {_size(ram)}: {REMEDIES[cost.largest]}"
        )
    missing = {name: need.disk - _written(out, name, points) for name, need in cost.stages.items()}
    needed = sum(max(0, size) for size in missing.values())
    # Checkpoints come on top while a run lasts; of a run that goes on some are there already.
    passing = max((cost.stages[name].passing for name in missing if missing[name] > 0), default=0)
    needed += max(0, passing - _size_of(out.glob("*.h5.*")))
    # The folder may not be there yet.
    free = shutil.disk_usage(next(f for f in (out, *out.parents) if f.exists())).free
    if needed > free:
        raise ResourceError(
            f"the case writes about {_size(needed)}, the disk of {out} has {_size(free)} free: "
            "raise snapshots.every, or choose another disk with `--out`"
        )


def _written(out: Path, stage: str, points: Sequence[ParameterPoint] | None) -> int:
    """Return the size of what a stage has written before."""
    ends = [""] if points is None else [point.file_label for point in points]
    patterns = {name.replace("*", f"*{end}") for name in FILES[stage] for end in ends}
    found = (path for pattern in patterns for path in out.glob(pattern))
    return _size_of(found)


def _size_of(paths: Iterable[Path]) -> int:
    return sum(path.stat().st_size for path in paths if path.is_file())


def _size(n_bytes: float) -> str:
    for unit in ("B", "kB", "MB", "GB"):
        if n_bytes < 1000.0:
            return f"{n_bytes:.3g} {unit}"
        n_bytes /= 1000.0
    return f"{n_bytes:.3g} TB"
