"""Proper orthogonal decomposition of a streamed snapshot matrix (Eq. 3.13-3.14, 3.16).

The matrix S, one column a snapshot, is read in blocks of points and is never held as a whole. Its
R factor is built up block by block (TSQR), so that singular values are accurate to rounding times
the largest one; a Gram matrix would lose all below its square root. A second pass over the blocks
gives the modes S V / sigma. As S = Q R, any subset of the columns has the singular values and
right vectors of the same columns of R: one factorization serves every training set.

Shapes: density (n_snapshots, n_points), velocity (n_snapshots, n_points, 2), and modes likewise
with the mode first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sphrom.errors import ResourceError
from sphrom.reduction.trial_basis import InnerProduct, TrialBasis

Array = NDArray[np.float64]
ReadBlock = Callable[[slice], tuple[Array, Array]]
"""From a slice of points, the density fluctuation (n_snapshots, n_block) [kg/m3] and the velocity
(n_snapshots, n_block, 2) [m/s] of all snapshots there."""
FieldBasis = Literal["joint", "separate"]

GRAM_TOLERANCE = 1e-13
"""Modes whose Gram matrix is farther than this from the identity are orthonormalised once more."""
DEFAULT_RAM = 2**30
EPSILON = float(np.finfo(np.float64).eps)
N_FIELD_VALUES = 3
"""Values of a state at one point: the first field and two components of the velocity."""
BLOCK_COPIES = 5
"""Copies of a block of snapshots alive at once: as read, weighted, as rows, stacked on R, in QR."""
BYTES = 8
"""Of a number."""
AT_REST = 1e-100
"""Singular values that are lost where they are squared."""

PARTS: Mapping[FieldBasis, tuple[str, ...]] = {
    "joint": ("joint",),
    "separate": ("density", "velocity"),
}


def decompose(
    read_block: ReadBlock,
    n_points: int,
    n_snapshots: int,
    product: InnerProduct,
    volume: Array,
    n_modes: int,
    *,
    snapshots: Mapping[str, Sequence[int] | NDArray[np.int64]] | None = None,
    centred: bool = False,
    fields: FieldBasis = "joint",
    mean_density: Array | None = None,
    ram_limit: int = DEFAULT_RAM,
) -> dict[str, TrialBasis]:
    """Return a trial basis for each named set of snapshots (Eq. 3.13-3.14, 3.16).

    `snapshots` names the bases and the snapshots of each; by default one basis `all` has all of
    them. Each has `n_modes` modes; with `fields="separate"` as many for the density, then for the
    velocity. `centred` subtracts each set's own mean. `mean_density` (n_snapshots,) [kg/m3] is the
    weighted spatial mean of each snapshot's density fluctuation, which the bases then have carried
    apart. `volume` is (n_points,) [m2]. `ram_limit` bounds the blocks and the factors,
    beyond the modes themselves. A mode's sign is such that the snapshot in which it is strongest
    has a positive coordinate.

    Raises ValueError when a set has fewer independent snapshots than modes or a value is not
    finite, ResourceError when the limit is too small for the number of snapshots.
    """
    chosen = snapshots if snapshots is not None else {"all": range(n_snapshots)}
    sets = {name: _checked_snapshots(name, wanted, n_snapshots) for name, wanted in chosen.items()}
    if n_modes < 1:
        raise ValueError(f"a basis has at least one mode, not {n_modes}")
    if mean_density is not None:
        read_block, product = _stripped(read_block, mean_density), product.without_mean()
    # A centred basis never sees the constant part of the density: leaving it out avoids the
    # cancellation, and it is put back into the mean.
    streamed = replace(product, density_offset=0.0) if centred else product
    weights = product.weights(volume)
    n_block = _points_per_block(n_snapshots, len(PARTS[fields]), ram_limit)
    matrix = _SnapshotMatrix(read_block, n_points, n_snapshots, streamed, np.sqrt(weights), n_block)
    factors = _triangular_factors(matrix, PARTS[fields])
    spectra = {
        name: {part: _spectrum(factor, wanted, centred) for part, factor in factors.items()}
        for name, wanted in sets.items()
    }
    for name, by_part in spectra.items():
        _check_rank(name, by_part, n_modes, centred)
    combinations = {
        name: {
            part: _combination(spectrum, sets[name], n_modes, centred)
            for part, spectrum in by_part.items()
        }
        for name, by_part in spectra.items()
    }
    combined = _combine(matrix, combinations)
    return {
        name: replace(
            _trial_basis(combined[name], spectra[name], n_modes, product, weights),
            separate_mean=mean_density is not None,
        )
        for name in sets
    }


def _stripped(read_block: ReadBlock, mean_density: Array) -> ReadBlock:
    """Return a reader of blocks without the mean density fluctuation of each snapshot."""

    def read(points: slice) -> tuple[Array, Array]:
        density_fluctuation, velocity = read_block(points)
        return density_fluctuation - mean_density[:, None], velocity

    return read


@dataclass(frozen=True)
class _SnapshotMatrix:
    """The weighted snapshot matrix, read in blocks of points; a row is a snapshot here."""

    read_block: ReadBlock
    n_points: int
    n_snapshots: int
    product: InnerProduct
    root_weights: Array
    n_block: int

    def blocks(self) -> Iterator[tuple[slice, Array, Array]]:
        """Yield points, weighted first field (n_snapshots, n) and velocity (n_snapshots, 2 n)."""
        for start in range(0, self.n_points, self.n_block):
            points = slice(start, min(start + self.n_block, self.n_points))
            root = self.root_weights[points]
            density_fluctuation, velocity = self.read_block(points)
            first_field = self.product.first_field(density_fluctuation) * root
            yield points, first_field, (velocity * root[:, None]).reshape(self.n_snapshots, -1)


@dataclass(frozen=True)
class _Spectrum:
    """Singular values, and the combinations of snapshots that give the modes."""

    singular_values: Array
    to_modes: Array
    """(rank, n_snapshots): V^T / sigma, with the subtraction of the mean in it."""


def _checked_snapshots(
    name: str, wanted: Sequence[int] | NDArray[np.int64], n_snapshots: int
) -> NDArray[np.int64]:
    columns = np.asarray(wanted, dtype=np.int64)
    if columns.size == 0 or columns.min() < 0 or columns.max() >= n_snapshots:
        raise ValueError(f"basis {name!r}: its snapshots must be among the {n_snapshots} given")
    if np.unique(columns).size != columns.size:
        raise ValueError(f"basis {name!r}: it names a snapshot twice")
    return columns


def decomposition_bytes(n_snapshots: int, n_parts: int, n_points: int) -> int:
    """Return the memory [bytes] of a decomposition that reads blocks of points (Eq. 3.14).

    It is made of the triangular factors of each part, and the copies of one block.
    """
    factors = (n_parts + 2) * n_snapshots**2
    return BYTES * (factors + BLOCK_COPIES * N_FIELD_VALUES * n_snapshots * n_points)


def smallest_block(n_snapshots: int) -> int:
    """Return the least points of a block in a decomposition: enough for a square matrix."""
    return -(-n_snapshots // N_FIELD_VALUES)


def _points_per_block(n_snapshots: int, n_parts: int, ram_limit: int) -> int:
    """Return how many points fit into the limit; at least enough for a square block."""
    needed = decomposition_bytes(n_snapshots, n_parts, smallest_block(n_snapshots))
    if needed > ram_limit:
        raise ResourceError(
            f"the basis of {n_snapshots} snapshots needs {needed / 2**20:.0f} MiB, more than the "
            f"limit of {ram_limit / 2**20:.0f} MiB: store fewer snapshots or raise it"
        )
    factors = decomposition_bytes(n_snapshots, n_parts, 0)
    per_point = decomposition_bytes(n_snapshots, n_parts, 1) - factors
    return (ram_limit - factors) // per_point


def _rows(part: str, first_field: Array, velocity: Array) -> Array:
    if part == "joint":
        return np.concatenate((first_field, velocity), axis=1)
    return first_field if part == "density" else velocity


def _places(part: str, points: slice, n_points: int) -> NDArray[np.int64]:
    """Return where the rows of a block stand in a whole mode: density, then velocity."""
    density = np.arange(points.start, points.stop)
    velocity = np.arange(2 * points.start, 2 * points.stop)
    if part == "joint":
        return np.concatenate((density, n_points + velocity))
    return density if part == "density" else velocity


def _triangular_factors(matrix: _SnapshotMatrix, parts: Sequence[str]) -> dict[str, Array]:
    """Return R of the QR factorization of each part, by one pass over the blocks."""
    factors = {part: np.empty((0, matrix.n_snapshots)) for part in parts}
    for _, first_field, velocity in matrix.blocks():
        for part, factor in factors.items():
            rows = _rows(part, first_field, velocity)
            factors[part] = np.asarray(
                np.linalg.qr(np.concatenate((factor, rows.T)), mode="r"), dtype=float
            )
    if not all(np.all(np.isfinite(factor)) for factor in factors.values()):
        raise ValueError("the snapshots contain values that are not finite")
    return factors


def _spectrum(factor: Array, columns: NDArray[np.int64], centred: bool) -> _Spectrum:
    chosen = factor[:, columns]
    if centred:
        chosen = chosen - chosen.mean(axis=1, keepdims=True)
    _, values, right = np.linalg.svd(chosen, full_matrices=False)
    # The error of each singular value is about rounding times the largest one.
    least = max(len(columns) * EPSILON * values[0], AT_REST)
    right = right[: np.count_nonzero(values > least)]
    strongest = np.take_along_axis(right, np.abs(right).argmax(axis=1)[:, None], axis=1)
    right = right * np.sign(strongest) / values[: len(right), None]
    if centred:
        right = right - right.mean(axis=1, keepdims=True)
    to_modes = np.zeros((len(right), factor.shape[1]))
    to_modes[:, columns] = right
    return _Spectrum(values, to_modes)


def _check_rank(name: str, spectra: Mapping[str, _Spectrum], n_modes: int, centred: bool) -> None:
    for part, spectrum in spectra.items():
        rank = len(spectrum.to_modes)
        data = f"the {part} data of its snapshots{', their mean subtracted,' if centred else ''}"
        if rank == 0:
            raise ValueError(f"basis {name!r}: {data} are zero: does anything drive the flow?")
        if n_modes > rank:
            raise ValueError(
                f"basis {name!r}: {n_modes} modes asked for, but {data} are of numerical rank "
                f"{rank}: ask for at most {rank} modes or store more snapshots"
            )


def _combine(
    matrix: _SnapshotMatrix, combinations: Mapping[str, Mapping[str, Array]]
) -> dict[str, dict[str, Array]]:
    """Return weighted combinations of the snapshots, by basis and part, by a second pass."""
    n_values = {"joint": N_FIELD_VALUES, "density": 1, "velocity": N_FIELD_VALUES - 1}
    combined = {
        name: {
            part: np.empty((len(combination), n_values[part] * matrix.n_points))
            for part, combination in by_part.items()
        }
        for name, by_part in combinations.items()
    }
    for points, first_field, velocity in matrix.blocks():
        for name, by_part in combinations.items():
            for part, combination in by_part.items():
                places = _places(part, points, matrix.n_points)
                combined[name][part][:, places] = combination @ _rows(part, first_field, velocity)
    return combined


def _combination(
    spectrum: _Spectrum, columns: NDArray[np.int64], n_modes: int, centred: bool
) -> Array:
    """Return the combinations of snapshots that give the modes, and last the mean if centred."""
    if not centred:
        return spectrum.to_modes[:n_modes]
    mean = np.zeros((1, spectrum.to_modes.shape[1]))
    mean[0, columns] = 1.0 / len(columns)
    return np.concatenate((spectrum.to_modes[:n_modes], mean))


def _trial_basis(
    combined: Mapping[str, Array],
    spectra: Mapping[str, _Spectrum],
    n_modes: int,
    product: InnerProduct,
    weights: Array,
) -> TrialBasis:
    root, n_points = np.sqrt(weights), len(weights)
    parts = {part: _orthonormalised(values[:n_modes]) for part, values in combined.items()}
    fields = [_split(part, modes, n_points) for part, modes in parts.items()]
    means = [_split(part, values[n_modes:], n_points) for part, values in combined.items()]
    mean_density = sum(density for density, _ in means) / root + product.density_offset
    mean_velocity = sum(velocity for _, velocity in means) / root[:, None]
    return TrialBasis(
        density_modes=np.concatenate([density for density, _ in fields]) / root,
        velocity_modes=np.concatenate([velocity for _, velocity in fields]) / root[:, None],
        offset=(mean_density[0], mean_velocity[0]) if len(mean_density) else None,
        singular_values={part: spectrum.singular_values for part, spectrum in spectra.items()},
        inner_product=product,
        weights=weights,
        gram_error=max(_gram_error(modes) for modes in parts.values()),
    )


def _split(part: str, modes: Array, n_points: int) -> tuple[Array, Array]:
    """Return density and velocity of modes; where a part has no such field it is zero."""
    density, velocity = np.zeros((len(modes), n_points)), np.zeros((len(modes), n_points, 2))
    if part != "velocity":
        density = modes[:, :n_points]
    if part != "density":
        velocity = modes[:, -2 * n_points :].reshape(velocity.shape)
    return density, velocity


def _gram_error(modes: Array) -> float:
    return float(np.abs(modes @ modes.T - np.eye(len(modes))).max())


def _orthonormalised(modes: Array) -> Array:
    """Return the modes, orthonormalised from the first on where the division lost digits."""
    if _gram_error(modes) <= GRAM_TOLERANCE:
        return modes
    orthonormal, triangle = np.linalg.qr(modes.T)
    return np.ascontiguousarray((orthonormal * np.sign(np.diag(triangle))).T)
