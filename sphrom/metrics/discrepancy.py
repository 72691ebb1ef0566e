"""Figures of merit: errors of one field against another (Eq. 4.1), compression (Eq. 4.2-4.3).

Eq. 4.1 divides by a range, max - min of the reference. Over which points it is taken matters more
than the error: a few points with large values, such as the corners under a lid, make any error
small. A comparison of part of a field therefore names its range: that of the part or the whole.

Arrays are (n_snapshots, n_points) or (n_points,): the last axis, or the last two of a vector
field, is one instant, and each function returns one figure per instant. A figure that isn't finite,
as of fields that aren't or relative to nothing, is refused with ValueError.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RANGE_TOLERANCE = 8.0 * float(np.finfo(np.float64).eps)
"""A range below this part of the largest value is rounding, hence zero."""


def instantaneous_range(reference: Array) -> Array:
    """Return max - min over the points of every instant, 0 where it is only rounding."""
    extent = np.asarray(reference.max(axis=-1) - reference.min(axis=-1))
    return np.where(extent > RANGE_TOLERANCE * np.abs(reference).max(axis=-1), extent, 0.0)


def relative_discrepancy(
    approximation: Array, reference: Array, *, range_over: Array | None = None
) -> Array:
    """Return 100 mean|error| / (max - min) of the reference at that instant [%] (Eq. 4.1).

    The range is that of `range_over` (..., n_other_points) at each instant where it is given, such
    as the whole of a field of which `reference` is a line.

    Raises ValueError for a field that isn't finite, or a range of zero at some instant.
    """
    extent = instantaneous_range(reference if range_over is None else range_over)
    return _relative(np.abs(approximation - reference).mean(axis=-1), extent)


def relative_l2(approximation: Array, reference: Array, *, field_axes: int = 1) -> Array:
    """Return 100 |error| / |reference| in the L2 norm of every instant [%].

    `field_axes` is 1 for scalars (..., n_points), 2 for vectors (..., n_points, n_dim); one more
    makes it the norm over points and time. Raises ValueError for a field that isn't finite, or a
    reference of zero.
    """
    axes = tuple(range(-field_axes, 0))
    error, norm = (np.sqrt(np.sum(f**2, axis=axes)) for f in (approximation - reference, reference))
    return _relative(error, norm)


def relative_error_at(points: NDArray[np.bool_], approximation: Array, reference: Array) -> Array:
    """Return 100 rms|error| over some points / rms|reference| over all of every instant [%].

    Fields are (..., n_points, n_dim), `points` (n_points,) tells which. Over all points it is the
    relative L2 error. Raises ValueError as `relative_l2` does.
    """
    squares = np.sum((approximation - reference) ** 2, axis=-1)[..., points].mean(axis=-1)
    scale = np.sum(reference**2, axis=-1).mean(axis=-1)
    return 100.0 * np.sqrt(_relative(squares, scale, 1.0))


def without_mean(field: Array) -> Array:
    """Return a field less its spatial mean: in a closed box the mean pressure is a gauge."""
    return field - field.mean(axis=-1, keepdims=True)


def _relative(errors: Array, scale: Array, factor: float = 100.0) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        found = factor * errors / scale
    if not np.all(np.isfinite(found)):
        raise ValueError("no error: a field is not finite, or the reference is constant or zero")
    return np.asarray(found)


def compression_factor(n_particles: int, n_modes: int, n_dim: int = 2) -> float:
    """Return N_d / M with the (2n + 1) N values of the full state (Eq. 4.2 inverted, as used)."""
    return (2 * n_dim + 1) * n_particles / n_modes


def field_compression_factor(n_particles: int, n_modes: int, n_dim: int = 2) -> float:
    """Return (n + 1) N / M: density and velocity, which are the reduced fields, over modes."""
    return (n_dim + 1) * n_particles / n_modes


def cumulative_singular_value_share(singular_values: Array) -> Array:
    """Return 100 sum_1^M sigma / sum sigma [%] for M = 1, 2, ... (Eq. 4.3 as printed)."""
    return _relative(np.cumsum(singular_values), singular_values.sum())


def energy(singular_values: Array) -> Array:
    """Return 100 sum_1^M sigma^2 / sum sigma^2 [%] for M = 1, 2, ...: the share of variance."""
    return cumulative_singular_value_share(singular_values**2)
