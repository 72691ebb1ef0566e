"""The memory, disk and time that a case needs, estimated before a run (`sphrom case check`).

Memory is that of the most demanding stages, fom, pod and operators, within a factor of about two.
Disk is that of the files that grow with particles and snapshots, within a few per cent.
"""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from sphrom.case.hints import few_snapshots, slow_sweep, sweep_beyond_training
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import sweep_model, sweep_points
from sphrom.console import Reporter
from sphrom.errors import ResourceError
from sphrom.kernels import SUPPORT_RATIO
from sphrom.machine import available_ram, physical_ram
from sphrom.progress import StageTime
from sphrom.reduction.decomposition import (
    BYTES,
    decomposition_bytes,
    smallest_block,
)
from sphrom.setup.context import StageContext
from sphrom.text import counted, data_size, duration

BASELINE = 250_000_000
"""Memory of Python, the libraries, and arrays that do not grow with the case [bytes]."""
RAM_SHARE = 0.4
"""Share of the memory that the decomposition may use before it works block by block."""
MOST_PENDING = 2**26
"""Size of the pending snapshots at which the next checkpoint is written early [bytes]."""
BLOCK = 2**24
"""Numbers in a block of points in the projection of operators."""
STATE_ARRAYS = 60
"""Numbers per particle that a run holds at once, sources and images included."""
MODE_COPIES, PRESSURE_COPIES, SPLINE_COPIES = 3, 10, 10
"""Copies of the modes while operators are made, the size of pressure modes with their gradients and
splines over that of the modes, and the size of polyharmonic splines over theirs.

B-splines take one copy.
"""
SPARSE_NUMBERS = 6
"""Numbers per neighbour in the sums that operators hold: four matrices, each with half an index."""
TENSOR_COPIES = 14
"""Copies of a closure's largest tensor, or of an estimate's factor, while they are made."""
SECONDS_PER_NEIGHBOUR = 3e-8
"""Time per step and neighbour of a particle on one core, measured on the three demo cases."""
GHOST = 4.5
"""The cost of a ghost, including the terms of walls, relative to that of a particle."""
AT_NO_MODE, EACH_MODE = 1.1, (4.5, 0.8)
"""Cost of a Galerkin step relative to a full step: without modes; and of polyharmonic splines at no
mode and for each mode, both divided by the root of the number of neighbours."""
B_SPLINES = (0.92, 0.053)
"""The same cost with B-splines, at no mode and for each. All measured in processor time at 48
neighbours (80x80, lid-driven cavity) and 200 (150x150, Taylor-Green), M = 5 to 30."""
CLOSURE = 1.1
"""The additional cost of a closure: once more the full right-hand side."""
EACH_POINT = 7
"""Approximate number of all pictures of a comparison, for each parameter point."""
LOADING, STARTING, PICTURE = 0.3, 1.3, 0.8
"""Times of loading a stage with runs, the same in processes that start, and of drawing one picture
[s]."""
FAST_RUN = 5e-4
"""Time of a run from operators with five modes [s]."""
TIMED_STEPS = 60
"""Steps of each model in the timings of a comparison."""


@dataclass(frozen=True)
class Need:
    """The memory and the disk space of one stage [bytes]."""

    ram: int
    disk: int = 0
    files: tuple[str, ...] = ()
    """File name patterns of its artifacts."""
    passing: int = 0
    """Disk space for the checkpoints of one run, which are deleted when it ends."""


def needs(case: Case, points: Sequence[ParameterPoint] | None = None) -> dict[str, Need]:
    """Return the needs of the demanding stages; `points` limits the runs to these."""
    plan = case.plan
    at = case.plan.points if points is None else points
    number = plan.n_particles
    n_dim = case.scene.domain.n_dim
    n_snapshots = plan.steps.n_snapshots
    run = STATE_ARRAYS * (number + plan.n_ghosts)
    trajectory = n_snapshots * (2 * (n_dim + 1) * number + 3) + 4 * plan.n_ghosts
    spin_up = (2 * n_dim + 1) * number if plan.steps.n_spin_up_steps else 0
    # Snapshots wait for a checkpoint, which stores them once more, with two states.
    passing = BYTES * (trajectory + (4 + 5 * n_dim) * number)
    waiting = min(MOST_PENDING / BYTES, trajectory)
    written = BYTES * (n_dim * number + (trajectory + spin_up) * len(at))
    files = "packing.h5", "spin-up-*.h5", "fom-*.h5"
    found = {"fom": Need(_ram(run + waiting), written, files, passing)}
    if not case.rom:
        return found
    found["map"] = Need(
        BASELINE, BYTES * number * ((1 + n_dim) * n_snapshots + n_dim) * len(at), ("map-*.h5",)
    )
    modes = sum(plan.basis_size(name) for name in plan.bases) * (1 + n_dim) * number
    kept = modes * (1 + case.basis.lagrangian)
    n_learnt = len(plan.train_points) * n_snapshots
    least = decomposition_bytes(n_learnt, smallest_block(n_learnt))
    # If the limit allows it, all points form one block.
    at_once = min(decomposition_bytes(n_learnt, number), decomposition_ram_limit())
    copies = max(least, at_once) / BYTES + (MODE_COPIES - 1) * modes + kept
    found["pod"] = Need(_ram(copies), BYTES * (kept + 6 * number), ("pod.h5",))
    if plan.reference_bases:
        found["operators"] = Need(_ram(_operators(case)))
    written = 0
    for model in case.rom:
        per_run = 0 if model.from_operators else trajectory
        per_run += number * ((2 + n_dim) * n_snapshots + n_dim) * (model.output == "snapshots")
        written += BYTES * per_run * sum(p in at for p in plan.rom_points(model))
    slow = any(not model.from_operators for model in case.rom)
    found["rom"] = Need(_ram(run * slow), written, ("rom-*.h5",), passing * slow)
    return found


def _ram(numbers: float) -> int:
    return BASELINE + int(BYTES * numbers)


def _operators(case: Case) -> float:
    """Return the size of a basis with copies and splines, sparse sums and tensors, in numbers."""
    plan = case.plan
    most = max(plan.basis_size(name) for name in plan.reference_bases)
    copies = MODE_COPIES + PRESSURE_COPIES + (1 if plan.lattice_splines else SPLINE_COPIES)
    sparse = SPARSE_NUMBERS * plan.n_neighbours * plan.n_particles
    if (n_dim := case.scene.domain.n_dim) > 2:  # all points have one stencil
        sparse = 0.0
    tensors = [n**4 for _, n in plan.memory_models]
    for name in filter(plan.has_error_estimate, plan.reference_bases):
        linear = 1 + plan.basis_size(name)
        driven = case.scene.domain.has_walls + len(plan.driving)
        driven += plan.flow(plan.points[0]).body_force is not None
        tensors.append((linear * (linear + 1) + driven * linear) ** 2)
    largest = TENSOR_COPIES * max(tensors, default=0)
    return copies * (1 + n_dim) * most * plan.n_particles + sparse + BLOCK + largest


def decomposition_ram_limit() -> int:
    """Return the memory [bytes] that a decomposition may use in addition to the modes."""
    return int(RAM_SHARE * physical_ram())


def runs_that_fit(case: Case, stage: str) -> int:
    """Return how many runs of a stage fit this machine's cores and memory at the same time.

    Other processes do not have the functions of a flow, so its runs are made one by one.
    """
    if case.scene.has_functions:
        return 1
    cores = len(os.sched_getaffinity(0))
    ram = available_ram()
    return cores if ram is None else max(1, min(cores, ram // needs(case)[stage].ram))


def full_seconds(case: Case, n_runs: int) -> float:
    """Return the approximate time of full runs on one core [s]."""
    steps = case.plan.steps
    particles = case.plan.n_particles + GHOST * case.plan.n_ghosts
    neighbours = particles * case.plan.n_neighbours
    return SECONDS_PER_NEIGHBOUR * neighbours * (steps.n_steps + steps.n_spin_up_steps) * n_runs


def reduced_steps(case: Case, model: ReducedModelSection) -> float:
    """Return the cost of a run of a model on particles, in steps of the full model."""
    plan = case.plan
    cost = B_SPLINES[0] + B_SPLINES[1] * model.size
    if not plan.lattice_splines:
        at_root = EACH_MODE[0] + EACH_MODE[1] * model.size
        cost = AT_NO_MODE + at_root / plan.n_neighbours**0.5
    cost += CLOSURE if model.has_memory else 0.0
    step = model.time_step if isinstance(model.time_step, float) else plan.steps.time_step
    return cost * plan.steps.n_steps * plan.steps.time_step / step


def run_seconds(case: Case, model: ReducedModelSection | None) -> float:
    """Return the approximate time of one run on one core [s]; None is the full model."""
    if model is not None and model.from_operators:
        return FAST_RUN
    full = full_seconds(case, 1)
    steps = case.plan.steps
    n_steps = steps.n_steps + steps.n_spin_up_steps
    return full if model is None else full / n_steps * reduced_steps(case, model)


def runs_time(
    name: str, seconds: float, workers: int = 1, parts: Mapping[str, float] | None = None
) -> StageTime:
    """Return the time of a stage whose runs take some seconds on one core.

    Its progress is called `name`, or consists of the seconds of `parts`, by name.
    """
    start = LOADING if workers == 1 else STARTING
    shared = seconds / workers
    return StageTime(start + shared, {**(parts or {}), name: shared}, start, workers)


def uncounted_time(seconds: float) -> StageTime:
    """Return the time of a stage in which no progress counts anything."""
    return StageTime(seconds, uncounted=seconds)


def stage_times(context: StageContext) -> dict[str, StageTime]:
    """Return the approximate times of the stages of `run` if no artifacts exist yet.

    Small cases take the time of loading and of many small steps, measured on the demo cases.
    """
    case = context.case
    plan = case.plan
    steps = plan.steps
    n_points = len(context.chosen(plan.points))
    workers = max(1, min(context.workers or 1, n_points))
    full = full_seconds(case, 1)
    step = full / (steps.n_steps + steps.n_spin_up_steps)
    parts = {"spin-up": step * steps.n_spin_up_steps, "full run": step * steps.n_steps}
    mapped = 1.3e-6 * steps.n_snapshots * plan.n_particles
    slow = [model for model in context.chosen_models if not model.from_operators]
    each = {model.name: run_seconds(case, model) for model in slow}
    reduced = sum(each[m.name] * len(context.chosen(plan.rom_points(m))) for m in slow)
    learnt = (len(plan.train_points) * steps.n_snapshots) ** 2 * plan.n_particles
    modes = sum(plan.basis_size(name) for name in plan.reference_bases)
    sample = 0.2 + 2e-3 * steps.n_snapshots
    sampled = {f"sample {name}": sample for name in ("the full run", *each)}
    timed = TIMED_STEPS * (step + sum(each.values()) / steps.n_steps) * bool(case.rom)
    n_pictures = {None: 4, False: 0}.get(case.compare.plots, EACH_POINT * len(plan.points))
    drawn = PICTURE * n_pictures
    compared = len(plan.points) * (1 + len(case.rom)) * sample
    return {
        "fom": runs_time("full runs", n_points * full, workers, parts),
        "map": runs_time("maps", n_points * mapped, workers, {"map": mapped}),
        "pod": uncounted_time(0.1 + 2e-9 * learnt),
        "fit-psi": uncounted_time(0.1),
        "operators": uncounted_time(0.1 + 6e-5 * plan.n_particles * modes),
        "rom": runs_time("reduced runs", reduced, workers, each),
        "compare": StageTime(
            compared + timed + drawn, {**sampled, "timings": timed, "pictures": drawn}
        ),
    }


def require_room(
    case: Case, out: Path, points: Sequence[ParameterPoint] | None = None, stage: str | None = None
) -> None:
    """Raise ResourceError if a case does not fit this machine's memory or disk.

    All stages are checked, or only `stage`. With `points`, it is the full runs there, unless
    another stage is named. Existing files need no additional space.
    """
    if points is not None and set(points) >= set(case.plan.points):
        points = None
    if stage is None and points is not None:
        stage = "fom"
    judged = {name: need for name, need in needs(case, points).items() if stage in (None, name)}
    ram = physical_ram()
    for name, need in judged.items():
        if need.ram > ram:
            raise ResourceError(
                f"the case needs about {data_size(need.ram)} of memory in {name}, this machine has "
                f"{data_size(ram)}: lower discretization.resolution or numbers of modes, or raise "
                "snapshots.every"
            )
    missing = {name: need.disk - _written(out, need, points) for name, need in judged.items()}
    needed = sum(max(0, size) for size in missing.values())
    # During a run checkpoints come on top; a run that is continued already has some.
    passing = max((judged[name].passing for name in missing if missing[name] > 0), default=0)
    needed += max(0, passing - _size_of(out.glob("*.h5.*")))
    # The folder may not exist yet.
    free = shutil.disk_usage(next(f for f in (out, *out.parents) if f.exists())).free
    if needed > free:
        raise ResourceError(
            f"the case writes about {data_size(needed)}, the disk of {out} has {data_size(free)} "
            "free: raise snapshots.every, or choose another disk with `--out`"
        )


def _written(out: Path, need: Need, points: Sequence[ParameterPoint] | None) -> int:
    ends = [""] if points is None else [point.file_label for point in points]
    patterns = {name.replace("*", f"*{end}") for name in need.files for end in ends}
    return _size_of(path for pattern in patterns for path in out.glob(pattern))


def _size_of(paths: Iterable[Path]) -> int:
    return sum(path.stat().st_size for path in paths if path.is_file())


def run(context: StageContext) -> None:
    """Print the cost of a case and its margins (`sphrom case check`).

    Raises ResourceError if it does not fit this machine.
    """
    case = context.case
    plan = case.plan
    report = context.report
    for point in plan.points:
        report.info(described_run(case, point))
    _describe_shape(case, report)
    if (usual := plan.max_speed / case.fluid.mach_number) < plan.sound_speed:
        change = plan.largest_head / plan.sound_speed**2
        cause = max(plan.heads, key=lambda name: plan.heads[name])
        report.info(
            f"c0 is {plan.sound_speed:.4g} m/s, not U_max / Ma = {usual:.4g}: {cause} "
            f"then changes the density by about {change:.0%} at most"
        )
    for warning in () if case.training.ranges else few_snapshots(case):  # train makes more runs
        report.warn(warning)
    describe_cost(case, report)
    seconds = sum(time.seconds for time in stage_times(context).values())
    report.info(f"all stages of `sphrom run`: about {duration(seconds)} on one core")
    _describe_sweep(case, report)
    require_room(case, context.out)


def described_run(case: Case, point: ParameterPoint) -> str:
    """Return the sizes of one full run in words."""
    plan = case.plan
    fluid = plan.fluid(point)
    limits = plan.step_limits(point)
    ghosts = f" and {plan.n_ghosts} ghosts" if plan.n_ghosts else ""
    spin_up = plan.steps.n_spin_up_steps
    step = plan.steps.time_step
    before = f" after {counted(spin_up, 'step')} to spin up" if spin_up else ""
    known = {"acoustic": limits.acoustic, "viscous": limits.viscous}
    of_limits = ", ".join(f"{step / most:.2g} of the {name} limit" for name, most in known.items())
    layer, thin = case.scene.length_scale / math.sqrt(point.reynolds), ""
    no_slip = case.scene.domain.has_walls and not case.scene.free_slip
    if no_slip and layer < plan.particle_spacing:
        thin = f"; no particles resolve layers of L / sqrt(Re) = {layer:.2g} m at walls"
    return (
        f"{point.label}: {plan.n_particles} particles{ghosts}, "
        f"{plan.n_neighbours:.0f} neighbours each, c0 = {fluid.sound_speed:g} m/s, "
        f"nu = {fluid.kinematic_viscosity:.4g} m2/s; {counted(plan.steps.n_steps, 'step')} of "
        f"{step:.4g} s{before}, {of_limits}; {counted(plan.steps.n_snapshots, 'snapshot')}{thin}"
    )


def _describe_shape(case: Case, report: Reporter) -> None:
    """Print the fluid's area or volume, and the width of its narrowest places in support radii."""
    domain = case.scene.domain
    plan = case.plan
    support = SUPPORT_RATIO * plan.smoothing_length
    widths = {
        "narrowest gap" if domain.has_walls else "shortest period": domain.narrowest_gap,
        "thinnest solid": domain.thinnest_solid,
    }
    described = [
        f"{name} {width:.3g} m, {width / support:.3g} times the support's radius"
        for name, width in widths.items()
        if math.isfinite(width)
    ]
    filled = plan.n_particles * plan.particle_spacing**domain.n_dim
    size = filled if case.scene.has_surface or domain.n_dim > 2 else domain.area
    quantity = f"area is {size:.4g} m2" if domain.n_dim == 2 else f"volume is {size:.4g} m3"
    pitches = domain.pitches(plan.particle_spacing)
    along = zip("xyz", pitches, strict=False)
    apart = ", ".join(f"{pitch:.4g} m along {axis}" for axis, pitch in along)
    uneven = [f"particles {apart} apart fit its sides"] * (len(set(pitches)) > 1)
    report.info("; ".join((f"the fluid's {quantity}", *uneven, *described)))


def describe_cost(case: Case, report: Reporter) -> None:
    """Print the number of runs, the memory and disk of all stages, and the time of fom."""
    stages = needs(case)
    n_runs = len(case.plan.points)
    largest = max(stages, key=lambda name: stages[name].ram)
    reduced = sum(len(case.plan.rom_points(model)) for model in case.rom)
    report.info(
        f"{counted(n_runs, 'full run')} and {counted(reduced, 'reduced run')}: about "
        f"{data_size(stages[largest].ram)} of memory at most (in {largest}), "
        f"{data_size(sum(need.disk for need in stages.values()))} on disk; the full "
        f"run{'s' * (n_runs > 1)} about {duration(full_seconds(case, n_runs))} on one core"
    )


def _describe_sweep(case: Case, report: Reporter) -> None:
    """Print the size of the sweep, if the case has one, with advice."""
    if points := sweep_points(case):
        model = sweep_model(case)
        swept = "the full model" if model is None else model.name
        report.info(f"a sweep of {swept}: {counted(len(points), 'run')}")
        if (advice := slow_sweep(case)) is not None:
            report.info(advice)
        for warning in sweep_beyond_training(case):
            report.warn(warning)
