"""Interpolation of the fluid's fields to the ghosts of walls (Eq. 2.15).

`source` is laid out as in `sphrom.kernels.sweeps`. Ghosts without fluid nearby get zero.
"""

from __future__ import annotations

import math

from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.cells import Grid, range_in_row, rows_within
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.sweeps import DENSITY, VOLUME, U, V, X, Y
from sphrom.kernels.wendland import gradient_factor, kernel


@term
def _mean_pairs(
    xi: float,
    yi: float,
    x: Array,
    y: Array,
    density: Array,
    us: Array,
    vs: Array,
    volume: Array,
    inverse_length: float,
) -> tuple[float, float, float, float, float]:
    """Sum the pair terms of `ghost_means` over one range of fluid sources."""
    weights = densities = u = v = flux = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        distance = math.sqrt(ox * ox + oy * oy)
        weight = kernel(distance, inverse_length)
        weights += weight
        densities += density[k] * weight
        u += us[k] * weight
        v += vs[k] * weight
        factor = gradient_factor(distance, inverse_length) * volume[k]
        flux -= (us[k] * ox + vs[k] * oy) * factor
    return weights, densities, u, v, flux


@parallel
def ghost_means(
    ghost: Array,
    source: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    out: Array,
) -> None:
    """Interpolate the fluid's density fluctuation and velocity to ghosts (Eq. 2.15).

    Parameters
    ----------
    ghost : (2, n_ghosts) positions [m].
    source : the fluid's sources.
    out : (5, n_ghosts) rows: density fluctuation [kg/m3] and velocity x, y [m/s], zero without
        fluid nearby; the sum of the kernel [1/m2]; the flux phi towards the ghost [1/s].
    """
    for i in prange(ghost.shape[1]):
        xi = ghost[0, i]
        yi = ghost[1, i]
        weights = density = u = v = flux = 0.0
        first, last = rows_within(yi, yi, reach, grid)
        for row in range(first, last):
            low, high = range_in_row(xi, yi, row, reach, grid, cell_start)
            b = _mean_pairs(
                xi,
                yi,
                source[X, low:high],
                source[Y, low:high],
                source[DENSITY, low:high],
                source[U, low:high],
                source[V, low:high],
                source[VOLUME, low:high],
                inverse_length,
            )
            weights += b[0]
            density += b[1]
            u += b[2]
            v += b[3]
            flux += b[4]
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
    total = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        along = force_x[k] * ox + force_y[k] * oy
        total += along * kernel(math.sqrt(ox * ox + oy * oy), inverse_length)
    return total


@parallel
def ghost_heads(
    ghost: Array,
    source: Array,
    force: Array,
    weights: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    out: Array,
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
        first, last = rows_within(yi, yi, reach, grid)
        for row in range(first, last):
            low, high = range_in_row(xi, yi, row, reach, grid, cell_start)
            total += _head_pairs(
                xi,
                yi,
                source[X, low:high],
                source[Y, low:high],
                force[0, low:high],
                force[1, low:high],
                inverse_length,
            )
        out[i] = total / weights[i] if weights[i] > 0.0 else 0.0


@term
def _damping_pairs(
    xi: float, yi: float, x: Array, y: Array, values: Array, inverse_length: float
) -> float:
    """Sum the pair terms of `ghost_damping` over one range of fluid sources."""
    total = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        total += values[k] * kernel(math.sqrt(ox * ox + oy * oy), inverse_length)
    return total


@parallel
def ghost_damping(
    ghost: Array,
    source: Array,
    values: Array,
    weights: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    out: Array,
) -> None:
    """Add the pressure of the fluid's damper to ghosts, interpolated as in Eq. 2.15.

    Parameters
    ----------
    values : (n_sources,) the damper's pressure over c0^2 at the fluid's sources [kg/m3].
    weights : (n_ghosts,) the sum of the kernel at ghosts [1/m2].
    out : (n_ghosts,) [kg/m3].
    """
    for i in prange(ghost.shape[1]):
        xi = ghost[0, i]
        yi = ghost[1, i]
        total = 0.0
        first, last = rows_within(yi, yi, reach, grid)
        for row in range(first, last):
            low, high = range_in_row(xi, yi, row, reach, grid, cell_start)
            total += _damping_pairs(
                xi, yi, source[X, low:high], source[Y, low:high], values[low:high], inverse_length
            )
        if weights[i] > 0.0:
            out[i] += total / weights[i]
