"""The modes of a trial basis as fields at fixed points, with gradients.

The first field of a state is q = c0 rho'/rho0 [m/s], as in the acoustic inner product
(`sphrom.reduction.trial_basis`), whatever product the basis has. In the raw product, of the full
density with unit weights, states also have a constant part: one more field, with coordinate one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.trial_basis import TrialBasis, weighted_mean
from sphrom.sph.fixed_points import FixedPoints, Rows

BLOCK_VALUES = 2**21
"""Number of values of a field in a block of points."""

Gradients = Callable[[Rows], Array]
"""Return gradients (1 + n_dim, n_dim, n, n_fields) [1/s] of q and velocity at some points."""


@dataclass(frozen=True)
class ModeFields:
    """The modes as fields at the points, followed by the constant part of a state, if any."""

    scaled_density: Array
    """q (n_points, n_fields) [m/s]."""
    velocity: Array
    """(n_dim, n_points, n_fields) [m/s]."""
    density_ratio: float
    """q over the first field of the basis: one in the acoustic product."""
    n_modes: int
    """Number of leading fields that are modes; one more is the constant part, if any."""

    @property
    def n_fields(self) -> int:
        """Number of fields: the modes, and the constant part, if any."""
        return self.scaled_density.shape[1]


def mode_fields(basis: TrialBasis, points: FixedPoints) -> ModeFields:
    """Return the modes of a basis as fields."""
    product = basis.inner_product
    ratio = points.density_scale / product.density_scale
    density = basis.density_modes
    velocity = basis.velocity_modes
    if product.density_offset != 0.0:
        constant = np.full_like(density[:1], -product.density_offset)
        density = np.concatenate((density, constant))
        velocity = np.concatenate((velocity, np.zeros_like(velocity[:1])))
    return ModeFields(
        scaled_density=np.ascontiguousarray(ratio * density.T),
        velocity=np.ascontiguousarray(velocity.transpose(2, 1, 0)),
        density_ratio=ratio,
        n_modes=basis.n_modes,
    )


def weighted_rows(basis: TrialBasis, fields: ModeFields, rows: Rows) -> Array:
    """Return the weights (n_modes, 1 + n_dim, n) of the rates of q and velocity at some points.

    The weighted sum of the rates over all points is the projection (Eq. 3.21).
    """
    weights = basis.weights[rows]
    density = basis.density_modes[:, rows] * (weights / fields.density_ratio)
    velocity = basis.velocity_modes[:, rows] * weights[:, None]
    return np.concatenate((density[:, None], velocity.transpose(0, 2, 1)), axis=1)


def summed_gradients(points: FixedPoints, scaled_density: Array, velocity: Array) -> Gradients:
    """Return the gradients of fields at all points by renormalised sums (Eq. 2.11)."""
    parts = (scaled_density, *velocity)
    return lambda rows: np.stack([points.gradients(part, rows) for part in parts])


def mode_gradients(
    points: FixedPoints, fields: ModeFields, splines: ModeSplines | None
) -> Gradients:
    """Return the gradients of the fields, by splines or renormalised sums (Eq. 2.11).

    Splines have the first field and the velocity of each mode; the constant part needs none.
    """
    if splines is None:
        return summed_gradients(points, fields.scaled_density, fields.velocity)

    def by_splines(rows: Rows) -> Array:
        gradients = splines.values_and_gradients(points.position[rows])[1]
        n_dim = gradients.shape[2]
        out = np.zeros((1 + n_dim, n_dim, len(gradients), fields.n_fields))
        by_column = gradients.reshape(len(gradients), fields.n_modes, 1 + n_dim, n_dim)
        out[..., : fields.n_modes] = by_column.transpose(2, 3, 0, 1)
        out[0] *= fields.density_ratio
        return out

    return by_splines


def blocks(n_points: int, size: int) -> Iterator[slice]:
    """Yield blocks of at most `size` points each, and at least one point."""
    for first in range(0, n_points, max(1, size)):
        yield slice(first, min(first + max(1, size), n_points))


class FieldProjections:
    """Products of states with the modes, separately for the velocity and q."""

    def __init__(self, basis: TrialBasis, fields: ModeFields) -> None:
        self._share = basis.weights / basis.weights.sum()
        density = fields.scaled_density.T
        density = density - weighted_mean(density, self._share)[:, None]
        velocity = fields.velocity.transpose(2, 0, 1).reshape(fields.n_fields, -1)
        self._columns = velocity, density
        self._weights = np.tile(self._share, len(fields.velocity)), self._share
        pairs = zip(self._columns, self._weights, strict=True)
        self.gram = np.stack([(columns * weights) @ columns.T for columns, weights in pairs])
        """(2, n_fields, n_fields) products of the modes with each other."""

    def products(self, scaled_density: Array, velocity: Array) -> tuple[Array, Array]:
        """Return projections (n_states, 2, n_fields) and squares (n_states, 2) of states.

        `scaled_density` is q (n_states, n_points) and `velocity` (n_states, n_points, n_dim), both
        in [m/s].
        """
        density = scaled_density - weighted_mean(scaled_density, self._share)[:, None]
        states = velocity.transpose(0, 2, 1).reshape(len(velocity), -1), density
        weighted = [state * w for state, w in zip(states, self._weights, strict=True)]
        projections = [w @ columns.T for w, columns in zip(weighted, self._columns, strict=True)]
        squares = [np.sum(w * state, axis=1) for w, state in zip(weighted, states, strict=True)]
        return np.stack(projections, axis=1), np.stack(squares, axis=1)
