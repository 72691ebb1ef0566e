"""The sizes of the arrays that the stages of a case hold or write [bytes]."""

from __future__ import annotations

import math
from functools import partial

from sphrom.artifacts.declaration import DEGREES, stored_bytes
from sphrom.artifacts.records.coordinates import Coordinates, ErrorEstimate, Probes
from sphrom.artifacts.records.operators import BasisOperators, Estimate, Memory
from sphrom.artifacts.records.trajectory import Checkpoint, Trajectory
from sphrom.case.geometry import n_ghosts, n_particles
from sphrom.case.models import Case
from sphrom.case.plan import basis_size, has_error_estimate, model_plan, step_plan
from sphrom.case.sections import AUTO, ReducedModelSection
from sphrom.kernels.support import SUPPORT_RATIO
from sphrom.reduction.error_calibration import compared_snapshots
from sphrom.reduction.sizes import (
    BLOCK_VALUES,
    BYTES,
    CELL_WIDTH_RATIO,
    N_FIELD_VALUES,
    polynomial_terms,
)

STATE_ARRAYS = 60
"""Arrays of n_particles numbers that are alive at once in a run, sources and images included."""
N_STATE_ROWS = 5
"""Position, density fluctuation and velocity, of every particle."""
N_CHECKPOINTS = 2
"""States that are kept of a run while it isn't complete."""
SPLINE_POINTS = 9
"""Systems that a point is in: its cell's, and those of the cells around."""
MATRIX_COPIES = 2
"""Copies of a spline's system: to be factorised, and its absolute values for the norm."""
SPARSE_MATRICES, SPARSE_BYTES = 4, 12
"""Sparse sums over neighbours that operators hold, and the size of an entry."""
PRODUCT_COPIES = 8
"""Products of training snapshots with each other, while some are left out."""


def field(case: Case) -> int:
    """Return the size of one number a particle."""
    return BYTES * n_particles(case)


def running(case: Case) -> int:
    """Return the size of the arrays of a run, those of ghosts included."""
    return STATE_ARRAYS * BYTES * (n_particles(case) + n_ghosts(case))


def lengths(case: Case) -> dict[str, int]:
    """Return the lengths of the axes that artifacts have in common."""
    n_snapshots = step_plan(case).n_snapshots
    return {"snapshot": n_snapshots, "particle": n_particles(case), "component": 2}


def trajectory(case: Case) -> int:
    """Return the size of a run's snapshots, and of the ghosts beside them."""
    return stored_bytes(Trajectory, ghost=n_ghosts(case), **lengths(case))


def checkpoints(case: Case) -> int:
    """Return the size of a run's checkpoints: its snapshots once more, and two states."""
    rows = {"row": N_STATE_ROWS, "entry": n_particles(case)}
    return trajectory(case) + N_CHECKPOINTS * stored_bytes(Checkpoint, **rows, **lengths(case))


def basis_columns(case: Case, basis: str) -> int:
    """Return how many arrays of n_particles numbers a basis has, its mean included."""
    n_modes = basis_size(case, basis) * (2 if case.basis.fields == "separate" else 1)
    return N_FIELD_VALUES * (n_modes + case.basis.centred)


def spline_coefficients(case: Case, n_columns: int) -> int:
    """Return the size of B-splines: for each point, and three more each way, a coefficient."""
    return int(BYTES * n_columns * math.prod(n + 3.0 for n in _box(case)))


def spline_weights(case: Case, n_columns: int) -> int:
    """Return the size of splines: for each point of a system two coordinates, and weights."""
    polynomial = polynomial_terms(case.psi.polynomial_degree) * n_columns * math.prod(_cells(case))
    return SPLINE_POINTS * (n_columns + 2) * field(case) + BYTES * polynomial


def spline_system(case: Case) -> int:
    """Return the size of one cell's system, which is dense."""
    n_points = SPLINE_POINTS * math.prod(_box(case)) / math.prod(_cells(case))
    return int(MATRIX_COPIES * n_points**2 * BYTES)


def _cells(case: Case) -> list[int]:
    """Return how many cells of splines there are along each edge of the scene's box."""
    ratio = case.psi.cell_width_ratio or CELL_WIDTH_RATIO
    return [max(1, int(n / ratio * (1.0 + 1e-9))) for n in _box(case)]


def _box(case: Case) -> list[float]:
    """Return the edges of the scene's box, over the particle spacing."""
    return [length / case.particle_spacing for length in case.scene.domain.lengths]


def sparse_sums(case: Case) -> int:
    """Return the size of the sums over neighbours, as sparse matrices."""
    neighbours = math.pi * (SUPPORT_RATIO * case.smoothing_length / case.particle_spacing) ** 2
    return int(SPARSE_MATRICES * SPARSE_BYTES * neighbours * n_particles(case))


def closure(case: Case, n_modes: int) -> int:
    """Return the size of the closure's tensors at one viscosity, those of the drive included."""
    n = n_modes * (2 if case.basis.fields == "separate" else 1)
    parts = () if case.scene.drive_changes else DEGREES
    return stored_bytes(Memory, *parts, viscosity_power=1, mode=n)


def training_runs(case: Case) -> int:
    """Return the size of the coordinates that models are calibrated and corrected with."""
    return sum(
        stored_bytes(
            BasisOperators,
            "training_runs",
            run=len(case.bases[name]),
            mode=basis_columns(case, name) // N_FIELD_VALUES,
            **lengths(case),
        )
        for name in case.taught_bases
    )


def error_factors(case: Case) -> list[int]:
    """Return the sizes of the factors that estimates of errors need, by basis: one is square."""
    factors = []
    for name in filter(partial(has_error_estimate, case), case.reference_bases):
        n_modes = basis_columns(case, name) // N_FIELD_VALUES
        linear = 1 + n_modes
        quadratic = linear + n_modes * linear // 2
        n_driven = case.scene.domain.has_walls + (case.largest_body_force > 0.0) + len(case.driving)
        factors.append(BYTES * (2 * quadratic + n_driven * linear) ** 2)
    return factors


def known_errors(case: Case) -> int:
    """Return the size of the products that errors of training runs follow from."""
    names = [name for name in case.reference_bases if has_error_estimate(case, name)]
    n_compared = len(compared_snapshots(step_plan(case).n_snapshots))
    total = 0
    for name in names:
        n_modes, n_runs = basis_columns(case, name) // N_FIELD_VALUES, len(case.bases[name])
        runs = {"training_run": n_runs, "run": n_runs, "compared_snapshot": n_compared}
        modes = {"mode": n_modes, "size": n_modes, "column": n_modes + 1, "field": 2}
        total += stored_bytes(Estimate, **runs, **modes)
    return total


def cross_validation(case: Case) -> int:
    """Return the size of the products of training snapshots, and of the snapshots of one block."""
    names = [name for name in case.reference_bases if has_error_estimate(case, name)]
    n_runs = max((len(case.bases[name]) for name in names), default=0)
    n_snapshots = n_runs * len(compared_snapshots(step_plan(case).n_snapshots))
    block = 3 * BLOCK_VALUES if n_runs else 0
    return BYTES * (PRODUCT_COPIES * n_snapshots**2 + block)


def coordinates(case: Case, model: ReducedModelSection) -> int:
    """Return the size of a reduced run without its fields, its error estimates included."""
    n_snapshots = model_plan(case, model).n_snapshots
    n_modes = case.n_modes if model.n_modes == AUTO else model.size
    snapshots = {"snapshot": n_snapshots, "mode": n_modes, "cause": 2}
    run = stored_bytes(Coordinates, "time", "generalized_coordinates", **snapshots)
    if any(case.is_corrected(model, case.basis_for(model, p)) for p in case.rom_points(model)):
        run += stored_bytes(Coordinates, "correction", **snapshots)
    if model.from_operators:
        run += stored_bytes(Coordinates, "residual", **snapshots)
        run += stored_bytes(ErrorEstimate, **snapshots)
    return run


def rebuilt(case: Case) -> int:
    """Return the size of the stored fields of a run on the reference points, and of the points."""
    fields = ("reference_position", "density_fluctuation", "velocity", "pressure")
    return stored_bytes(Coordinates, *fields, **lengths(case))


def sampled(case: Case) -> int:
    """Return the size of a run's velocity and pressure where runs are compared."""
    n_probes = case.compare.line_points + case.compare.grid**2
    return stored_bytes(Probes, "velocity", "pressure", probe=n_probes, **lengths(case))
