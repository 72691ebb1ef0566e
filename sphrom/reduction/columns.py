"""A trial basis as fields at fixed points, in the acoustic scaling, with their gradients.

The first field of a state is q = c0 rho'/rho0 [m/s] here, whatever the basis's inner product. A
basis may have a mean, and the raw product a constant density: both are one more column, whose
coordinate is one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import FixedPoints, Rows

Array = NDArray[np.float64]
Gradients = Callable[[Rows], Array]
"""From some points, the gradients (3, 2, n, n_columns) [1/s] of all columns there."""


@dataclass(frozen=True)
class Columns:
    """Modes, and what is constant in a state, as fields at the points."""

    scaled_density: Array
    """q (n_points, n_columns) [m/s]."""
    velocity: Array
    """(2, n_points, n_columns) [m/s]."""
    density_ratio: float
    """q over the first field of the basis: one in the acoustic product."""
    n_modes: int
    """The first columns; one more holds what is constant, if anything is."""

    @property
    def n_columns(self) -> int:
        """Modes, and one more where something is constant."""
        return self.scaled_density.shape[1]

    def coefficients(self, coordinates: Array) -> Array:
        """Return what columns are multiplied with, from coordinates (n_modes,)."""
        return np.append(coordinates, np.ones(self.n_columns - self.n_modes))


def columns(basis: TrialBasis, points: FixedPoints) -> Columns:
    """Return a basis as columns."""
    product = basis.inner_product
    ratio = points.density_scale / product.density_scale
    density, velocity = basis.density_modes, basis.velocity_modes
    if basis.offset is not None or product.density_offset != 0.0:
        first, flow = basis.offset or (np.zeros_like(density[0]), np.zeros_like(velocity[0]))
        density = np.concatenate((density, (first - product.density_offset)[None]))
        velocity = np.concatenate((velocity, flow[None]))
    return Columns(
        scaled_density=np.ascontiguousarray(ratio * density.T),
        velocity=np.ascontiguousarray(velocity.transpose(2, 1, 0)),
        density_ratio=ratio,
        n_modes=basis.n_modes,
    )


def weighted_rows(basis: TrialBasis, fields: Columns, rows: Rows) -> Array:
    """Return what rates of q and of the velocity are weighed with (n_modes, 3, n) at some points.

    Their sums over all points are the projection's (Eq. 3.21).
    """
    weights = basis.weights[rows]
    density = basis.density_modes[:, rows] * (weights / fields.density_ratio)
    velocity = basis.velocity_modes[:, rows] * weights[:, None]
    return np.concatenate((density[:, None], velocity.transpose(0, 2, 1)), axis=1)


def column_gradients(
    points: FixedPoints, fields: Columns, splines: ModeSplines | None
) -> Gradients:
    """Return the columns' gradients, by splines or by renormalised sums over points (Eq. 2.11).

    Splines are of the basis's first field and velocity, by mode, and last of its mean if it has
    one; a constant density needs none.

    Raises
    ------
    ValueError
        When the splines are not those of the columns.
    """
    return _sph_gradients(points, fields) if splines is None else _of(splines, points, fields)


def _sph_gradients(points: FixedPoints, fields: Columns) -> Gradients:
    def gradients(rows: Rows) -> Array:
        parts = (fields.scaled_density, *fields.velocity)
        return np.stack([points.gradients(part, rows) for part in parts])

    return gradients


def _of(splines: ModeSplines, points: FixedPoints, fields: Columns) -> Gradients:
    n_splined = splines.n_columns // 3
    if splines.n_columns % 3 or not fields.n_modes <= n_splined <= fields.n_columns:
        raise ValueError(f"{splines.n_columns} splines are not those of {fields.n_modes} modes")

    def gradients(rows: Rows) -> Array:
        found = splines.gradients(points.position[rows])
        out = np.zeros((3, 2, len(found), fields.n_columns))
        by_column = found.reshape(len(found), n_splined, 3, 2)
        out[..., :n_splined] = by_column.transpose(2, 3, 0, 1)
        out[0] *= fields.density_ratio
        return out

    return gradients
