"""Advection and gradients by sums over pairs: what the reduced model needs beside the functional.

Sources are sorted by cell and laid out as in `sphrom.kernels.sweeps`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sphrom.kernels.blocks import N_CHUNKS, list_candidates
from sphrom.kernels.cells import Grid, range_in_row, rows_within
from sphrom.kernels.jit import sweep, term
from sphrom.kernels.sweeps import DENSITY, VOLUME, U, V, X, Y
from sphrom.kernels.wendland import gradient_factor

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@term
def _transport_pairs(
    xi: float, yi: float, a: float, b: float, c: float, x: Array, y: Array, first: Array,
    second: Array, third: Array, volume: Array, inverse_length: float,
) -> tuple[float, float, float, float, float]:
    """Sum the pair terms of `transport`; the last two fields are the velocity that carries."""
    ta = tb = tc = sx = sy = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        weight = gradient_factor(math.sqrt(ox * ox + oy * oy), inverse_length) * volume[k]
        carried = (second[k] * ox + third[k] * oy) * weight
        ta += (first[k] - a) * carried
        tb += (second[k] - b) * carried
        tc += (third[k] - c) * carried
        sx += ox * weight
        sy += oy * weight
    return ta, tb, tc, sx, sy


@sweep
def transport(
    particle: Indices,
    targets: Indices,
    target: Array,
    source: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    reference_density: float,
    out: Array,
) -> None:
    """Compute the advection of density and velocity by the velocity, as Eq. 3.5-3.6 have it.

    As the shifting terms of the functional: sum (f_j - f_i) (u_j . offset) G + 2 f_i u_i . s_i.

    Parameters
    ----------
    target : the fluid's sources, of which `targets` are the particles.
    source : the sources to sum over: the same, or ghosts.
    out : (3, n_particles) rows: u . grad rho [kg/m3/s], u . grad u [m/s2].
    """
    for t in prange(targets.size):
        j = targets[t]
        xi = target[X, j]
        yi = target[Y, j]
        density = target[DENSITY, j]
        u = target[U, j]
        v = target[V, j]
        td = tu = tv = sx = sy = 0.0
        first, last = rows_within(yi, yi, reach, grid)
        for row in range(first, last):
            low, high = range_in_row(xi, yi, row, reach, grid, cell_start)
            b = _transport_pairs(
                xi, yi, density, u, v, source[X, low:high], source[Y, low:high],
                source[DENSITY, low:high], source[U, low:high], source[V, low:high],
                source[VOLUME, low:high], inverse_length,
            )
            td += b[0]
            tu += b[1]
            tv += b[2]
            sx += b[3]
            sy += b[4]
        i = particle[j]
        spread = 2.0 * (u * sx + v * sy)
        out[0, i] = td + (reference_density + density) * spread
        out[1, i] = tu + u * spread
        out[2, i] = tv + v * spread


@term
def _gradient_pairs(
    xi: float, yi: float, a: float, b: float, c: float, x: Array, y: Array, first: Array,
    second: Array, third: Array, volume: Array, inverse_length: float,
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Sum the pair terms of `gradients` over one range of sources."""
    lxx = lxy = lyy = ax = ay = bx = by = cx = cy = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        weight = gradient_factor(math.sqrt(ox * ox + oy * oy), inverse_length) * volume[k]
        wx = weight * ox
        wy = weight * oy
        lxx += ox * wx
        lxy += ox * wy
        lyy += oy * wy
        ax += (first[k] - a) * wx
        ay += (first[k] - a) * wy
        bx += (second[k] - b) * wx
        by += (second[k] - b) * wy
        cx += (third[k] - c) * wx
        cy += (third[k] - c) * wy
    return lxx, lxy, lyy, ax, ay, bx, by, cx, cy


@sweep
def gradients(
    particle: Indices,
    targets: Indices,
    block_start: Indices,
    source: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    scratch: Array,
    out: Array,
) -> None:
    """Compute renormalised gradients (Eq. 2.11) of the fields in DENSITY, U and V.

    Parameters
    ----------
    block_start : (n_blocks + 1,) where blocks begin among the targets.
    scratch : (N_CHUNKS, > VOLUME, longest list) memory to work in.
    out : (6, n_particles) rows: d/dx and d/dy of each field in turn.
    """
    n_blocks = block_start.size - 1
    for chunk in prange(N_CHUNKS):
        near = scratch[chunk, : VOLUME + 1]
        for block in range(chunk * n_blocks // N_CHUNKS, (chunk + 1) * n_blocks // N_CHUNKS):
            here = targets[block_start[block] : block_start[block + 1]]
            n = list_candidates(source, here, grid, cell_start, reach, near)
            for t in range(here.size):
                j = here[t]
                lxx, lxy, lyy, ax, ay, bx, by, cx, cy = _gradient_pairs(
                    source[X, j] - source[X, here[0]], source[Y, j] - source[Y, here[0]],
                    source[DENSITY, j], source[U, j], source[V, j], near[X, :n], near[Y, :n],
                    near[DENSITY, :n], near[U, :n], near[V, :n], near[VOLUME, :n], inverse_length,
                )
                i = particle[j]
                determinant = lxx * lyy - lxy * lxy
                out[0, i] = -(lyy * ax - lxy * ay) / determinant
                out[1, i] = -(lxx * ay - lxy * ax) / determinant
                out[2, i] = -(lyy * bx - lxy * by) / determinant
                out[3, i] = -(lxx * by - lxy * bx) / determinant
                out[4, i] = -(lyy * cx - lxy * cy) / determinant
                out[5, i] = -(lxx * cy - lxy * cx) / determinant
