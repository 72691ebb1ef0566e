"""How much memory and disk each stage of a case needs, from the sizes of its largest arrays.

Sizes are in numbers of 8 bytes until `estimate_stage` returns them in bytes. What a stage writes is
known to some per cent, and its memory within a factor of two or so.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sphrom.case.geometry import n_ghosts, n_particles
from sphrom.case.models import Case
from sphrom.case.plan import (
    basis_size,
    has_error_estimate,
    model_plan,
    n_basis_snapshots,
    step_plan,
)
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import AUTO
from sphrom.kernels import SUPPORT_RATIO
from sphrom.machine import available_ram, physical_ram
from sphrom.reduction.error_calibration import compared_snapshots
from sphrom.reduction.mode_splines import CELL_WIDTH_RATIO, polynomial_terms
from sphrom.reduction.pod import BYTES, N_FIELD_VALUES, decomposition_bytes, smallest_block

Points = Sequence[ParameterPoint]
Sizes = tuple[float, ...]
"""Memory, disk, and disk for checkpoints [numbers]."""

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
MODE_COPIES = 3
"""Copies of the modes while a basis, its splines or its operators are made."""
SPARSE_NUMBERS = 6
"""Numbers a neighbour in the sums that operators hold: four matrices, with half an index each."""
SPLINE_POINTS = 9
"""Systems that a point is in: its cell's, and those of the cells around."""
TENSOR_COPIES = 14
"""Copies of a closure's largest tensor, or of an estimate's factor, while they are made."""
VISCOSITY_POWERS = 3
"""Of the viscosity, in the closure's tensors."""
SAMPLED_RUNS = 5
"""Runs sampled at all probes that are alive at once."""


@dataclass(frozen=True)
class Need:
    """The memory and disk that one stage needs [bytes]."""

    ram: int
    disk: int
    passing: int = 0
    """Disk for the checkpoints of one run, which are deleted when it ends."""


@dataclass(frozen=True)
class Cost:
    """The needs of stages that run one after the other."""

    stages: dict[str, Need]

    @property
    def largest(self) -> str:
        """The stage that needs most memory."""
        return max(self.stages, key=lambda stage: self.stages[stage].ram)

    @property
    def ram(self) -> int:
        """The memory of the largest stage [bytes]."""
        return self.stages[self.largest].ram

    @property
    def disk(self) -> int:
        """The disk that all of them fill [bytes]."""
        return sum(need.disk for need in self.stages.values())


def decomposition_ram_limit() -> int:
    """Return the memory [bytes] that a decomposition may use, beyond the modes themselves."""
    return int(RAM_SHARE * physical_ram())


def estimate(case: Case) -> Cost:
    """Return what the stages of a case need; without reduced models only fom and compare."""
    operators = ("operators",) if case.reference_bases else ()
    reduced = ("map", "pod", "fit-psi", *operators, "rom") if case.rom else ()
    stages = ("fom", *reduced, "compare")
    return Cost({stage: estimate_stage(case, stage) for stage in stages})


def estimate_stage(case: Case, stage: str, points: Points | None = None) -> Need:
    """Return the needs of one stage; those of runs at some parameter points if they are given."""
    ram, disk, *passing = _STAGES[stage](case, case.points if points is None else points)
    return Need(BASELINE + int(BYTES * ram), *(int(BYTES * size) for size in (disk, *passing)))


def runs_that_fit(case: Case, stage: str) -> int:
    """Return how many runs of a stage, at a point each, this machine has cores and memory for."""
    cores, ram = len(os.sched_getaffinity(0)), available_ram()
    if ram is None:
        return cores
    return max(1, min(cores, ram // estimate_stage(case, stage, case.points[:1]).ram))


def _fom(case: Case, points: Points) -> Sizes:
    """Return the memory and disk that full runs need, and the disk for their checkpoints."""
    spin_up = 5 * n_particles(case) if step_plan(case).n_spin_up_steps else 0
    written = 2 * n_particles(case) + (_trajectory(case) + spin_up) * len(points)
    # Snapshots wait for a checkpoint, which holds them once more, with two states.
    pending = min(MOST_PENDING / BYTES, _trajectory(case))
    ram = STATE_ARRAYS * (n_particles(case) + n_ghosts(case)) + pending
    return ram, written, _trajectory(case) + 14 * n_particles(case)


def _map(case: Case, points: Points) -> Sizes:
    mapped = n_particles(case) * (3 * step_plan(case).n_snapshots + 2)
    return STATE_ARRAYS * n_particles(case), mapped * len(points)


def _trajectory(case: Case) -> int:
    """Return the size of a run's snapshots, and of the ghosts beside them."""
    return step_plan(case).n_snapshots * (6 * n_particles(case) + 3) + 4 * n_ghosts(case)


def _n_modes(case: Case, basis: str) -> int:
    """Return how many modes a basis has, its mean included, and modes of both fields."""
    return basis_size(case, basis) * (1 + (case.basis.fields == "separate")) + case.basis.centred


def _pod(case: Case, points: Points) -> Sizes:
    modes = sum(_n_modes(case, name) for name in case.bases) * N_FIELD_VALUES * n_particles(case)
    kept = modes * (1 + case.basis.lagrangian)
    n_snapshots = len(case.train_points) * step_plan(case).n_snapshots
    # All points are one block if the limit allows it.
    n_parts = 1 + (case.basis.fields == "separate")
    least = decomposition_bytes(n_snapshots, n_parts, smallest_block(n_snapshots))
    whole = decomposition_bytes(n_snapshots, n_parts, n_particles(case))
    decomposition = max(least, min(whole, decomposition_ram_limit())) / BYTES
    return decomposition + (MODE_COPIES - 1) * modes + kept, kept + 6 * n_particles(case)


def _splines(case: Case, n_modes: int) -> float:
    """Return the size of the splines of a basis: weights at the points of each system."""
    n_columns, box = N_FIELD_VALUES * n_modes, _box(case)
    if case.lattice_splines:
        return n_columns * math.prod(n + 3.0 for n in box)
    polynomial = polynomial_terms(case.psi.polynomial_degree) * n_columns * _n_cells(case)
    return SPLINE_POINTS * (n_columns + 2) * n_particles(case) + polynomial


def _n_cells(case: Case) -> int:
    """Return how many cells of splines there are in the scene's box."""
    ratio = case.psi.cell_width_ratio or CELL_WIDTH_RATIO
    return math.prod(max(1, int(n / ratio * (1.0 + 1e-9))) for n in _box(case))


def _box(case: Case) -> list[float]:
    """Return the edges of the scene's box, over the particle spacing."""
    return [length / case.particle_spacing for length in case.scene.domain.lengths]


def _fit_psi(case: Case, points: Points) -> Sizes:
    # A cell's system is dense: it is factorised, and its absolute values give its norm.
    n_points = SPLINE_POINTS * math.prod(_box(case)) / _n_cells(case)
    system = 0.0 if case.lattice_splines else 2.0 * n_points**2
    ram = _modes_and_splines(case, list(case.bases), MODE_COPIES) + system
    return ram, sum(_splines(case, _n_modes(case, name)) for name in case.bases)


def _sparse_sums(case: Case) -> float:
    """Return the size of the sums over neighbours, as sparse matrices."""
    neighbours = math.pi * (SUPPORT_RATIO * case.smoothing_length / case.particle_spacing) ** 2
    return SPARSE_NUMBERS * neighbours * n_particles(case)


def _operators(case: Case, points: Points) -> Sizes:
    """Return the needs for the basis and its copies, sparse sums, tensors, and estimates."""
    plan, bases = step_plan(case), case.reference_bases
    sizes = [_n_modes(case, name) for name in bases]
    closures, factors = _closures(case), _error_factors(case)
    largest = TENSOR_COPIES * max((*closures, *factors), default=0)
    ram = _modes_and_splines(case, bases, MODE_COPIES) + _sparse_sums(case) + BLOCK + largest
    tensors = sum(2 * n**3 + 7 * n**2 for n in sizes)
    training = sum(_n_modes(case, b) * n_basis_snapshots(case, b) for b in case.taught_bases)
    # The products that errors of training runs follow from.
    n_compared = len(compared_snapshots(plan.n_snapshots))
    products = sum(
        2 * (_n_modes(case, name) + 1) * (n_compared + 1) * len(case.bases[name])
        for name in bases
        if has_error_estimate(case, name)
    )
    starts = 3 * n_particles(case) * (len(case.train_points) if case.time.spin_up > 0.0 else 1)
    written = tensors + VISCOSITY_POWERS * sum(closures) + sum(factors) + training + products
    return ram, written + starts


def _modes_and_splines(case: Case, bases: Sequence[str], copies: int) -> float:
    """Return the size of the largest basis in some copies, and of its splines."""
    most = max((_n_modes(case, name) for name in bases), default=0)
    return copies * N_FIELD_VALUES * most * n_particles(case) + _splines(case, most)


def _closures(case: Case) -> list[int]:
    """Return the sizes of closures' tensors at one viscosity."""
    sizes = [n * (1 + (case.basis.fields == "separate")) for _, n in case.memory_models]
    return [n**4 + 2 * n**3 for n in sizes]


def _error_factors(case: Case) -> list[int]:
    """Return the sizes of the factors that estimates of errors need: each is square."""
    factors = []
    for name in case.reference_bases:
        if has_error_estimate(case, name):
            linear = 1 + _n_modes(case, name)
            quadratic = linear + (linear - 1) * linear // 2
            driven = case.scene.domain.has_walls + (case.largest_body_force > 0.0)
            factors.append((2 * quadratic + (driven + len(case.driving)) * linear) ** 2)
    return factors


def _rom(case: Case, points: Points) -> Sizes:
    left_out, plan, number = set(case.points) - set(points), step_plan(case), n_particles(case)
    ram, written, passing = 0.0, 0, 0.0
    for model in case.rom:
        at = case.rom_points(model)
        bases = [case.basis_for(model, point) for point in at]
        held = 2.0 * _modes_and_splines(case, bases, 1)
        # Coordinates, and where models aren't on particles, corrections and estimates of errors.
        n_modes = case.n_modes if model.n_modes == AUTO else model.size
        corrected = any(case.is_corrected(model, basis) for basis in bases)
        each = 1 + n_modes * (1 + corrected) + 5 * model.from_operators
        each *= model_plan(case, model).n_snapshots
        if model.on_particles:
            run = _fom(case, at[:1])
            held, each, passing = held + run[0], each + _trajectory(case), run[2]
        elif not model.from_operators:
            # The remainders of training runs' states are evaluated too, with their copies.
            held += _sparse_sums(case) + 2 * STATE_ARRAYS * len(case.train_points) * number
            held += 2 * _modes_and_splines(case, bases, MODE_COPIES)
        if model.output == "snapshots":
            each += number * (4 * plan.n_snapshots + 2)
        elif model.output == "probes":
            each += _sampled(case)
            held += SAMPLED_RUNS * _sampled(case)
        each += 2 * plan.n_snapshots * number * model.tracers
        written += each * sum(point not in left_out for point in at)
        ram = max(ram, held)
    ram += 2 * VISCOSITY_POWERS * max(_closures(case), default=0)
    return ram + 2 * max(_error_factors(case), default=0), written, passing


def _sampled(case: Case) -> int:
    """Return the size of a run's velocity and pressure where runs are compared."""
    n_probes = case.compare.line_points + case.compare.grid**2
    return N_FIELD_VALUES * step_plan(case).n_snapshots * n_probes


def _compare(case: Case, points: Points) -> Sizes:
    # At a point the full run, the exact flow, and reduced runs, each beside the best possible one.
    n_reduced = sum(len(case.rom_points(model)) for model in case.rom)
    n_compared = (1 + case.compare.exact) * len(case.points) + 2 * n_reduced
    line = N_FIELD_VALUES * step_plan(case).n_snapshots * case.compare.line_points
    bases = [case.basis_for(model, p) for model in case.rom for p in case.rom_points(model)]
    ram = SAMPLED_RUNS * _sampled(case) + STATE_ARRAYS * n_particles(case) + line * n_compared
    return ram + 2.0 * _modes_and_splines(case, bases, 1), line * n_compared


_STAGES: dict[str, Callable[[Case, Points], Sizes]] = {
    "fom": _fom,
    "map": _map,
    "pod": _pod,
    "fit-psi": _fit_psi,
    "operators": _operators,
    "rom": _rom,
    "compare": _compare,
}
