"""Interpolation of the fluid's fields to the ghosts of walls (Eq. 2.15).

`source` is laid out as in `sphrom.kernels.fields`. Ghosts without fluid nearby get zero.
"""

from __future__ import annotations

import math

from numba import prange

from sphrom.arrays import Array
from sphrom.kernels.cells import Search, range_in_row, rows_within
from sphrom.kernels.fields import X, Y, vector_at
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.sums import damping_row, mean_row, over_rows
from sphrom.kernels.wendland import kernel


@parallel
def ghost_means(ghost: Array, source: Array, search: Search, out: Array) -> None:
    """Interpolate the fluid's density fluctuation and velocity to ghosts (Eq. 2.15).

    Parameters
    ----------
    ghost : (2, n_ghosts) positions [m].
    source : the fluid's sources.
    out : (5, n_ghosts) rows: density fluctuation [kg/m3] and velocity x, y [m/s], zero without
        fluid nearby; the sum of the kernel [1/m2]; the flux phi towards the ghost [1/s].
    """
    for i in prange(ghost.shape[1]):
        zeros = (0.0, 0.0, 0.0, 0.0, 0.0)
        place = vector_at(ghost, 0, i)
        sums = over_rows(mean_row, zeros, place, None, source, search, None)
        weights, density, u, v, flux = sums
        scale = 1.0 / weights if weights > 0.0 else 0.0
        out[0, i] = density * scale
        out[1, i] = u * scale
        out[2, i] = v * scale
        out[3, i] = weights
        out[4, i] = flux


@term
def _head_pairs(
    xi: float,
    yi: float,
    x: Array,
    y: Array,
    force_x: Array,
    force_y: Array,
    inverse_length: float,
) -> float:
    """Sum the pair terms of `ghost_heads` over one range of fluid sources."""
    # By hand: with vectors the last digits of these sums change.
    total = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        along = force_x[k] * ox + force_y[k] * oy
        total += along * kernel(math.sqrt(ox * ox + oy * oy), inverse_length)
    return total


@parallel
def ghost_heads(
    ghost: Array, source: Array, force: Array, weights: Array, search: Search, out: Array
) -> None:
    """Compute the contribution of a body force to the pressure at ghosts (Eq. 2.15).

    Parameters
    ----------
    force : (2, n_sources) density times body force at the fluid's sources [N/m3].
    weights : (n_ghosts,) the sum of the kernel at ghosts [1/m2].
    out : (n_ghosts,) pressure [Pa].
    """
    for i in prange(ghost.shape[1]):
        xi = ghost[0, i]
        yi = ghost[1, i]
        total = 0.0
        first, last = rows_within(yi, yi, search)
        for row in range(first, last):
            low, high = range_in_row(xi, yi, row, search)
            total += _head_pairs(
                xi,
                yi,
                source[X, low:high],
                source[Y, low:high],
                force[0, low:high],
                force[1, low:high],
                search.inverse_length,
            )
        out[i] = total / weights[i] if weights[i] > 0.0 else 0.0


@parallel
def ghost_damping(
    ghost: Array, source: Array, values: Array, weights: Array, search: Search, out: Array
) -> None:
    """Add the pressure of the fluid's damper to ghosts, interpolated as in Eq. 2.15.

    Parameters
    ----------
    values : (n_sources,) the damper's pressure over c0^2 at the fluid's sources [kg/m3].
    weights : (n_ghosts,) the sum of the kernel at ghosts [1/m2].
    out : (n_ghosts,) [kg/m3].
    """
    for i in prange(ghost.shape[1]):
        place = vector_at(ghost, 0, i)
        pressure = over_rows(damping_row, 0.0, place, None, source, search, values)
        if weights[i] > 0.0:
            out[i] += pressure / weights[i]
