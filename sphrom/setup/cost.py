"""What the stages of a case need of memory and disk, from the sizes of what they hold at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from sphrom.artifacts.declaration import DEGREES, stored_bytes
from sphrom.artifacts.records.coordinates import Coordinates, ErrorEstimate, Probes
from sphrom.artifacts.records.operators import BasisOperators, Estimate, Memory, Rates, Starts
from sphrom.artifacts.records.trajectory import (
    Checkpoint,
    Packing,
    ReferenceSnapshots,
    State,
    Trajectory,
)
from sphrom.case.geometry import n_ghosts, n_particles
from sphrom.case.models import Case
from sphrom.case.plan import basis_size, has_error_estimate, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.kernels.support import SUPPORT_RATIO
from sphrom.machine import physical_memory
from sphrom.reduction.error_calibration import compared_snapshots
from sphrom.reduction.sizes import (
    BLOCK_VALUES,
    BYTES,
    CELL_WIDTH_RATIO,
    N_FIELD_VALUES,
    decomposition_bytes,
    polynomial_terms,
    smallest_block,
)

BASELINE = 250_000_000
"""Memory of Python and the libraries [bytes]."""
MEMORY_SHARE = 0.4
"""Share of the memory that the decomposition may use before it goes block by block."""
STATE_ARRAYS = 60
"""Arrays of n_particles numbers that are alive at once in a run, sources and images included."""
N_STATE_ROWS = 5
"""Position, density fluctuation and velocity, of every particle."""
N_CHECKPOINTS = 2
"""States that are kept of a run while it isn't complete."""
MOST_PENDING = 2**26
"""Snapshots that wait for the next checkpoint; more of them bring it forward [bytes]."""
MODE_COPIES = 3
"""Copies of the modes while a basis is made: combined, by field, and without the weights."""
NODE_COPIES = 4
"""Copies of B-splines' coefficients while they are solved for: ordered, solved, turned, written."""
SPLINE_POINTS = 9
"""Systems that a point is in: its cell's, and those of the cells around."""
MATRIX_COPIES = 2
"""Copies of a spline's system: to be factorised, and its absolute values for the norm."""
SPARSE_MATRICES, SPARSE_BYTES = 4, 12
"""Sparse sums over neighbours that operators hold, and the size of an entry."""
OPERATOR_BLOCK = 2**27
"""What a block of points takes while operators are projected."""
EVALUATED_COPIES = 7
"""Copies of the modes where rates are evaluated: themselves, gradients, what weighs and moves."""
REMAINDER_ARRAYS = 120
"""Remainders of a training run's states, by component, and their copies while modes are made."""
FACTOR_COPIES = 24
"""The residual's factor while it is made: blocks of its columns, and what they are made of."""
READ_COPIES = 3
"""The same when it is read: its parts, those at a viscosity, and those of fewer modes."""
PRODUCT_COPIES = 8
"""Products of training snapshots with each other, while some are left out."""
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
    """What one stage needs [bytes]."""

    memory: int
    disk: int
    passing: int = 0
    """On the disk while it runs, beside what it writes: the checkpoints of one run."""


@dataclass(frozen=True)
class Cost:
    """What some stages need, one after the other."""

    stages: dict[str, Need]

    @property
    def largest(self) -> str:
        """The stage that needs most memory."""
        return max(self.stages, key=lambda stage: self.stages[stage].memory)

    @property
    def memory(self) -> int:
        """The memory of the largest stage [bytes]."""
        return self.stages[self.largest].memory

    @property
    def disk(self) -> int:
        """What all of them write [bytes]."""
        return sum(need.disk for need in self.stages.values())


def decomposition_memory_limit() -> int:
    """Return the memory [bytes] that a decomposition may use, beyond the modes themselves."""
    return int(MEMORY_SHARE * physical_memory())


def estimate(case: Case) -> Cost:
    """Return what the stages of a case need; without reduced models these are two only."""
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
    return Need(BASELINE + need.memory, need.disk, need.passing)


def _fom(case: Case, points: Sequence[ParameterPoint]) -> Need:
    spin_up = stored_bytes(State, **_lengths(case)) if step_plan(case).n_spin_up_steps else 0
    packing = stored_bytes(Packing, **_lengths(case))
    written = packing + (_trajectory(case) + spin_up) * len(points)
    return Need(_running(case) + _pending(case), written, _checkpoints(case))


def _pending(case: Case) -> int:
    """Return the size of the snapshots that wait for a checkpoint."""
    return min(MOST_PENDING, _trajectory(case))


def _checkpoints(case: Case) -> int:
    """Return the size of a run's checkpoints: its snapshots once more, and two states."""
    rows = {"row": N_STATE_ROWS, "entry": n_particles(case)}
    return _trajectory(case) + N_CHECKPOINTS * stored_bytes(Checkpoint, **rows, **_lengths(case))


def _trajectory(case: Case) -> int:
    """Return the size of a run's snapshots, and of the ghosts beside them."""
    return stored_bytes(Trajectory, ghost=n_ghosts(case), **_lengths(case))


def _lengths(case: Case) -> dict[str, int]:
    """Return the lengths of the axes that artifacts have in common."""
    n_snapshots = step_plan(case).n_snapshots
    return {"snapshot": n_snapshots, "particle": n_particles(case), "component": 2}


def _map(case: Case, points: Sequence[ParameterPoint]) -> Need:
    mapped = stored_bytes(ReferenceSnapshots, **_lengths(case))
    return Need(STATE_ARRAYS * _field(case), mapped * len(points))


def _pod(case: Case) -> Need:
    modes = sum(_columns(case, name) for name in case.bases) * _field(case)
    kept = modes * (2 if case.basis.lagrangian else 1)
    points = 3 * _field(case)
    memory = _decomposition(case) + MODE_COPIES * modes + (kept - modes) + points
    return Need(memory, kept + 2 * points)


def _decomposition(case: Case) -> int:
    """Return what the blocks and factors take: all points at once, if the limit allows it."""
    n_snapshots = len(case.train_points) * step_plan(case).n_snapshots
    n_parts = 2 if case.basis.fields == "separate" else 1
    least = decomposition_bytes(n_snapshots, n_parts, smallest_block(n_snapshots))
    whole = decomposition_bytes(n_snapshots, n_parts, n_particles(case))
    return max(least, min(whole, decomposition_memory_limit()))


def _fit_psi(case: Case) -> Need:
    columns = {name: _columns(case, name) for name in case.bases}
    lattice = case.lattice_splines
    size = _node_coefficients if lattice else _spline_weights
    weights = {name: size(case, n_columns) for name, n_columns in columns.items()}
    most = max(columns.values())
    work = NODE_COPIES * max(weights.values()) if lattice else _spline_system(case)
    memory = MODE_COPIES * most * _field(case) + max(weights.values()) + work
    return Need(memory, sum(weights.values()))


def _node_coefficients(case: Case, n_columns: int) -> int:
    """Return the size of B-splines: for each point, and three more each way, a coefficient."""
    return int(BYTES * n_columns * math.prod(n + 3.0 for n in _box(case)))


def _spline_weights(case: Case, n_columns: int) -> int:
    """Return the size of splines: for each point of a system two coordinates, and weights."""
    polynomial = polynomial_terms(case.psi.polynomial_degree) * n_columns * math.prod(_cells(case))
    return SPLINE_POINTS * (n_columns + 2) * _field(case) + BYTES * polynomial


def _spline_system(case: Case) -> int:
    """Return the size of one cell's system, which is dense."""
    n_points = SPLINE_POINTS * math.prod(_box(case)) / math.prod(_cells(case))
    return int(MATRIX_COPIES * n_points**2 * BYTES)


def _operators(case: Case) -> Need:
    """Return what the basis, its copy as columns and the sparse sums take, and the tensors."""
    columns = [_columns(case, name) for name in case.reference_bases]
    tensors = [stored_bytes(Rates, mode=n // N_FIELD_VALUES) for n in columns]
    closures = [_closure(case, n_modes) for _, n_modes in case.memory_models]
    modes = max(
        (MODE_COPIES * n * _field(case) + _spline_weights(case, n) for n in columns), default=0
    )
    most = max((n_modes for _, n_modes in case.memory_models), default=0)
    closing = CLOSURE_COPIES * _closure(case, most) + CLOSURE_FIELDS * most * _field(case)
    estimating = FACTOR_COPIES * max(_factors(case), default=0)
    memory = modes + _sparse_sums(case) + OPERATOR_BLOCK + max(tensors, default=0)
    kept = sum(tensors) + VISCOSITY_POWERS * sum(closures) + _training_runs(case)
    estimates = sum(_factors(case)) + _known_errors(case)
    estimating = max(estimating, _leaving_out(case))
    n_starts = len(case.train_points) if case.time.spin_up > 0.0 else 1
    starts = stored_bytes(Starts, start=n_starts, parameter=1, **_lengths(case))
    return Need(int(memory + max(closing, estimating)), kept + estimates + starts)


def _training_runs(case: Case) -> int:
    """Return the size of the coordinates that models are calibrated with."""
    return sum(
        stored_bytes(
            BasisOperators,
            "training_runs",
            run=len(case.bases[name]),
            mode=_columns(case, name) // N_FIELD_VALUES,
            **_lengths(case),
        )
        for name in case.calibrated_bases
    )


def _sparse_sums(case: Case) -> int:
    neighbours = math.pi * (SUPPORT_RATIO * case.smoothing_length / case.particle_spacing) ** 2
    return int(SPARSE_MATRICES * SPARSE_BYTES * neighbours * n_particles(case))


def _factors(case: Case) -> list[int]:
    """Return the sizes of the factors that estimates of errors need, by basis: one is square."""
    factors = []
    for name in filter(partial(has_error_estimate, case), case.reference_bases):
        n_modes = _columns(case, name) // N_FIELD_VALUES
        linear = 1 + n_modes
        quadratic = linear + n_modes * linear // 2
        n_driven = case.scene.domain.has_walls + (case.largest_body_force > 0.0)
        factors.append(BYTES * (2 * quadratic + n_driven * linear) ** 2)
    return factors


def _known_errors(case: Case) -> int:
    """Return the size of the products that errors of training runs follow from."""
    names = [name for name in case.reference_bases if has_error_estimate(case, name)]
    n_compared = len(compared_snapshots(step_plan(case).n_snapshots))
    total = 0
    for name in names:
        n_modes, n_runs = _columns(case, name) // N_FIELD_VALUES, len(case.bases[name])
        runs = {"training_run": n_runs, "run": n_runs, "compared_snapshot": n_compared}
        modes = {"mode": n_modes, "size": n_modes, "column": n_modes + 1, "field": 2}
        total += stored_bytes(Estimate, **runs, **modes)
    return total


def _leaving_out(case: Case) -> int:
    """Return what products of training snapshots take, and the snapshots at a block of points."""
    names = [name for name in case.reference_bases if has_error_estimate(case, name)]
    n_runs = max((len(case.bases[name]) for name in names), default=0)
    n_snapshots = n_runs * len(compared_snapshots(step_plan(case).n_snapshots))
    block = 3 * BLOCK_VALUES if n_runs else 0
    return BYTES * (PRODUCT_COPIES * n_snapshots**2 + block)


def _closure(case: Case, n_modes: int) -> int:
    """Return the size of the closure's tensors at one viscosity, those of what drives included."""
    n = n_modes * (2 if case.basis.fields == "separate" else 1)
    parts = () if case.scene.drive_changes else DEGREES
    return stored_bytes(Memory, *parts, viscosity_power=1, mode=n)


def _rom(case: Case, points: Sequence[ParameterPoint]) -> Need:
    left_out = set(case.points) - set(points)
    runs = [m for m in case.rom for point in case.rom_points(m) if point not in left_out]
    on_particles = sum(model.on_particles for model in runs) * _trajectory(case)
    rebuilt = sum(model.output == "snapshots" for model in runs) * _rebuilt(case)
    probes = sum(model.output == "probes" for model in runs) * _sampled(case)
    tracers = sum(model.tracers for model in runs) * stored_bytes(
        Coordinates, "position", tracer=n_particles(case), **_lengths(case)
    )
    coordinates = sum(_coordinates(case, model) for model in runs)
    most = max((n_modes for _, n_modes in case.memory_models), default=0)
    closure = 2 * VISCOSITY_POWERS * _closure(case, most)
    estimates = READ_COPIES * max(_factors(case), default=0)
    memory = _running(case) + _evaluation(case) + _at_points(case) + closure + estimates
    if probes:
        memory += SAMPLES_AT_ONCE * _sampled(case)
    if on_particles:
        memory += _pending(case)
    passing = _checkpoints(case) if on_particles else 0
    return Need(memory, on_particles + rebuilt + probes + tracers + coordinates, passing)


def _coordinates(case: Case, model: ReducedModelSection) -> int:
    """Return the size of a reduced run without its fields, its error estimates included."""
    snapshots = {"snapshot": step_plan(case).n_snapshots, "mode": model.n_modes, "cause": 2}
    run = stored_bytes(Coordinates, "time", "generalized_coordinates", **snapshots)
    if model.from_operators:
        run += stored_bytes(Coordinates, "residual", **snapshots)
        run += stored_bytes(ErrorEstimate, **snapshots)
    return run


def _at_points(case: Case) -> int:
    """Return what rates take that are evaluated at points: the modes there, and sparse sums."""
    sizes = [
        max(_columns(case, case.basis_for(model, point)) for point in case.rom_points(model))
        for model in case.rom
        if not model.from_operators
    ]
    if not sizes:
        return 0
    remainders = REMAINDER_ARRAYS * (1 + case.scene.drive_changes) * len(case.train_points)
    return (EVALUATED_COPIES * max(sizes) + remainders) * _field(case) + _sparse_sums(case)


def _rebuilt(case: Case) -> int:
    """Return the size of the fields that a run on the reference points keeps, and of its points."""
    fields = ("reference_position", "density_fluctuation", "velocity", "pressure")
    return stored_bytes(Coordinates, *fields, **_lengths(case))


def _evaluation(case: Case) -> int:
    """Return what a basis and its splines take, with those of the chosen modes apart."""
    used = {case.basis_for(model, p) for model in case.rom for p in case.rom_points(model)}
    columns = [_columns(case, name) for name in used]
    return max((2 * c * _field(case) + 2 * _spline_weights(case, c) for c in columns), default=0)


def _compare(case: Case) -> Need:
    section = case.compare
    per_probe = step_plan(case).n_snapshots * N_FIELD_VALUES * BYTES
    whole = _sampled(case)
    lines = per_probe * section.line_points * sum(_n_compared(case, p) for p in case.points)
    memory = SAMPLES_AT_ONCE * whole + lines + STATE_ARRAYS * _field(case) + _evaluation(case)
    return Need(memory, lines)


def _sampled(case: Case) -> int:
    """Return the size of a run's velocity and pressure where runs are compared."""
    n_probes = case.compare.line_points + case.compare.grid**2
    return stored_bytes(Probes, "velocity", "pressure", probe=n_probes, **_lengths(case))


def _n_compared(case: Case, point: ParameterPoint) -> int:
    """Return how many runs, and stand-ins for runs, are compared at a point."""
    models = [model for model in case.rom if point in case.rom_points(model)]
    bests = {(case.basis_for(model, point), model.n_modes) for model in models}
    return 1 + case.compare.exact + len(models) + bool(models) + len(bests)


def _columns(case: Case, basis: str) -> int:
    """Return the fields of n_particles numbers that a basis has, its mean included."""
    n_modes = basis_size(case, basis) * (2 if case.basis.fields == "separate" else 1)
    return N_FIELD_VALUES * (n_modes + case.basis.centred)


def _running(case: Case) -> int:
    """Return what the arrays of a run take, those of ghosts included."""
    return STATE_ARRAYS * BYTES * (n_particles(case) + n_ghosts(case))


def _field(case: Case) -> int:
    return BYTES * n_particles(case)


def _cells(case: Case) -> list[int]:
    """Return how many cells of splines there are along each edge of the scene's box."""
    ratio = case.psi.cell_width_ratio or CELL_WIDTH_RATIO
    return [max(1, int(n / ratio * (1.0 + 1e-9))) for n in _box(case)]


def _box(case: Case) -> list[float]:
    """Return the edges of the scene's box, over the particle spacing."""
    return [length / case.particle_spacing for length in case.scene.domain.lengths]


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
