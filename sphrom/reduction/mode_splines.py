"""What splines of the modes can do, of whatever kind they are.

There are two: the paper's local polyharmonic ones, which take points wherever they are
(`sphrom.reduction.spline`), and tensor-product B-splines on a lattice (`sphrom.reduction.bspline`).
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sphrom.reduction.trial_basis import TrialBasis, kept_modes

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class ModeSplines(Protocol):
    """Splines of `n_columns` functions over a domain."""

    @property
    def n_columns(self) -> int:
        """Number of functions."""

    def values(self, positions: ArrayLike) -> Array:
        """Return all columns (n_positions, n_columns) at positions (n_positions, 2) [m]."""

    def gradients(self, positions: ArrayLike) -> Array:
        """Return all gradients (n_positions, n_columns, 2) [1/m] at positions [m]."""

    def values_and_gradients(self, positions: ArrayLike) -> tuple[Array, Array]:
        """Return what `values` and `gradients` do, in one pass."""

    def evaluate(self, x: Array, y: Array, out: Array | None = None) -> Array:
        """Return all columns at coordinates (n_positions,) [m], written to `out` if given."""

    def evaluate_with_gradients(
        self, x: Array, y: Array, values: Array | None = None, gradients: Array | None = None
    ) -> tuple[Array, Array]:
        """Return all columns and gradients at coordinates, written to arrays if given."""

    def combine(self, coefficients: ArrayLike) -> ModeSplines:
        """Return splines of linear combinations (n_columns, n_combinations) of the columns."""

    def select(self, chosen: Indices) -> ModeSplines:
        """Return the splines of some columns."""


def checked_factors(coefficients: ArrayLike, n_columns: int) -> Array:
    """Return coefficients as an array (n_columns, n_combinations).

    Raises
    ------
    ValueError
        If they do not fit the columns.
    """
    factors = np.asarray(coefficients, dtype=np.float64)
    if factors.ndim != 2 or factors.shape[0] != n_columns:
        raise ValueError(f"coefficients must be ({n_columns}, n_combinations), not {factors.shape}")
    return factors


def coordinates(positions: ArrayLike, name: str) -> tuple[Array, Array]:
    """Return positions (n, 2) as x and y (n,) each.

    Raises
    ------
    ValueError
        If they have another shape.
    """
    position = np.asarray(positions, dtype=np.float64)
    if position.ndim != 2 or position.shape[1] != 2:
        raise ValueError(f"{name} must be (n, 2), not {position.shape}")
    return np.ascontiguousarray(position[:, 0]), np.ascontiguousarray(position[:, 1])


def checked_values(values: ArrayLike, n_points: int) -> Array:
    """Return values as an array (n_points, n_columns).

    Raises
    ------
    ValueError
        If they have another shape, or are not finite.
    """
    right = np.asarray(values, dtype=np.float64)
    if right.ndim != 2 or right.shape[0] != n_points or right.shape[1] == 0:
        raise ValueError(f"values must be ({n_points}, n_columns), not {right.shape}")
    if not np.all(np.isfinite(right)):
        raise ValueError("values must be finite")
    return right


def basis_columns(basis: TrialBasis) -> Array:
    """Return a basis as columns (n_points, 3 n_modes): first field and velocity, mode by mode.

    The mean of a centred basis stands last, as if it were a mode more.
    """
    modes = np.concatenate((basis.density_modes[..., None], basis.velocity_modes), axis=2)
    if basis.offset is not None:
        mean = np.concatenate((basis.offset[0][:, None], basis.offset[1]), axis=1)
        modes = np.concatenate((modes, mean[None]))
    return np.ascontiguousarray(modes.transpose(1, 0, 2).reshape(modes.shape[1], -1))


def first_modes(splines: ModeSplines, basis: TrialBasis, n_modes: int) -> ModeSplines:
    """Return the splines of a basis's first modes (of each part), and of its mean."""
    modes = kept_modes(basis, n_modes)
    if basis.offset is not None:
        modes = np.append(modes, basis.n_modes)
    return splines.select((3 * modes[:, None] + np.arange(3)).ravel())
