"""The memory, disk and time that a case needs, told before anything runs.

Memory is of the stages that hold most: fom, pod and operators, within a factor of two or so. Disk
is of the files that grow with particles and snapshots, known to some per cent.
"""

from __future__ import annotations

import math
import os
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import ResourceError
from sphrom.machine import available_ram, physical_ram
from sphrom.reduction.decomposition import (
    BYTES,
    N_FIELD_VALUES,
    decomposition_bytes,
    smallest_block,
)

BASELINE = 250_000_000
"""Memory of Python and the libraries, and of arrays that don't grow with the case [bytes]."""
RAM_SHARE = 0.4
"""Share of the memory that the decomposition may use before it goes block by block."""
MOST_PENDING = 2**26
"""Snapshots that wait for the next checkpoint; more of them bring it forward [bytes]."""
BLOCK = 2**24
"""Numbers in the blocks of points that operators are projected by."""
STATE_ARRAYS = 60
"""Numbers a particle that a run holds at once, sources and images included."""
MODE_COPIES, SPLINE_COPIES = 3, 10
"""Copies of the modes while operators are made, and the size of polyharmonic splines over theirs.

B-splines take one copy.
"""
SPARSE_NUMBERS = 6
"""Numbers a neighbour in the sums that operators hold: four matrices, with half an index each."""
TENSOR_COPIES = 14
"""Copies of a closure's largest tensor, or of an estimate's factor, while they are made."""
SECONDS_PER_NEIGHBOUR = 5e-8
"""Time of a step over the particles' neighbours on one core, measured on the three demo cases."""


@dataclass(frozen=True)
class Need:
    """The memory of one stage, and the disk that its files fill [bytes]."""

    ram: int
    disk: int
    files: tuple[str, ...]
    """Patterns of the names of its files."""
    remedy: str = "lower discretization.resolution"
    """What makes its memory less."""
    passing: int = 0
    """Disk for the checkpoints of one run, which are deleted when it ends."""


def needs(case: Case, points: Sequence[ParameterPoint] | None = None) -> dict[str, Need]:
    """Return the needs of the stages that need much; `points` limits runs to these."""
    plan, at = case.plan, case.plan.points if points is None else points
    number, n_snapshots = plan.n_particles, plan.steps.n_snapshots
    run = STATE_ARRAYS * (number + plan.n_ghosts)
    trajectory = n_snapshots * (6 * number + 3) + 4 * plan.n_ghosts
    spin_up = 5 * number if plan.steps.n_spin_up_steps else 0
    # Snapshots wait for a checkpoint, which holds them once more, with two states.
    found = {
        "fom": Need(
            _ram(run + min(MOST_PENDING / BYTES, trajectory)),
            BYTES * (2 * number + (trajectory + spin_up) * len(at)),
            ("packing.h5", "spin-up-*.h5", "fom-*.h5"),
            passing=BYTES * (trajectory + 14 * number),
        )
    }
    if not case.rom:
        return found
    modes = sum(plan.basis_size(name) for name in plan.bases) * N_FIELD_VALUES * number
    kept = modes * (1 + case.basis.lagrangian)
    mapped = BYTES * number * (3 * n_snapshots + 2) * len(at)
    found["map"] = Need(BASELINE, mapped, ("map-*.h5",))
    found["pod"] = Need(
        _ram(_decomposition(case) + (MODE_COPIES - 1) * modes + kept),
        BYTES * (kept + 6 * number),
        ("pod.h5",),
        "raise snapshots.every, or lower discretization.resolution or basis.n_modes",
    )
    if plan.reference_bases:
        found["operators"] = Need(
            _ram(_operators(case)),
            0,
            ("operators.h5",),
            "lower discretization.resolution, basis.n_modes, or the n_modes of models with "
            "projection: apg",
        )
    written = 0
    for model in case.rom:
        each = 0 if model.from_operators else trajectory
        each += number * (4 * n_snapshots + 2) * (model.output == "snapshots")
        written += BYTES * each * sum(p in at for p in plan.rom_points(model))
    slow = any(not model.from_operators for model in case.rom)
    found["rom"] = Need(
        _ram(run * slow),
        written,
        ("rom-*.h5",),
        passing=found["fom"].passing * slow,
    )
    return found


def _ram(numbers: float) -> int:
    return BASELINE + int(BYTES * numbers)


def _decomposition(case: Case) -> float:
    """Return the numbers of a decomposition: all points are one block if the limit allows it."""
    n_snapshots = len(case.plan.train_points) * case.plan.steps.n_snapshots
    least = decomposition_bytes(n_snapshots, smallest_block(n_snapshots))
    whole = decomposition_bytes(n_snapshots, case.plan.n_particles)
    return max(least, min(whole, decomposition_ram_limit())) / BYTES


def _operators(case: Case) -> float:
    """Return the numbers of a basis with its copies and splines, sparse sums, and tensors."""
    plan = case.plan
    most = max(plan.basis_size(name) for name in plan.reference_bases)
    copies = MODE_COPIES + (1 if plan.lattice_splines else SPLINE_COPIES)
    sparse = SPARSE_NUMBERS * plan.discretization.n_neighbours * plan.n_particles
    tensors = [n**4 for _, n in plan.memory_models]
    for name in filter(plan.has_error_estimate, plan.reference_bases):
        linear = 1 + plan.basis_size(name)
        driven = case.scene.domain.has_walls + (plan.largest_body_force > 0.0) + len(plan.driving)
        tensors.append((linear * (linear + 1) + driven * linear) ** 2)
    largest = TENSOR_COPIES * max(tensors, default=0)
    return copies * N_FIELD_VALUES * most * plan.n_particles + sparse + BLOCK + largest


def decomposition_ram_limit() -> int:
    """Return the memory [bytes] that a decomposition may use, beyond the modes themselves."""
    return int(RAM_SHARE * physical_ram())


def runs_that_fit(case: Case, stage: str) -> int:
    """Return how many runs of a stage, at a point each, this machine has cores and memory for."""
    cores, ram = len(os.sched_getaffinity(0)), available_ram()
    return cores if ram is None else max(1, min(cores, ram // needs(case)[stage].ram))


def full_seconds(case: Case, n_runs: int) -> float:
    """Return about how long full runs take on one core [s]."""
    steps = case.plan.steps
    neighbours = case.plan.n_particles * case.plan.discretization.n_neighbours
    return SECONDS_PER_NEIGHBOUR * neighbours * (steps.n_steps + steps.n_spin_up_steps) * n_runs


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
    if points is not None and set(points) >= set(case.plan.points):
        points = None
    if stage is None and points is not None:
        stage = "fom"
    judged = {name: need for name, need in needs(case, points).items() if stage in (None, name)}
    ram = physical_ram()
    for name, need in judged.items():
        if need.ram > ram:
            raise ResourceError(
                f"the case needs about {size_in_words(need.ram)} of memory in {name}, this machine "
                f"has {size_in_words(ram)}: {need.remedy}"
            )
    missing = {name: need.disk - _written(out, need, points) for name, need in judged.items()}
    needed = sum(max(0, size) for size in missing.values())
    # Checkpoints come on top while a run lasts; of a run that goes on some are there already.
    passing = max((judged[name].passing for name in missing if missing[name] > 0), default=0)
    needed += max(0, passing - _size_of(out.glob("*.h5.*")))
    # The folder may not be there yet.
    free = shutil.disk_usage(next(f for f in (out, *out.parents) if f.exists())).free
    if needed > free:
        raise ResourceError(
            f"the case writes about {size_in_words(needed)}, the disk of {out} has "
            f"{size_in_words(free)} free: raise snapshots.every, or choose another disk with "
            "`--out`"
        )


def _written(out: Path, need: Need, points: Sequence[ParameterPoint] | None) -> int:
    """Return the size of the files of a stage that are there."""
    ends = [""] if points is None else [point.file_label for point in points]
    patterns = {name.replace("*", f"*{end}") for name in need.files for end in ends}
    return _size_of(path for pattern in patterns for path in out.glob(pattern))


def _size_of(paths: Iterable[Path]) -> int:
    return sum(path.stat().st_size for path in paths if path.is_file())


def size_in_words(n_bytes: float) -> str:
    """Return a number of bytes with its unit, such as `5.58 MB`."""
    power = min(int(math.log10(max(n_bytes, 1.0))) // 3, 4)
    return f"{n_bytes / 1000.0**power:.3g} {('B', 'kB', 'MB', 'GB', 'TB')[power]}"
