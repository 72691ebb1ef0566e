"""How much memory and disk each stage of a case needs, from the sizes of its largest arrays."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sphrom.artifacts.declaration import stored_bytes
from sphrom.artifacts.records.coordinates import Coordinates
from sphrom.artifacts.records.operators import Rates, Starts
from sphrom.artifacts.records.trajectory import (
    Packing,
    ReferenceSnapshots,
    State,
)
from sphrom.case.geometry import n_particles
from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.machine import available_ram, physical_ram
from sphrom.reduction.sizes import (
    BYTES,
    N_FIELD_VALUES,
    decomposition_bytes,
    smallest_block,
)
from sphrom.setup import sizes

BASELINE = 250_000_000
"""Memory of Python and the libraries [bytes]."""
RAM_SHARE = 0.4
"""Share of the memory that the decomposition may use before it goes block by block."""
MOST_PENDING = 2**26
"""Snapshots that wait for the next checkpoint; more of them bring it forward [bytes]."""
MODE_COPIES = 3
"""Copies of the modes while a basis is made: combined, by field, and without the weights."""
NODE_COPIES = 4
"""Copies of B-splines' coefficients while they are solved for: ordered, solved, turned, written."""
OPERATOR_BLOCK = 2**27
"""Size of a block of points while operators are projected [bytes]."""
EVALUATED_COPIES = 7
"""Copies of the modes where rates are evaluated: themselves, gradients, what weighs and moves."""
REMAINDER_ARRAYS = 120
"""Remainders of a training run's states, by component, and their copies while modes are made."""
FACTOR_COPIES = 24
"""The residual's factor while it is made: blocks of its columns, and what they are made of."""
READ_COPIES = 3
"""The same when it is read: its parts, those at a viscosity, and those of fewer modes."""
VISCOSITY_POWERS = 3
"""Of the viscosity, in the closure's tensors."""
CLOSURE_COPIES = 14
"""The closure's largest tensor while it is made: at each viscosity, and turned every way."""
CLOSURE_FIELDS = 18
"""Fields a mode that the closure needs: states, gradients, and what operators make of them."""
SAMPLES_AT_ONCE = 5
"""Runs sampled at all probes that are alive at once: full, exact, one compared, and two in use."""


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


def estimate_stage(case: Case, stage: str, points: Sequence[ParameterPoint] | None = None) -> Need:
    """Return the needs of one stage, at some parameter points only if they are given."""
    if stage in _NEEDS_AT_POINTS:
        need = _NEEDS_AT_POINTS[stage](case, case.points if points is None else points)
    else:
        need = _NEEDS[stage](case)
    return Need(BASELINE + need.ram, need.disk, need.passing)


def runs_that_fit(case: Case, stage: str) -> int:
    """Return how many runs of a stage, at a point each, this machine has cores and memory for."""
    cores, ram = len(os.sched_getaffinity(0)), available_ram()
    if ram is None:
        return cores
    return max(1, min(cores, ram // estimate_stage(case, stage, case.points[:1]).ram))


def _fom(case: Case, points: Sequence[ParameterPoint]) -> Need:
    spin_up = stored_bytes(State, **sizes.lengths(case)) if step_plan(case).n_spin_up_steps else 0
    packing = stored_bytes(Packing, **sizes.lengths(case))
    written = packing + (sizes.trajectory(case) + spin_up) * len(points)
    return Need(sizes.running(case) + _pending(case), written, sizes.checkpoints(case))


def _pending(case: Case) -> int:
    """Return the size of the snapshots that wait for a checkpoint."""
    return min(MOST_PENDING, sizes.trajectory(case))


def _map(case: Case, points: Sequence[ParameterPoint]) -> Need:
    mapped = stored_bytes(ReferenceSnapshots, **sizes.lengths(case))
    return Need(sizes.STATE_ARRAYS * sizes.field(case), mapped * len(points))


def _pod(case: Case) -> Need:
    modes = sum(sizes.basis_columns(case, name) for name in case.bases) * sizes.field(case)
    kept = modes * (2 if case.basis.lagrangian else 1)
    points = 3 * sizes.field(case)
    ram = _decomposition(case) + MODE_COPIES * modes + (kept - modes) + points
    return Need(ram, kept + 2 * points)


def _decomposition(case: Case) -> int:
    """Return the size of blocks and factors; all points are one block if the limit allows it."""
    n_snapshots = len(case.train_points) * step_plan(case).n_snapshots
    n_parts = 2 if case.basis.fields == "separate" else 1
    least = decomposition_bytes(n_snapshots, n_parts, smallest_block(n_snapshots))
    whole = decomposition_bytes(n_snapshots, n_parts, n_particles(case))
    return max(least, min(whole, decomposition_ram_limit()))


def _fit_psi(case: Case) -> Need:
    columns = {name: sizes.basis_columns(case, name) for name in case.bases}
    lattice = case.lattice_splines
    size = sizes.spline_coefficients if lattice else sizes.spline_weights
    weights = {name: size(case, n_columns) for name, n_columns in columns.items()}
    most = max(columns.values())
    work = NODE_COPIES * max(weights.values()) if lattice else sizes.spline_system(case)
    ram = MODE_COPIES * most * sizes.field(case) + max(weights.values()) + work
    return Need(ram, sum(weights.values()))


def _operators(case: Case) -> Need:
    """Return the needs for the basis and its copies, the sparse sums and the tensors."""
    columns = [sizes.basis_columns(case, name) for name in case.reference_bases]
    tensors = [stored_bytes(Rates, mode=n // N_FIELD_VALUES) for n in columns]
    closures = [sizes.closure(case, n_modes) for _, n_modes in case.memory_models]
    modes = max(
        (MODE_COPIES * n * sizes.field(case) + sizes.spline_weights(case, n) for n in columns),
        default=0,
    )
    most = max((n_modes for _, n_modes in case.memory_models), default=0)
    closing = CLOSURE_COPIES * sizes.closure(case, most) + CLOSURE_FIELDS * most * sizes.field(case)
    estimating = FACTOR_COPIES * max(sizes.error_factors(case), default=0)
    ram = modes + sizes.sparse_sums(case) + OPERATOR_BLOCK + max(tensors, default=0)
    kept = sum(tensors) + VISCOSITY_POWERS * sum(closures) + sizes.training_runs(case)
    estimates = sum(sizes.error_factors(case)) + sizes.known_errors(case)
    estimating = max(estimating, sizes.cross_validation(case))
    n_starts = len(case.train_points) if case.time.spin_up > 0.0 else 1
    starts = stored_bytes(
        Starts, start=n_starts, parameter=len(case.parameter_names), **sizes.lengths(case)
    )
    return Need(int(ram + max(closing, estimating)), kept + estimates + starts)


def _rom(case: Case, points: Sequence[ParameterPoint]) -> Need:
    left_out = set(case.points) - set(points)
    runs = [m for m in case.rom for point in case.rom_points(m) if point not in left_out]
    on_particles = sum(model.on_particles for model in runs) * sizes.trajectory(case)
    rebuilt = sum(model.output == "snapshots" for model in runs) * sizes.rebuilt(case)
    probes = sum(model.output == "probes" for model in runs) * sizes.sampled(case)
    tracers = sum(model.tracers for model in runs) * stored_bytes(
        Coordinates, "position", tracer=n_particles(case), **sizes.lengths(case)
    )
    coordinates = sum(sizes.coordinates(case, model) for model in runs)
    most = max((n_modes for _, n_modes in case.memory_models), default=0)
    closure = 2 * VISCOSITY_POWERS * sizes.closure(case, most)
    estimates = READ_COPIES * max(sizes.error_factors(case), default=0)
    ram = sizes.running(case) + _evaluation(case) + _at_points(case) + closure + estimates
    if probes:
        ram += SAMPLES_AT_ONCE * sizes.sampled(case)
    if on_particles:
        ram += _pending(case)
    passing = sizes.checkpoints(case) if on_particles else 0
    return Need(ram, on_particles + rebuilt + probes + tracers + coordinates, passing)


def _at_points(case: Case) -> int:
    """Return the memory for rates at points: the modes there, and sparse sums."""
    columns = [
        max(
            sizes.basis_columns(case, case.basis_for(model, point))
            for point in case.rom_points(model)
        )
        for model in case.rom
        if not model.from_operators
    ]
    if not columns:
        return 0
    remainders = REMAINDER_ARRAYS * (1 + case.scene.drive_changes) * len(case.train_points)
    return (EVALUATED_COPIES * max(columns) + remainders) * sizes.field(case) + sizes.sparse_sums(
        case
    )


def _evaluation(case: Case) -> int:
    """Return the memory for a basis and its splines, and for copies of the modes used."""
    used = {case.basis_for(model, p) for model in case.rom for p in case.rom_points(model)}
    columns = [sizes.basis_columns(case, name) for name in used]
    return max(
        (2 * c * sizes.field(case) + 2 * sizes.spline_weights(case, c) for c in columns), default=0
    )


def _compare(case: Case) -> Need:
    section = case.compare
    per_probe = step_plan(case).n_snapshots * N_FIELD_VALUES * BYTES
    whole = sizes.sampled(case)
    lines = per_probe * section.line_points * sum(_n_compared(case, p) for p in case.points)
    ram = (
        SAMPLES_AT_ONCE * whole + lines + sizes.STATE_ARRAYS * sizes.field(case) + _evaluation(case)
    )
    return Need(ram, lines)


def _n_compared(case: Case, point: ParameterPoint) -> int:
    """Return how many runs, and stand-ins for runs, are compared at a point."""
    models = [model for model in case.rom if point in case.rom_points(model)]
    bests = {(case.basis_for(model, point), str(model.n_modes)) for model in models}
    return 1 + case.compare.exact + len(models) + bool(models) + len(bests)


_NEEDS_AT_POINTS: dict[str, Callable[[Case, Sequence[ParameterPoint]], Need]] = {
    "fom": _fom,
    "map": _map,
    "rom": _rom,
}
_NEEDS: dict[str, Callable[[Case], Need]] = {
    "pod": _pod,
    "fit-psi": _fit_psi,
    "operators": _operators,
    "compare": _compare,
}
