"""The common interface of the splines of modes.

There are two kinds: the paper's local polyharmonic splines through any points, and tensor-product
B-splines on a lattice (`sphrom.reduction.spline`, `sphrom.reduction.lattice_splines`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from sphrom.arrays import Array, Indices
from sphrom.declaration import Record, dataset
from sphrom.reduction.trial_basis import TrialBasis

CELL_WIDTH_RATIO = 3.0
"""Cell width over the spacing of points; each cell's system has 81 points. At 2 (36 points) the
error of a cubic spline is six times larger and evaluation 1.5 times faster; at 4 (144 points) the
error is three times smaller and evaluation 1.5 times slower."""

Vector = tuple[Array, ...]
"""Coordinates (n_positions,) by axis [m]."""
Values = Callable[[Array], Array]
"""Return fields (n_positions, (1 + n_dim) n_modes) of modes at positions (n_positions, n_dim)."""


class ModeSplines(ABC):
    """Splines of `n_columns` functions over a domain."""

    @property
    @abstractmethod
    def n_columns(self) -> int:
        """Number of functions."""

    @abstractmethod
    def combine(self, coefficients: ArrayLike) -> ModeSplines:
        """Return splines of linear combinations (n_columns, n_combinations) of the functions."""

    @abstractmethod
    def first(self, n_modes: int) -> ModeSplines:
        """Return the splines of the first modes, of `1 + n_dim` functions each."""

    @abstractmethod
    def _fill(self, place: Vector, *out: Array) -> None:
        """Fill values (n_positions, n_columns) at coordinates (n_positions,) by axis [m].

        A second array is filled with gradients (n_positions, n_columns, n_dim).
        """

    def values(self, positions: ArrayLike, out: Array | None = None) -> Array:
        """Return all functions (Eq. 3.20) at positions (n_positions, n_dim) [m].

        Along periodic axes any position is valid. Along the others, positions beyond the points are
        extrapolated from the nearest cell. The result is NaN where there is no spline.

        `out` (n_positions, n_columns) is a C-contiguous array to write to; by default a new one.
        """
        place = coordinates(positions)
        out = np.empty((place[0].size, self.n_columns)) if out is None else out
        self._fill(place, out)
        return out

    def values_and_gradients(self, positions: ArrayLike) -> tuple[Array, Array]:
        """Return all functions, and their gradients (n_positions, n_columns, n_dim) [1/m]."""
        place = coordinates(positions)
        values = np.empty((place[0].size, self.n_columns))
        gradients = np.empty((*values.shape, len(place)))
        self._fill(place, values, gradients)
        return values, gradients


class CellSplines(Record):
    """The local polyharmonic splines of one basis."""

    cell_shape: Indices = dataset(
        "component", "1", "number of cells along each direction", equation="Alg. 3.2"
    )
    cell_start: Indices = dataset(
        "cell_boundary", "1", "first point of each cell's system, and one past the last",
        equation="Alg. 3.3",
    )  # fmt: skip
    points: Array = dataset(
        "component point", "cell widths", "points of each cell's system, from the cell's centre",
        "x_G", "Eq. 3.17",
    )  # fmt: skip
    radial_weights: Array = dataset(
        "column point", "of the modes",
        "weights of the radial functions, a column for each mode and field", "xi", "Eq. 3.19",
    )  # fmt: skip
    polynomial_weights: Array = dataset(
        "cell term column", "of the modes", "weights of the polynomial", "eta", "Eq. 3.19"
    )
    condition_number: Array = dataset(
        "cell", "1",
        "condition number of each cell's system; zero where a cell in the solid has none",
        equation="Eq. 3.19",
    )  # fmt: skip


class LatticeCoefficients(Record):
    """The B-splines of one basis."""

    lattice_shape: Indices = dataset(
        "component", "1", "number of reference points along each direction"
    )
    coefficients: Array = dataset(
        "node_row node column", "of the modes",
        "coefficients of the B-splines around each point, for each mode and field",
        equation="Eq. 3.20",
    )  # fmt: skip


def coordinates(positions: ArrayLike) -> Vector:
    """Return positions (n, n_dim) as coordinates (n,) by axis."""
    return tuple(np.ascontiguousarray(x) for x in np.asarray(positions, dtype=np.float64).T)


def basis_columns(basis: TrialBasis) -> Array:
    """Return first field and velocity, mode by mode, as columns (n_points, (1 + n_dim) n_modes)."""
    modes = np.concatenate((basis.density_modes[..., None], basis.velocity_modes), axis=2)
    return np.ascontiguousarray(modes.transpose(1, 0, 2).reshape(modes.shape[1], -1))
