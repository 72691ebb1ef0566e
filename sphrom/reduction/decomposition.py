"""Proper orthogonal decomposition of a streamed snapshot matrix (Eq. 3.13-3.14, 3.16).

The matrix S has one column per snapshot. It is read in blocks of points and never held as a whole.
Its R factor is built up block by block (TSQR), so singular values are accurate to rounding times
the largest one; a Gram matrix would lose all values below the square root of rounding. A second
pass over the blocks gives the modes S V / sigma. As S = Q R, any subset of the columns has the
singular values and right vectors of the same columns of R: one factor serves all training sets.

Shapes: density (n_snapshots, n_points), velocity (n_snapshots, n_points, n_dim); of modes the same.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.errors import ResourceError
from sphrom.reduction.trial_basis import JOINT, InnerProduct, TrialBasis

ReadBlock = Callable[[slice], tuple[Array, Array]]
"""From a slice of points, the density fluctuation (n_snapshots, n_block) [kg/m3] and the velocity
(n_snapshots, n_block, n_dim) [m/s] of all snapshots there."""

GRAM_TOLERANCE = 1e-13
"""Modes whose Gram matrix differs from the identity by more than this are orthonormalised again."""
DEFAULT_RAM = 2**30
EPSILON = float(np.finfo(np.float64).eps)
N_FIELD_VALUES = 3
"""Values of a state at one point in a plane: the first field and the velocity's components."""
BLOCK_COPIES = 5
"""Copies of a block of snapshots alive at once: as read, weighted, as rows, stacked on R, in QR."""
BYTES = 8
"""Bytes of a float."""
AT_REST = 1e-100
"""Smallest usable singular value: the square of a smaller one underflows."""


def decompose(
    read_block: ReadBlock,
    n_points: int,
    n_snapshots: int,
    product: InnerProduct,
    volume: Array,
    n_modes: Mapping[str, int],
    snapshots: Mapping[str, NDArray[np.int64]],
    *,
    mean_density: Array | None = None,
    ram_limit: int = DEFAULT_RAM,
) -> dict[str, TrialBasis]:
    """Return a trial basis for each named set of snapshots (Eq. 3.13-3.14, 3.16).

    `n_modes` and `snapshots` give the number of modes and the snapshots of each basis.
    `mean_density` (n_snapshots,) [kg/m3] is the weighted spatial mean of each snapshot's density
    fluctuation; if given, the bases represent it separately. `volume` is (n_points,) [m2].
    `ram_limit` [bytes] bounds the blocks and the factors; the modes come on top. The sign of a mode
    is such that the snapshot in which it is strongest has a positive coordinate.

    Raises ValueError when a set has fewer independent snapshots than modes, ResourceError when the
    limit is too small for the number of snapshots.
    """
    if mean_density is not None:
        product = product.without_mean()
    weights = product.weights(volume)
    root = np.sqrt(weights)
    n_block = _points_per_block(n_snapshots, ram_limit)

    def blocks() -> Iterator[tuple[slice, Array]]:
        """Yield points and their weighted states (n_snapshots, (1 + n_dim) n)."""
        for start in range(0, n_points, n_block):
            points = slice(start, min(start + n_block, n_points))
            density_fluctuation, velocity = read_block(points)
            if mean_density is not None:
                density_fluctuation = density_fluctuation - mean_density[:, None]
            first_field = product.first_field(density_fluctuation) * root[points]
            flow = (velocity * root[points, None]).reshape(n_snapshots, -1)
            yield points, np.concatenate((first_field, flow), axis=1)

    factor = np.empty((0, n_snapshots))
    for _, rows in blocks():
        factor = np.asarray(np.linalg.qr(np.concatenate((factor, rows.T)), mode="r"), dtype=float)
    spectra = {
        name: _spectrum(name, factor, columns, n_modes[name]) for name, columns in snapshots.items()
    }
    modes: dict[str, Array] = {}
    for points, rows in blocks():
        n_dim = rows.shape[1] // (points.stop - points.start) - 1
        velocities = np.arange(n_dim * points.start, n_dim * points.stop)
        places = np.concatenate((np.arange(points.start, points.stop), n_points + velocities))
        for name, (_, to_modes) in spectra.items():
            if not points.start:
                modes[name] = np.empty((n_modes[name], (1 + n_dim) * n_points))
            modes[name][:, places] = to_modes @ rows
    bases = {}
    for name, (singular_values, _) in spectra.items():
        orthonormal = modes.pop(name)
        if _gram_error(orthonormal) > GRAM_TOLERANCE:  # the division by sigma lost digits
            q, triangle = np.linalg.qr(orthonormal.T)
            orthonormal = np.ascontiguousarray((q * np.sign(np.diag(triangle))).T)
        density, velocity = np.split(orthonormal, [n_points], axis=1)
        bases[name] = TrialBasis(
            density_modes=density / root,
            velocity_modes=velocity.reshape(len(velocity), n_points, -1) / root[:, None],
            singular_values={JOINT: singular_values},
            inner_product=product,
            weights=weights,
            separate_mean=mean_density is not None,
            gram_error=_gram_error(orthonormal),
        )
    return bases


def decomposition_bytes(n_snapshots: int, n_points: int) -> int:
    """Return the memory [bytes] of a decomposition that reads blocks of points (Eq. 3.14).

    It comprises the triangular factor and its copies, and the copies of one block.
    """
    return BYTES * (3 * n_snapshots**2 + BLOCK_COPIES * N_FIELD_VALUES * n_snapshots * n_points)


def smallest_block(n_snapshots: int) -> int:
    """Return the smallest number of points in a block: enough for a square matrix."""
    return -(-n_snapshots // N_FIELD_VALUES)


def _points_per_block(n_snapshots: int, ram_limit: int) -> int:
    """Return the number of points per block that fit into the limit, at least a square block's."""
    needed = decomposition_bytes(n_snapshots, smallest_block(n_snapshots))
    if needed > ram_limit:
        raise ResourceError(
            f"the basis of {n_snapshots} snapshots needs {needed / 2**20:.0f} MiB, more than the "
            f"limit of {ram_limit / 2**20:.0f} MiB: store fewer snapshots or raise the limit"
        )
    factors = decomposition_bytes(n_snapshots, 0)
    return (ram_limit - factors) // (decomposition_bytes(n_snapshots, 1) - factors)


def _spectrum(
    name: str, factor: Array, columns: NDArray[np.int64], n_modes: int
) -> tuple[Array, Array]:
    """Return singular values, and the combinations (n_modes, n_snapshots) that give the modes."""
    _, values, right = np.linalg.svd(factor[:, columns], full_matrices=False)
    # The error of each singular value is about rounding times the largest one.
    least = max(len(columns) * EPSILON * values[0], AT_REST)
    rank = int(np.count_nonzero(values > least))
    if rank == 0:
        raise ValueError(f"basis {name!r}: its snapshots are zero: does anything drive the flow?")
    if n_modes > rank:
        raise ValueError(
            f"basis {name!r}: {n_modes} modes requested, but its snapshots have the numerical rank "
            f"{rank}: request at most {rank} modes or store more snapshots"
        )
    right = right[:rank]
    strongest = np.take_along_axis(right, np.abs(right).argmax(axis=1)[:, None], axis=1)
    to_modes = np.zeros((n_modes, factor.shape[1]))
    to_modes[:, columns] = (right * np.sign(strongest) / values[:rank, None])[:n_modes]
    return values, to_modes


def _gram_error(modes: Array) -> float:
    return float(np.abs(modes @ modes.T - np.eye(len(modes))).max())
