"""Advection and gradients by sums over pairs, which reduced models use beside the functional.

Sources are sorted by cell and laid out as in `sphrom.kernels.sweeps`.
"""

from __future__ import annotations

import math

from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.blocks import N_CHUNKS, list_candidates
from sphrom.kernels.cells import Grid, range_in_row, rows_within
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.sweeps import (
    DENSITY,
    VOLUME,
    RegularityConstants,
    U,
    V,
    X,
    Y,
    finish_regularity,
    shifting_push,
)
from sphrom.kernels.wendland import gradient_factor, kernel, laplacian_weight

FIRST = VOLUME + 1
"""The first row of `source` with additional fields for gradients."""


@term
def _transport_pairs(
    xi: float,
    yi: float,
    a: float,
    b: float,
    c: float,
    x: Array,
    y: Array,
    first: Array,
    second: Array,
    third: Array,
    volume: Array,
    depth: Array,
    nearness: float,
    inverse_length: float,
) -> tuple[float, float, float, float, float]:
    """Sum the pair terms of `transport`; the last two fields are the carrying velocity."""
    ta = tb = tc = sx = sy = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        weight = gradient_factor(math.sqrt(ox * ox + oy * oy), inverse_length) * volume[k]
        stretch = 1.0 + depth[k] * nearness
        jump_b = stretch * (second[k] - b)
        jump_c = stretch * (third[k] - c)
        carried = ((b + jump_b) * ox + (c + jump_c) * oy) * weight
        ta += (first[k] - a) * carried
        tb += jump_b * carried
        tc += jump_c * carried
        sx += ox * weight
        sy += oy * weight
    return ta, tb, tc, sx, sy


@parallel
def transport(
    particle: Indices,
    targets: Indices,
    target: Array,
    distance: Array,
    source: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    depth: Array,
    reference_density: float,
    out: Array,
) -> None:
    """Compute the advection of density and velocity by the velocity, as in Eq. 3.5-3.6.

    It has the form of the shifting terms: sum (f_j - f_i) (u_j . offset) G + 2 f_i u_i . s_i.

    Parameters
    ----------
    target : the fluid's sources, of which `targets` are the particles.
    distance : (n_targets,) from the wall [m]; infinite if the sources are fluid.
    source : the sources of the sums: the same, or ghosts.
    depth : (n_sources,) depth of ghosts for the extrapolation of velocities, else 0 [m].
    out : (3, n_particles) rows: u . grad rho [kg/m3/s], u . grad u [m/s2].
    """
    for t in prange(targets.size):
        j = targets[t]
        xi = target[X, j]
        yi = target[Y, j]
        density = target[DENSITY, j]
        u = target[U, j]
        v = target[V, j]
        nearness = 1.0 / distance[t]
        td = tu = tv = sx = sy = 0.0
        first, last = rows_within(yi, yi, reach, grid)
        for row in range(first, last):
            low, high = range_in_row(xi, yi, row, reach, grid, cell_start)
            b = _transport_pairs(
                xi,
                yi,
                density,
                u,
                v,
                source[X, low:high],
                source[Y, low:high],
                source[DENSITY, low:high],
                source[U, low:high],
                source[V, low:high],
                source[VOLUME, low:high],
                depth[low:high],
                nearness,
                inverse_length,
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
    xi: float, yi: float, density: float, u: float, v: float, a: float, b: float, c: float,
    x: Array, y: Array, densities: Array, us: Array, vs: Array, volume: Array, first: Array,
    second: Array, third: Array, inverse_length: float, amplitude: float, inverse_kernel: float,
    as_printed: float,
) -> tuple[
    float, float, float, float, float, float, float, float, float, float, float, float, float,
    float, float, float, float,
]:  # fmt: skip
    """Sum the pair terms of `regularity_and_gradients` over one range of sources."""
    lxx = lxy = lyy = gx = gy = sx = sy = dx = dy = 0.0
    moment = divergence = ax = ay = bx = by = cx = cy = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        square = ox * ox + oy * oy
        distance = math.sqrt(square)
        weight = gradient_factor(distance, inverse_length) * volume[k]
        wx = weight * ox
        wy = weight * oy
        lxx += ox * wx
        lxy += ox * wy
        lyy += oy * wy
        gx += (densities[k] - density) * wx
        gy += (densities[k] - density) * wy
        sx += wx
        sy += wy
        moment += square * laplacian_weight(square, inverse_length) * weight
        divergence += (us[k] - u) * wx + (vs[k] - v) * wy
        closeness = kernel(distance, inverse_length) * inverse_kernel
        push = shifting_push(closeness, amplitude, as_printed)
        dx += push * wx
        dy += push * wy
        ax += first[k] * wx
        ay += first[k] * wy
        bx += second[k] * wx
        by += second[k] * wy
        cx += third[k] * wx
        cy += third[k] * wy
    # Splitting the sum of a difference saves a subtraction per pair.
    return (
        lxx, lxy, lyy, gx, gy, sx, sy, dx, dy, moment, divergence, ax - a * sx, ay - a * sy,
        bx - b * sx, by - b * sy, cx - c * sx, cy - c * sy,
    )  # fmt: skip


@parallel
def regularity_and_gradients(
    particle: Indices,
    targets: Indices,
    block_start: Indices,
    source: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    scratch: Array,
    constants: RegularityConstants,
    walls: Array,
    out: Array,
    slopes: Array,
) -> None:
    """Compute the results of `sweeps.regularity` and, in the same pass, gradients of three fields.

    Parameters
    ----------
    source : the three fields are in the rows after the volume.
    slopes : (n_particles, 3, 2) renormalised gradients (Eq. 2.11) of the fields.

    For the others see `sweeps.regularity`.
    """
    n_blocks = block_start.size - 1
    for chunk in prange(N_CHUNKS):
        near = scratch[chunk, : FIRST + 3]
        for block in range(chunk * n_blocks // N_CHUNKS, (chunk + 1) * n_blocks // N_CHUNKS):
            here = targets[block_start[block] : block_start[block + 1]]
            n = list_candidates(source, here, grid, cell_start, reach, near)
            for t in range(here.size):
                j = here[t]
                (
                    lxx,
                    lxy,
                    lyy,
                    gx,
                    gy,
                    sx,
                    sy,
                    dx,
                    dy,
                    moment,
                    divergence,
                    ax,
                    ay,
                    bx,
                    by,
                    cx,
                    cy,
                ) = _gradient_pairs(
                    source[X, j] - source[X, here[0]],
                    source[Y, j] - source[Y, here[0]],
                    source[DENSITY, j],
                    source[U, j],
                    source[V, j],
                    source[FIRST, j],
                    source[FIRST + 1, j],
                    source[FIRST + 2, j],
                    near[X, :n],
                    near[Y, :n],
                    near[DENSITY, :n],
                    near[U, :n],
                    near[V, :n],
                    near[VOLUME, :n],
                    near[FIRST, :n],
                    near[FIRST + 1, :n],
                    near[FIRST + 2, :n],
                    inverse_length,
                    constants.amplitude,
                    constants.inverse_kernel,
                    constants.as_printed,
                )
                i = particle[j]
                finish_regularity(
                    lxx,
                    lxy,
                    lyy,
                    gx,
                    gy,
                    sx,
                    sy,
                    dx,
                    dy,
                    moment,
                    divergence,
                    source[DENSITY, j],
                    walls,
                    i,
                    constants,
                    out[:, i],
                )
                determinant = lxx * lyy - lxy * lxy
                slopes[i, 0, 0] = -(lyy * ax - lxy * ay) / determinant
                slopes[i, 0, 1] = -(lxx * ay - lxy * ax) / determinant
                slopes[i, 1, 0] = -(lyy * bx - lxy * by) / determinant
                slopes[i, 1, 1] = -(lxx * by - lxy * bx) / determinant
                slopes[i, 2, 0] = -(lyy * cx - lxy * cy) / determinant
                slopes[i, 2, 1] = -(lxx * cy - lxy * cx) / determinant
