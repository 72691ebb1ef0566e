"""The two sweeps over pairs that make up the delta-plus-SPH functional (Eq. 2.6-2.14).

Sources are sorted by cell (`cells.py`); `source[f]` is field f of all sources. A particle's
candidates are the list of its block (`blocks.py`), contiguous, so that the loop over them
vectorises.
Every pair term carries the kernel gradient's factor, which vanishes beyond the support, and the
pair of a particle with itself has no offset: no branch is needed, and only viscosity's 1/r^2 a
guard.

Written with G = F V_j, a_j = delta u_j . offset and s_i = sum of the kernel's gradient times V_j,
the shifting terms of Eq. 2.6 are sum (rho_j - rho_i) a_j G + 2 rho_i delta u_i . s_i, and those of
Eq. 2.7 are rho_0 / rho_i (sum (u_j - u_i) a_j G + 2 u_i delta u_i . s_i). Advective instead, both
are sums over differences alone, with a_i in place of a_j: nothing is left for a uniform field.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sphrom.kernels.blocks import N_CHUNKS, list_candidates
from sphrom.kernels.cells import Grid
from sphrom.kernels.jit import sweep, term
from sphrom.kernels.wendland import gradient_factor, kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Rows of `source`.
X, Y, DENSITY, U, V, VOLUME, SHIFT_U, SHIFT_V, GRADIENT_X, GRADIENT_Y = range(10)
N_FIELDS = 10

# Guards 0/0 of a particle with itself, relative to h^2; far below rounding for any other pair.
TINY = 1e-30


class ShiftingConstants(NamedTuple):
    """Eq. 2.13-2.14."""

    magnitude: float
    """2 h c0 Ma [m2/s]."""
    amplitude: float
    inverse_kernel: float
    """1 / W(dx) [m2]."""
    as_printed: float
    """1 for [1 + chi w]^xi as printed, 0 for 1 + chi w^xi (Sun et al. 2017)."""
    limit: float
    """U_max / 2 [m/s]."""


class FluidConstants(NamedTuple):
    """What Eq. 2.6-2.8 need of the fluid."""

    reference_density: float
    sound_speed: float
    pair_viscosity: float
    """K of Eq. 2.12, 2 (n + 2) nu [m2/s]: friction along the line between two particles."""
    laplacian_viscosity: float
    """2 nu [m2/s] of the velocity's Laplacian (Morris, Fox and Zhu 1997)."""
    diffusion: float
    """2 delta h c0 [m2/s]."""
    advective: float
    """1 where shifting carries differences by its own velocity, 0 for the terms as printed."""


@sweep
def gather(particle: Indices, image: Array, fields: Array, first: int, source: Array) -> None:
    """Copy particle fields (n_fields, n_particles) to sources, from row `first`; images too."""
    for k in prange(particle.size):
        i = particle[k]
        for f in range(fields.shape[0]):
            source[first + f, k] = fields[f, i]
        if first == 0:
            source[X, k] += image[0, k]
            source[Y, k] += image[1, k]


@term
def shifting_push(closeness: float, amplitude: float, as_printed: float) -> float:
    """Return the bracket of Eq. 2.14 for W / W(dx), with xi = 4."""
    printed = (1.0 + amplitude * closeness) * (1.0 + amplitude * closeness)
    square = closeness * closeness
    return as_printed * printed * printed + (1.0 - as_printed) * (1.0 + amplitude * square * square)


@term
def _regularity_pairs(
    xi: float, yi: float, density: float, x: Array, y: Array, densities: Array, volume: Array,
    inverse_length: float, amplitude: float, inverse_kernel: float, as_printed: float,
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Sum the pair terms of `regularity` over one range of sources."""
    lxx = lxy = lyy = gx = gy = sx = sy = dx = dy = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        distance = math.sqrt(ox * ox + oy * oy)
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
        closeness = kernel(distance, inverse_length) * inverse_kernel
        push = shifting_push(closeness, amplitude, as_printed)
        dx += push * wx
        dy += push * wy
    return lxx, lxy, lyy, gx, gy, sx, sy, dx, dy


@term
def finish_regularity(
    lxx: float, lxy: float, lyy: float, gx: float, gy: float, sx: float, sy: float, dx: float,
    dy: float, shifting: ShiftingConstants, out: Array,
) -> None:
    """Fill a particle's column of `regularity` from its sums."""
    # L_i is the inverse of minus the sum of offset times gradient (Eq. 2.11).
    determinant = lxx * lyy - lxy * lxy
    out[2] = -(lyy * gx - lxy * gy) / determinant
    out[3] = -(lxx * gy - lxy * gx) / determinant
    out[4] = sx
    out[5] = sy
    speed = shifting.magnitude * math.sqrt(dx * dx + dy * dy)
    scale = -shifting.magnitude
    if speed > shifting.limit:
        scale *= shifting.limit / speed
    out[0] = scale * dx
    out[1] = scale * dy


@sweep
def regularity(
    particle: Indices,
    targets: Indices,
    block_start: Indices,
    source: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    shifting: ShiftingConstants,
    walls: Array,
    scratch: Array,
    out: Array,
) -> None:
    """Compute the shifting velocity, the density's gradient and the kernel gradient's sum.

    Gradients are those of the fluid alone; the other two count walls in.

    Parameters
    ----------
    particle : (n_sources,) the particle that each source is, or is an image of.
    targets : (n_particles,) the sources that are particles, in sorted order.
    block_start : (n_blocks + 1,) where blocks begin among the targets.
    walls : (4, n_particles) what `wall_support` returned, or (4, 0) without walls.
    scratch : (N_CHUNKS, >= 10, longest list) memory to work in.
    out : (6, n_particles) rows: shifting velocity x, y [m/s] (Eq. 2.13-2.14); renormalised density
        gradient x, y [kg/m4] (Eq. 2.11); sum of the kernel's gradient x, y [1/m].
    """
    n_blocks = block_start.size - 1
    for chunk in prange(N_CHUNKS):
        near = scratch[chunk, : VOLUME + 1]
        for block in range(chunk * n_blocks // N_CHUNKS, (chunk + 1) * n_blocks // N_CHUNKS):
            here = targets[block_start[block] : block_start[block + 1]]
            n = list_candidates(source, here, grid, cell_start, reach, near)
            for t in range(here.size):
                j = here[t]
                lxx, lxy, lyy, gx, gy, sx, sy, dx, dy = _regularity_pairs(
                    source[X, j] - source[X, here[0]], source[Y, j] - source[Y, here[0]],
                    source[DENSITY, j], near[X, :n], near[Y, :n], near[DENSITY, :n],
                    near[VOLUME, :n], inverse_length, shifting.amplitude,
                    shifting.inverse_kernel, shifting.as_printed,
                )
                i = particle[j]
                if walls.shape[1] > 0:
                    sx += walls[0, i]
                    sy += walls[1, i]
                    dx += walls[2, i]
                    dy += walls[3, i]
                finish_regularity(lxx, lxy, lyy, gx, gy, sx, sy, dx, dy, shifting, out[:, i])


@term
def _rate_pairs(
    xi: float, yi: float, density: float, u: float, v: float, gradient_x: float, gradient_y: float,
    own_u: float, own_v: float, full_density: float, x: Array, y: Array, densities: Array,
    us: Array, vs: Array, volume: Array, shift_u: Array, shift_v: Array, gradients_x: Array,
    gradients_y: Array, inverse_length: float, tiny: float, fluid: FluidConstants,
) -> tuple[float, float, float]:
    """Sum the pair terms of `rates` over one range of sources."""
    stiffness = fluid.sound_speed * fluid.sound_speed
    friction = fluid.pair_viscosity * fluid.reference_density
    drag = fluid.laplacian_viscosity * fluid.reference_density
    others = 1.0 - fluid.advective
    own_u *= fluid.advective
    own_v *= fluid.advective
    dd = du = dv = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        square = ox * ox + oy * oy
        weight = gradient_factor(math.sqrt(square), inverse_length) * volume[k]
        jump_u = us[k] - u
        jump_v = vs[k] - v
        jump_d = densities[k] - density
        approach = jump_u * ox + jump_v * oy
        shift = others * (shift_u[k] * ox + shift_v[k] * oy) + own_u * ox + own_v * oy
        slope = (gradients_x[k] + gradient_x) * ox + (gradients_y[k] + gradient_y) * oy
        dd += (
            jump_d * shift - full_density * approach - fluid.diffusion * (jump_d + 0.5 * slope)
        ) * weight
        force = -stiffness * (densities[k] + density) - friction * approach / (square + tiny)
        carry = fluid.reference_density * shift - drag
        du += (force * ox + carry * jump_u) * weight
        dv += (force * oy + carry * jump_v) * weight
    return dd, du, dv


@sweep
def rates(
    particle: Indices,
    targets: Indices,
    block_start: Indices,
    source: Array,
    regular: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    fluid: FluidConstants,
    scratch: Array,
    out: Array,
) -> None:
    """Compute the rates of density and velocity (Eq. 2.6-2.7 without the body force).

    Parameters
    ----------
    regular : (6, n_particles) what `regularity` returned.
    scratch : (N_CHUNKS, 10, longest list) memory to work in.
    out : (3, n_particles) rows: density's rate [kg/m3/s], acceleration x, y [m/s2].
    """
    tiny = TINY / (inverse_length * inverse_length)
    n_blocks = block_start.size - 1
    for chunk in prange(N_CHUNKS):
        near = scratch[chunk]
        for block in range(chunk * n_blocks // N_CHUNKS, (chunk + 1) * n_blocks // N_CHUNKS):
            here = targets[block_start[block] : block_start[block + 1]]
            n = list_candidates(source, here, grid, cell_start, reach, near)
            for t in range(here.size):
                j = here[t]
                i = particle[j]
                u = source[U, j]
                v = source[V, j]
                full_density = fluid.reference_density + source[DENSITY, j]
                dd, du, dv = _rate_pairs(
                    source[X, j] - source[X, here[0]], source[Y, j] - source[Y, here[0]],
                    source[DENSITY, j], u, v, source[GRADIENT_X, j], source[GRADIENT_Y, j],
                    source[SHIFT_U, j], source[SHIFT_V, j], full_density,
                    near[X, :n], near[Y, :n], near[DENSITY, :n], near[U, :n], near[V, :n],
                    near[VOLUME, :n], near[SHIFT_U, :n], near[SHIFT_V, :n],
                    near[GRADIENT_X, :n], near[GRADIENT_Y, :n], inverse_length, tiny, fluid,
                )
                spread = (1.0 - fluid.advective) * 2.0 * (
                    regular[0, i] * regular[4, i] + regular[1, i] * regular[5, i]
                )
                out[0, i] = dd + full_density * spread
                out[1, i] = (du + fluid.reference_density * u * spread) / full_density
                out[2, i] = (dv + fluid.reference_density * v * spread) / full_density
