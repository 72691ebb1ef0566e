"""The two sweeps over pairs that make up the delta-plus-SPH functional (Eq. 2.6-2.14).

Sources are sorted by cell (`cells.py`); `source[f]` is field f of all sources. A particle's
candidates are the contiguous list of its block (`blocks.py`), so that the loop over them
vectorises. Every pair term contains the factor of the kernel's gradient, which vanishes beyond the
support, and the pair of a particle with itself has no offset. No branch is therefore needed, and
only the 1/r^2 of viscosity needs a guard.

With G = F V_j and a_i = delta u_i . offset, the advective shifting terms of Eq. 2.6 are
sum (rho_j - rho_i) a_i G, and those of Eq. 2.7 rho_0 / rho_i sum (u_j - u_i) a_i G: they vanish for
a uniform field. As printed they have a_j in place of a_i, and the additional terms
2 rho_i delta u_i . s_i and 2 rho_0 / rho_i u_i delta u_i . s_i, with s_i the sum of the kernel's
gradient times V_j.

The Laplacian of the velocity is -sum (c_i + c_j) (u_j - u_i) w G with the weight w of
`wendland.py`, normalised by its second moment 1/c_i = -1/2 sum r^2 w G. The mean of both factors
keeps the forces of a pair opposite.

The acoustic damper is a pressure -alpha rho_0 c0 h div u (Sun et al., Comput. Methods Appl. Mech.
Eng. 2023), in the same sums as the pressure: a bulk viscosity, which only removes energy.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.blocks import N_CHUNKS, list_candidates
from sphrom.kernels.cells import Grid
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.wendland import gradient_factor, kernel, laplacian_weight

# Rows of `source`.
X, Y, DENSITY, U, V, VOLUME, PRESSURE, VISCOUS, GRADIENT_X, GRADIENT_Y, SHIFT_U, SHIFT_V = range(12)
N_FIELDS = 10
"""Number of rows that the sums need."""
N_PRINTED_FIELDS = 12
"""Number of rows that the sums as printed need."""

# Rows of the result of `regularity`; the first ones are in the order of `source`.
(
    OWN_PRESSURE, OWN_VISCOUS, OWN_GRADIENT_X, OWN_GRADIENT_Y, OWN_SHIFT_U, OWN_SHIFT_V, DIVERGENCE,
    SUPPORT_X, SUPPORT_Y,
) = range(9)  # fmt: skip
N_REGULAR_ROWS = 9

# Guards 0/0 of a particle with itself, relative to h^2; far below rounding for any other pair.
TINY = 1e-30


class RegularityConstants(NamedTuple):
    """Constants of Eq. 2.13-2.14, and of the acoustic damper."""

    magnitude: float
    """2 h c0 Ma [m2/s]."""
    amplitude: float
    inverse_kernel: float
    """1 / W(dx) [m2]."""
    as_printed: float
    """1 for [1 + chi w]^xi as printed, 0 for 1 + chi w^xi (Sun et al. 2017)."""
    limit: float
    """U_max / 2 [m/s]."""
    damping: float
    """alpha h rho_0 / c0 [kg s/m3]: the damper's pressure over c0^2, per minus the divergence."""


class FluidConstants(NamedTuple):
    """The constants of the fluid in Eq. 2.6-2.8."""

    reference_density: float
    sound_speed: float
    pair_viscosity: float
    """K of Eq. 2.12, 2 (n + 2) nu [m2/s]: friction along the line between two particles."""
    laplacian_viscosity: float
    """nu [m2/s] of the velocity's Laplacian (Morris, Fox and Zhu 1997)."""
    diffusion: float
    """2 delta h c0 [m2/s]."""
    advective: float
    """1 if shifting carries differences by a particle's own velocity, 0 for terms as printed."""


def n_fields(fluid: FluidConstants) -> int:
    """Return the number of rows of `source` for the rates; sums as printed need more."""
    printed = fluid.advective == 0.0 or fluid.pair_viscosity > 0.0
    return N_PRINTED_FIELDS if printed else N_FIELDS


@parallel
def gather(particle: Indices, image: Array, fields: Array, first: int, source: Array) -> None:
    """Copy particle fields (n_fields, n_particles) to sources and images, from row `first` on."""
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
    xi: float,
    yi: float,
    density: float,
    u: float,
    v: float,
    x: Array,
    y: Array,
    densities: Array,
    us: Array,
    vs: Array,
    volume: Array,
    inverse_length: float,
    amplitude: float,
    inverse_kernel: float,
    as_printed: float,
) -> tuple[float, float, float, float, float, float, float, float, float, float, float]:
    """Sum the pair terms of `regularity` over one range of sources."""
    lxx = lxy = lyy = gx = gy = sx = sy = dx = dy = moment = divergence = 0.0
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
    return lxx, lxy, lyy, gx, gy, sx, sy, dx, dy, moment, divergence


@term
def finish_regularity(
    lxx: float,
    lxy: float,
    lyy: float,
    gx: float,
    gy: float,
    sx: float,
    sy: float,
    dx: float,
    dy: float,
    moment: float,
    divergence: float,
    density: float,
    walls: Array,
    i: int,
    constants: RegularityConstants,
    out: Array,
) -> None:
    """Fill particle i's column of `regularity` from its sums and those over walls."""
    if walls.shape[1] > 0:
        sx += walls[0, i]
        sy += walls[1, i]
        dx += walls[2, i]
        dy += walls[3, i]
        moment += walls[4, i]
        divergence += walls[5, i]
    out[OWN_PRESSURE] = density - constants.damping * divergence
    out[OWN_VISCOUS] = -2.0 / moment
    # L_i is the inverse of minus the sum of offset times gradient (Eq. 2.11).
    determinant = lxx * lyy - lxy * lxy
    out[OWN_GRADIENT_X] = -(lyy * gx - lxy * gy) / determinant
    out[OWN_GRADIENT_Y] = -(lxx * gy - lxy * gx) / determinant
    speed = constants.magnitude * math.sqrt(dx * dx + dy * dy)
    scale = -constants.magnitude
    if speed > constants.limit:
        scale *= constants.limit / speed
    out[OWN_SHIFT_U] = scale * dx
    out[OWN_SHIFT_V] = scale * dy
    out[DIVERGENCE] = divergence
    out[SUPPORT_X] = sx
    out[SUPPORT_Y] = sy


@parallel
def regularity(
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
) -> None:
    """Compute the shifting, and the values of particles and neighbours that the rates need.

    The density's gradient is that of the fluid only; the other sums include walls.

    Parameters
    ----------
    particle : (n_sources,) the particle of each source; several sources may be its images.
    targets : (n_particles,) the sources that are particles, in sorted order.
    block_start : (n_blocks + 1,) the first target of each block.
    scratch : (N_CHUNKS, >= 6, longest list) scratch memory.
    walls : (6, n_particles) the result of `wall_regularity`, or (6, 0) without walls.
    out : (9, n_particles) rows: density fluctuation with the damper's pressure over c0^2 [kg/m3];
        c of the Laplacian; renormalised density gradient x, y [kg/m4] (Eq. 2.11); shifting velocity
        x, y [m/s] (Eq. 2.13-2.14); divergence of the velocity [1/s]; sum of the kernel's gradient
        x, y [1/m].
    """
    n_blocks = block_start.size - 1
    for chunk in prange(N_CHUNKS):
        near = scratch[chunk, : VOLUME + 1]
        for block in range(chunk * n_blocks // N_CHUNKS, (chunk + 1) * n_blocks // N_CHUNKS):
            here = targets[block_start[block] : block_start[block + 1]]
            n = list_candidates(source, here, grid, cell_start, reach, near)
            for t in range(here.size):
                j = here[t]
                lxx, lxy, lyy, gx, gy, sx, sy, dx, dy, moment, divergence = _regularity_pairs(
                    source[X, j] - source[X, here[0]],
                    source[Y, j] - source[Y, here[0]],
                    source[DENSITY, j],
                    source[U, j],
                    source[V, j],
                    near[X, :n],
                    near[Y, :n],
                    near[DENSITY, :n],
                    near[U, :n],
                    near[V, :n],
                    near[VOLUME, :n],
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


@term
def _rate_pairs(
    xi: float,
    yi: float,
    density: float,
    u: float,
    v: float,
    pressure: float,
    viscous: float,
    gradient_x: float,
    gradient_y: float,
    shift_u: float,
    shift_v: float,
    x: Array,
    y: Array,
    densities: Array,
    us: Array,
    vs: Array,
    volume: Array,
    pressures: Array,
    viscosities: Array,
    gradients_x: Array,
    gradients_y: Array,
    inverse_length: float,
    fluid: FluidConstants,
) -> tuple[float, float, float]:
    """Sum the pair terms of `rates` over one range of sources."""
    stiffness = fluid.sound_speed * fluid.sound_speed
    drag = fluid.laplacian_viscosity * fluid.reference_density
    dd = du = dv = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        square = ox * ox + oy * oy
        weight = gradient_factor(math.sqrt(square), inverse_length) * volume[k]
        jump = densities[k] - density
        shift = shift_u * ox + shift_v * oy
        slope = (gradients_x[k] + gradient_x) * ox + (gradients_y[k] + gradient_y) * oy
        dd += (jump * shift - fluid.diffusion * (jump + 0.5 * slope)) * weight
        push = stiffness * (pressures[k] + pressure)
        friction = drag * laplacian_weight(square, inverse_length) * (viscosities[k] + viscous)
        carry = fluid.reference_density * shift - friction
        du += (carry * (us[k] - u) - push * ox) * weight
        dv += (carry * (vs[k] - v) - push * oy) * weight
    return dd, du, dv


@term
def _printed_pairs(
    xi: float,
    yi: float,
    density: float,
    u: float,
    v: float,
    pressure: float,
    viscous: float,
    gradient_x: float,
    gradient_y: float,
    own_u: float,
    own_v: float,
    x: Array,
    y: Array,
    densities: Array,
    us: Array,
    vs: Array,
    volume: Array,
    pressures: Array,
    viscosities: Array,
    gradients_x: Array,
    gradients_y: Array,
    shift_u: Array,
    shift_v: Array,
    inverse_length: float,
    tiny: float,
    fluid: FluidConstants,
) -> tuple[float, float, float]:
    """Sum the pair terms of `rates` over one range, with those as printed that constants select."""
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
        jump = densities[k] - density
        approach = jump_u * ox + jump_v * oy
        shift = others * (shift_u[k] * ox + shift_v[k] * oy) + own_u * ox + own_v * oy
        slope = (gradients_x[k] + gradient_x) * ox + (gradients_y[k] + gradient_y) * oy
        dd += (jump * shift - fluid.diffusion * (jump + 0.5 * slope)) * weight
        force = -stiffness * (pressures[k] + pressure) - friction * approach / (square + tiny)
        pull = drag * laplacian_weight(square, inverse_length) * (viscosities[k] + viscous)
        carry = fluid.reference_density * shift - pull
        du += (force * ox + carry * jump_u) * weight
        dv += (force * oy + carry * jump_v) * weight
    return dd, du, dv


@parallel
def rates(
    particle: Indices,
    targets: Indices,
    block_start: Indices,
    source: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    scratch: Array,
    regular: Array,
    fluid: FluidConstants,
    out: Array,
) -> None:
    """Compute the rates of density and velocity (Eq. 2.6-2.7 without the body force).

    Parameters
    ----------
    source : (10, n_sources), or for sums as printed (12, n_sources).
    scratch : (N_CHUNKS, same number of rows, longest list) scratch memory.
    regular : (9, n_particles) the result of `regularity`.
    out : (3, n_particles) rows: rate of density [kg/m3/s], acceleration x, y [m/s2].
    """
    tiny = TINY / (inverse_length * inverse_length)
    printed = source.shape[0] == N_PRINTED_FIELDS
    n_blocks = block_start.size - 1
    for chunk in prange(N_CHUNKS):
        near = scratch[chunk, : source.shape[0]]
        for block in range(chunk * n_blocks // N_CHUNKS, (chunk + 1) * n_blocks // N_CHUNKS):
            here = targets[block_start[block] : block_start[block + 1]]
            n = list_candidates(source, here, grid, cell_start, reach, near)
            for t in range(here.size):
                j = here[t]
                i = particle[j]
                x = source[X, j] - source[X, here[0]]
                y = source[Y, j] - source[Y, here[0]]
                u = source[U, j]
                v = source[V, j]
                shift_u = regular[OWN_SHIFT_U, i]
                shift_v = regular[OWN_SHIFT_V, i]
                spread = 0.0
                if printed:
                    dd, du, dv = _printed_pairs(
                        x,
                        y,
                        source[DENSITY, j],
                        u,
                        v,
                        regular[OWN_PRESSURE, i],
                        regular[OWN_VISCOUS, i],
                        regular[OWN_GRADIENT_X, i],
                        regular[OWN_GRADIENT_Y, i],
                        shift_u,
                        shift_v,
                        near[X, :n],
                        near[Y, :n],
                        near[DENSITY, :n],
                        near[U, :n],
                        near[V, :n],
                        near[VOLUME, :n],
                        near[PRESSURE, :n],
                        near[VISCOUS, :n],
                        near[GRADIENT_X, :n],
                        near[GRADIENT_Y, :n],
                        near[SHIFT_U, :n],
                        near[SHIFT_V, :n],
                        inverse_length,
                        tiny,
                        fluid,
                    )
                    spread = (
                        (1.0 - fluid.advective)
                        * 2.0
                        * (shift_u * regular[SUPPORT_X, i] + shift_v * regular[SUPPORT_Y, i])
                    )
                else:
                    dd, du, dv = _rate_pairs(
                        x,
                        y,
                        source[DENSITY, j],
                        u,
                        v,
                        regular[OWN_PRESSURE, i],
                        regular[OWN_VISCOUS, i],
                        regular[OWN_GRADIENT_X, i],
                        regular[OWN_GRADIENT_Y, i],
                        shift_u,
                        shift_v,
                        near[X, :n],
                        near[Y, :n],
                        near[DENSITY, :n],
                        near[U, :n],
                        near[V, :n],
                        near[VOLUME, :n],
                        near[PRESSURE, :n],
                        near[VISCOUS, :n],
                        near[GRADIENT_X, :n],
                        near[GRADIENT_Y, :n],
                        inverse_length,
                        fluid,
                    )
                full_density = fluid.reference_density + source[DENSITY, j]
                divergence = regular[DIVERGENCE, i]
                out[0, i] = dd + full_density * (spread - divergence)
                out[1, i] = (du + fluid.reference_density * u * spread) / full_density
                out[2, i] = (dv + fluid.reference_density * v * spread) / full_density
