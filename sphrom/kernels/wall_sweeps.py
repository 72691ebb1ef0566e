"""The interaction of fluid particles with the ghosts of walls (Eq. 2.15-2.16).

Ghosts never move: they are sorted once, separately from the fluid, and only scenes with walls run
these sweeps. Every sweep sums over one kind of source at targets of the other kind. `source` is
laid out as in `sphrom.kernels.sweeps`, except that ghosts have additional rows at its end.

Walls enter the continuity equation in one of two ways. A ghost may contribute the difference of its
velocity from the fluid's, along its wall's normals. Or walls return the flux into them: the
continuity term is then minus the transpose of the ghosts' pressure force, so that sound neither
gains nor loses energy at a wall, for any velocity of the wall. With
phi_g = sum_i u_i . grad_i W_ig V_i, the flux towards ghost g, and the Shepard weights w_gj of
Eq. 2.15, the ghosts' part of particle j's divergence is
- u_j . sum_g grad_j W_jg V_g - sum_g w_gj V_g phi_g / V_j.

A ghost's velocity is its own. With a depth d_g it is extrapolated from each particle through the
wall (Morris, Fox and Zhu 1997): u_g - u_j = (1 + d_g / d_j) (U_g - u_j), with d_j the particle's
distance from the wall and U_g the wall's velocity. Shear along a flat wall is then exact.
"""

from __future__ import annotations

import math

from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.cells import Grid, range_in_row, rows_within
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.sweeps import (
    DENSITY,
    OWN_PRESSURE,
    OWN_VISCOUS,
    PRESSURE,
    TINY,
    VISCOUS,
    VOLUME,
    FluidConstants,
    RegularityConstants,
    U,
    V,
    X,
    Y,
    shifting_push,
)
from sphrom.kernels.wendland import gradient_factor, kernel, laplacian_weight

# Rows of a ghost: its depth behind the wall if velocities are extrapolated, else 0; 1 along the
# normals of its wall that are used, else 0; w_gj V_g phi_g over W_gj.
DEPTH, NORMAL_X, NORMAL_Y, RETURN = range(PRESSURE + 1, PRESSURE + 5)
N_GHOST_ROWS = RETURN + 1


@term
def _regularity_pairs(
    xi: float,
    yi: float,
    u: float,
    v: float,
    own_volume: float,
    distance: float,
    x: Array,
    y: Array,
    us: Array,
    vs: Array,
    volume: Array,
    depth: Array,
    normal_x: Array,
    normal_y: Array,
    returned: Array,
    inverse_length: float,
    walls_return: float,
    amplitude: float,
    inverse_kernel: float,
    as_printed: float,
) -> tuple[float, float, float, float, float, float]:
    """Sum the pair terms of `wall_regularity` over one range of ghosts."""
    sx = sy = dx = dy = moment = divergence = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        square = ox * ox + oy * oy
        length = math.sqrt(square)
        weight = gradient_factor(length, inverse_length) * volume[k]
        near = kernel(length, inverse_length)
        push = shifting_push(near * inverse_kernel, amplitude, as_printed)
        sx += weight * ox
        sy += weight * oy
        dx += push * weight * ox
        dy += push * weight * oy
        moment += square * laplacian_weight(square, inverse_length) * weight
        stretch = 1.0 + depth[k] / distance
        along_x = stretch * (us[k] - u) * ox
        along_y = stretch * (vs[k] - v) * oy
        divergence += (along_x * normal_x[k] + along_y * normal_y[k]) * weight - walls_return * (
            (u * ox + v * oy) * weight + returned[k] * near / own_volume
        )
    return sx, sy, dx, dy, moment, divergence


@parallel
def wall_regularity(
    particle: Indices,
    targets: Indices,
    target: Array,
    distance: Array,
    source: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    walls_return: float,
    constants: RegularityConstants,
    out: Array,
) -> None:
    """Compute the sums over ghosts that `sweeps.regularity` needs.

    Parameters
    ----------
    particle : (n_sources,) the particle of each source of the fluid.
    targets, target : the sources that are particles near walls, and all sources of the fluid.
    distance : (n_targets,) from the wall [m], not zero.
    source : the ghosts' sources.
    walls_return : 1 if walls return the flux into them, 0 if ghosts' velocities are used.
    out : (6, n_particles) rows: sum of the kernel's gradient x, y, and of Eq. 2.14 x, y [1/m];
        the gradient's second moment; the divergence of the velocity [1/s].
    """
    for t in prange(targets.size):
        j = targets[t]
        xi = target[X, j]
        yi = target[Y, j]
        sx = sy = dx = dy = moment = divergence = 0.0
        first, last = rows_within(yi, yi, reach, grid)
        for row in range(first, last):
            low, high = range_in_row(xi, yi, row, reach, grid, cell_start)
            b = _regularity_pairs(
                xi,
                yi,
                target[U, j],
                target[V, j],
                target[VOLUME, j],
                distance[t],
                source[X, low:high],
                source[Y, low:high],
                source[U, low:high],
                source[V, low:high],
                source[VOLUME, low:high],
                source[DEPTH, low:high],
                source[NORMAL_X, low:high],
                source[NORMAL_Y, low:high],
                source[RETURN, low:high],
                inverse_length,
                walls_return,
                constants.amplitude,
                constants.inverse_kernel,
                constants.as_printed,
            )
            sx += b[0]
            sy += b[1]
            dx += b[2]
            dy += b[3]
            moment += b[4]
            divergence += b[5]
        i = particle[j]
        out[0, i] = sx
        out[1, i] = sy
        out[2, i] = dx
        out[3, i] = dy
        out[4, i] = moment
        out[5, i] = divergence


@term
def _wall_pairs(
    xi: float,
    yi: float,
    u: float,
    v: float,
    pressure: float,
    viscous: float,
    distance: float,
    x: Array,
    y: Array,
    us: Array,
    vs: Array,
    volumes: Array,
    pressures: Array,
    depth: Array,
    inverse_length: float,
    tiny: float,
    fluid: FluidConstants,
) -> tuple[float, float]:
    """Sum the pair terms of `wall_rates` over one range of ghosts."""
    stiffness = fluid.sound_speed * fluid.sound_speed
    friction = fluid.pair_viscosity * fluid.reference_density
    drag = 2.0 * fluid.laplacian_viscosity * fluid.reference_density * viscous
    du = dv = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        square = ox * ox + oy * oy
        weight = gradient_factor(math.sqrt(square), inverse_length) * volumes[k]
        stretch = 1.0 + depth[k] / distance
        jump_u = stretch * (us[k] - u)
        jump_v = stretch * (vs[k] - v)
        approach = jump_u * ox + jump_v * oy
        force = -stiffness * (pressures[k] + pressure) - friction * approach / (square + tiny)
        pull = drag * laplacian_weight(square, inverse_length)
        du += (force * ox - pull * jump_u) * weight
        dv += (force * oy - pull * jump_v) * weight
    return du, dv


@parallel
def wall_rates(
    particle: Indices,
    targets: Indices,
    target: Array,
    distance: Array,
    source: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    regular: Array,
    fluid: FluidConstants,
    out: Array,
) -> None:
    """Add the contribution of ghosts to the acceleration (Eq. 2.7).

    Their contribution to the continuity equation is already in the divergence; density does not
    diffuse into ghosts. Ghosts do not shift, and shifting transports nothing out of them: if it
    transported the extrapolated velocity away from walls, this velocity would grow, and flows at
    low viscosity would become unstable. The Laplacian's factor is the particle's own.

    Parameters
    ----------
    distance : (n_targets,) from the wall [m], not zero.
    regular : (9, n_particles) the result of `sweeps.regularity`.
    out : (2, n_particles) acceleration x, y [m/s2].
    """
    tiny = TINY / (inverse_length * inverse_length)
    for t in prange(targets.size):
        j = targets[t]
        i = particle[j]
        xi = target[X, j]
        yi = target[Y, j]
        du = dv = 0.0
        first, last = rows_within(yi, yi, reach, grid)
        for row in range(first, last):
            low, high = range_in_row(xi, yi, row, reach, grid, cell_start)
            b = _wall_pairs(
                xi,
                yi,
                target[U, j],
                target[V, j],
                regular[OWN_PRESSURE, i],
                regular[OWN_VISCOUS, i],
                distance[t],
                source[X, low:high],
                source[Y, low:high],
                source[U, low:high],
                source[V, low:high],
                source[VOLUME, low:high],
                source[PRESSURE, low:high],
                source[DEPTH, low:high],
                inverse_length,
                tiny,
                fluid,
            )
            du += b[0]
            dv += b[1]
        full_density = fluid.reference_density + target[DENSITY, j]
        out[0, i] += du / full_density
        out[1, i] += dv / full_density


@term
def _force_pairs(
    xg: float,
    yg: float,
    ug: float,
    vg: float,
    pressure: float,
    depth: float,
    x: Array,
    y: Array,
    us: Array,
    vs: Array,
    volumes: Array,
    pressures: Array,
    viscosities: Array,
    distances: Array,
    inverse_length: float,
    tiny: float,
    fluid: FluidConstants,
) -> tuple[float, float, float, float]:
    """Sum the pair terms of `ghost_forces` over one range of fluid sources."""
    stiffness = fluid.sound_speed * fluid.sound_speed
    friction = fluid.pair_viscosity * fluid.reference_density
    drag = 2.0 * fluid.laplacian_viscosity * fluid.reference_density
    px = py = sx = sy = 0.0
    for k in range(x.size):
        ox = x[k] - xg
        oy = y[k] - yg
        square = ox * ox + oy * oy
        weight = gradient_factor(math.sqrt(square), inverse_length) * volumes[k]
        stretch = 1.0 + depth / distances[k]
        jump_u = stretch * (ug - us[k])
        jump_v = stretch * (vg - vs[k])
        push = stiffness * (pressure + pressures[k]) * weight
        along = friction * (jump_u * ox + jump_v * oy) / (square + tiny) * weight
        pull = drag * viscosities[k] * laplacian_weight(square, inverse_length) * weight
        px += push * ox
        py += push * oy
        sx += along * ox + pull * jump_u
        sy += along * oy + pull * jump_v
    return px, py, sx, sy


@parallel
def ghost_forces(
    ghost: Array,
    source: Array,
    distance: Array,
    grid: Grid,
    cell_start: Indices,
    reach: float,
    inverse_length: float,
    fluid: FluidConstants,
    out: Array,
) -> None:
    """Compute the force of the fluid on each ghost: minus that of the ghost in `wall_rates`.

    Parameters
    ----------
    ghost : (12, n_ghosts) the ghosts' rows.
    source : the fluid's sources, with their pressure and c of the Laplacian.
    distance : (n_sources,) of the fluid from the wall [m], not zero.
    out : (4, n_ghosts) rows: pressure force x, y and viscous force x, y, per depth [N/m].
    """
    tiny = TINY / (inverse_length * inverse_length)
    for i in prange(ghost.shape[1]):
        x = ghost[X, i]
        y = ghost[Y, i]
        px = py = sx = sy = 0.0
        first, last = rows_within(y, y, reach, grid)
        for row in range(first, last):
            low, high = range_in_row(x, y, row, reach, grid, cell_start)
            b = _force_pairs(
                x,
                y,
                ghost[U, i],
                ghost[V, i],
                ghost[PRESSURE, i],
                ghost[DEPTH, i],
                source[X, low:high],
                source[Y, low:high],
                source[U, low:high],
                source[V, low:high],
                source[VOLUME, low:high],
                source[PRESSURE, low:high],
                source[VISCOUS, low:high],
                distance[low:high],
                inverse_length,
                tiny,
                fluid,
            )
            px += b[0]
            py += b[1]
            sx += b[2]
            sy += b[3]
        volume = ghost[VOLUME, i]
        out[0, i] = px * volume
        out[1, i] = py * volume
        out[2, i] = sx * volume
        out[3, i] = sy * volume
