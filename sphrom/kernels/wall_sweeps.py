"""The sweeps between fluid particles and the ghosts that stand for walls (Eq. 2.15-2.16).

Ghosts never move: they are sorted once, apart from the fluid, and only scenes with walls run these
sweeps. Every sweep sums over one kind of source at targets of the other kind. `source` is laid out
as in `sphrom.kernels.sweeps`, except that ghosts have rows of their own at its end.

Walls enter continuity in one of two ways. A ghost may add the difference of its velocity from the
fluid's, along its wall's normals. Or walls return the flux into them: continuity is then minus the
transpose of the ghosts' pressure force, so that sound neither gains nor loses energy at a wall,
whatever the wall's velocity. With phi_g = sum_i u_i . grad_i W_ig V_i, the flux towards ghost g,
and Shepard's weights w_gj of Eq. 2.15, the ghosts' part of particle j's divergence is
- u_j . sum_g grad_j W_jg V_g - sum_g w_gj V_g phi_g / V_j.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sphrom.kernels.cells import Grid, range_in_row, rows_within
from sphrom.kernels.jit import sweep, term
from sphrom.kernels.sweeps import (
    DENSITY,
    GRADIENT_X,
    SHIFT_U,
    SHIFT_V,
    TINY,
    VOLUME,
    FluidConstants,
    ShiftingConstants,
    U,
    V,
    X,
    Y,
    shifting_push,
)
from sphrom.kernels.wendland import gradient_factor, kernel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

# Rows of a ghost: 1 along the normals of its wall that count, else 0; w_gj V_g phi_g over W_gj.
NORMAL_X, NORMAL_Y, RETURN = SHIFT_U, SHIFT_V, GRADIENT_X
N_GHOST_ROWS = RETURN + 1


@term
def _mean_pairs(
    xi: float, yi: float, x: Array, y: Array, density: Array, us: Array, vs: Array,
    volume: Array, inverse_length: float,
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


@sweep
def ghost_means(
    ghost: Array, source: Array, grid: Grid, cell_start: Indices, reach: float,
    inverse_length: float, out: Array,
) -> None:
    """Interpolate the fluid's density fluctuation and velocity to ghosts (Eq. 2.15).

    Parameters
    ----------
    ghost : (2, n_ghosts) positions [m].
    source : the fluid's sources.
    out : (5, n_ghosts) rows: density fluctuation [kg/m3] and velocity x, y [m/s], zero where no
        fluid is near; the sum of the kernel [1/m2]; the flux phi towards the ghost [1/s].
    """
    for i in prange(ghost.shape[1]):
        xi = ghost[0, i]
        yi = ghost[1, i]
        weights = density = u = v = flux = 0.0
        first, last = rows_within(yi, yi, reach, grid)
        for row in range(first, last):
            low, high = range_in_row(xi, yi, row, reach, grid, cell_start)
            b = _mean_pairs(
                xi, yi, source[X, low:high], source[Y, low:high], source[DENSITY, low:high],
                source[U, low:high], source[V, low:high], source[VOLUME, low:high],
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
    xi: float, yi: float, x: Array, y: Array, force_x: Array, force_y: Array,
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


@sweep
def ghost_heads(
    ghost: Array, source: Array, force: Array, weights: Array, grid: Grid, cell_start: Indices,
    reach: float, inverse_length: float, out: Array,
) -> None:
    """Compute what a body force adds to the pressure at ghosts (Eq. 2.15).

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
                xi, yi, source[X, low:high], source[Y, low:high], force[0, low:high],
                force[1, low:high], inverse_length,
            )
        out[i] = total / weights[i] if weights[i] > 0.0 else 0.0


@term
def _gap(x: float, y: float, solid: Array) -> tuple[float, float]:
    """Return the way from a point to a rectangle [m]."""
    return min(max(x, solid[0]), solid[2]) - x, min(max(y, solid[1]), solid[3]) - y


@sweep
def wall_distances(targets: Indices, target: Array, solids: Array, out: Array) -> None:
    """Compute how far particles are from solid.

    Parameters
    ----------
    targets, target : the fluid's sources, and which of them to look at.
    solids : (n_solids, 4) lower and upper corners of rectangles, x before y [m].
    out : (n_targets,) [m].
    """
    for t in prange(targets.size):
        j = targets[t]
        nearest = math.inf
        for k in range(solids.shape[0]):
            wx, wy = _gap(target[X, j], target[Y, j], solids[k])
            nearest = min(nearest, wx * wx + wy * wy)
        out[t] = math.sqrt(nearest)


@term
def _ramp(distance: float, zero: float, one: float) -> float:
    """Return 0 up to one distance, 1 from another on, and what lies between in between."""
    return min(max((distance - zero) / (one - zero), 0.0), 1.0)


@sweep
def hold_back(
    particle: Indices, targets: Indices, target: Array, solids: Array, closest: float,
    touching: float, felt: float, shifting: Array,
) -> None:
    """Change shifting velocities so that no particle passes through a wall.

    Shifting never pushes towards a wall that a particle touches (compare Sun et al., Comput.
    Methods Appl. Mech. Eng. 315, 2017, who let particles shift along boundaries only). And it takes
    back what the velocity itself has across the wall at particles that come closer: velocity
    vanishes there but for an error, and where shifting carries the particles is free.

    Parameters
    ----------
    targets, target : the fluid's sources, and which of them to look at.
    closest, touching, felt : distances from a wall [m] at which nothing moves closer, at which
        shifting stops pushing and begins to hold back, and beyond which it is left alone.
    shifting : (>= 2, n_particles) rows: shifting velocity x, y [m/s].
    """
    for t in prange(targets.size):
        j = targets[t]
        i = particle[j]
        for k in range(solids.shape[0]):
            wx, wy = _gap(target[X, j], target[Y, j], solids[k])
            distance = math.sqrt(wx * wx + wy * wy)
            if distance < felt and distance > 0.0:
                wx /= distance
                wy /= distance
                towards = shifting[0, i] * wx + shifting[1, i] * wy
                across = target[U, j] * wx + target[V, j] * wy
                allowed = max(towards, 0.0) * _ramp(distance, touching, felt)
                held = max(across, 0.0) * (1.0 - _ramp(distance, closest, touching))
                change = min(towards, allowed - held) - towards
                shifting[0, i] += change * wx
                shifting[1, i] += change * wy


@term
def _support_pairs(
    xi: float, yi: float, x: Array, y: Array, volume: Array, inverse_length: float,
    amplitude: float, inverse_kernel: float, as_printed: float,
) -> tuple[float, float, float, float]:
    """Sum the pair terms of `wall_support` over one range of ghosts."""
    sx = sy = dx = dy = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        distance = math.sqrt(ox * ox + oy * oy)
        weight = gradient_factor(distance, inverse_length) * volume[k]
        closeness = kernel(distance, inverse_length) * inverse_kernel
        push = shifting_push(closeness, amplitude, as_printed)
        sx += weight * ox
        sy += weight * oy
        dx += push * weight * ox
        dy += push * weight * oy
    return sx, sy, dx, dy


@sweep
def wall_support(
    particle: Indices, targets: Indices, target: Array, source: Array, grid: Grid,
    cell_start: Indices, reach: float, inverse_length: float, shifting: ShiftingConstants,
    out: Array,
) -> None:
    """Sum the kernel's gradient, and that of Eq. 2.14, over ghosts.

    Parameters
    ----------
    particle, targets, target : the fluid's sources, and which of them are particles.
    source : the ghosts' sources.
    out : (4, n_particles) rows: sum of the kernel's gradient x, y, and of Eq. 2.14 x, y [1/m].
    """
    for t in prange(targets.size):
        j = targets[t]
        xi = target[X, j]
        yi = target[Y, j]
        sx = sy = dx = dy = 0.0
        first, last = rows_within(yi, yi, reach, grid)
        for row in range(first, last):
            low, high = range_in_row(xi, yi, row, reach, grid, cell_start)
            b = _support_pairs(
                xi, yi, source[X, low:high], source[Y, low:high], source[VOLUME, low:high],
                inverse_length, shifting.amplitude, shifting.inverse_kernel, shifting.as_printed,
            )
            sx += b[0]
            sy += b[1]
            dx += b[2]
            dy += b[3]
        i = particle[j]
        out[0, i] = sx
        out[1, i] = sy
        out[2, i] = dx
        out[3, i] = dy


@term
def _wall_pairs(
    xi: float, yi: float, density: float, u: float, v: float, volume: float, shift_u: float,
    shift_v: float, x: Array, y: Array, densities: Array, us: Array, vs: Array, volumes: Array,
    normal_x: Array, normal_y: Array, returned: Array, inverse_length: float, tiny: float,
    walls_return: float, fluid: FluidConstants,
) -> tuple[float, float, float, float]:
    """Sum the pair terms of `wall_rates` over one range of ghosts."""
    stiffness = fluid.sound_speed * fluid.sound_speed
    friction = fluid.pair_viscosity * fluid.reference_density
    drag = fluid.laplacian_viscosity * fluid.reference_density
    approach = dd = du = dv = 0.0
    for k in range(x.size):
        ox = xi - x[k]
        oy = yi - y[k]
        square = ox * ox + oy * oy
        distance = math.sqrt(square)
        weight = gradient_factor(distance, inverse_length) * volumes[k]
        jump_u = us[k] - u
        jump_v = vs[k] - v
        jump_d = densities[k] - density
        along_x = jump_u * ox
        along_y = jump_v * oy
        approach += (along_x * normal_x[k] + along_y * normal_y[k]) * weight - walls_return * (
            (u * ox + v * oy) * weight + returned[k] * kernel(distance, inverse_length) / volume
        )
        shift = fluid.advective * (shift_u * ox + shift_v * oy)
        dd += jump_d * shift * weight
        force = (
            -stiffness * (densities[k] + density) - friction * (along_x + along_y) / (square + tiny)
        )
        carry = fluid.reference_density * shift - drag
        du += (force * ox + carry * jump_u) * weight
        dv += (force * oy + carry * jump_v) * weight
    return approach, dd, du, dv


@sweep
def wall_rates(
    particle: Indices, targets: Indices, target: Array, source: Array, grid: Grid,
    cell_start: Indices, reach: float, inverse_length: float, walls_return: float,
    fluid: FluidConstants, out: Array,
) -> None:
    """Add what ghosts contribute to the rates of density and velocity (Eq. 2.6-2.7).

    Density doesn't diffuse into ghosts, and ghosts don't shift.

    Parameters
    ----------
    walls_return : 1 where walls return the flux into them, 0 where ghosts' velocities count.
    out : (3, n_particles) rows: density's rate [kg/m3/s], acceleration x, y [m/s2].
    """
    tiny = TINY / (inverse_length * inverse_length)
    for t in prange(targets.size):
        j = targets[t]
        xi = target[X, j]
        yi = target[Y, j]
        density = target[DENSITY, j]
        approach = dd = du = dv = 0.0
        first, last = rows_within(yi, yi, reach, grid)
        for row in range(first, last):
            low, high = range_in_row(xi, yi, row, reach, grid, cell_start)
            b = _wall_pairs(
                xi, yi, density, target[U, j], target[V, j], target[VOLUME, j],
                target[SHIFT_U, j], target[SHIFT_V, j], source[X, low:high], source[Y, low:high],
                source[DENSITY, low:high], source[U, low:high], source[V, low:high],
                source[VOLUME, low:high], source[NORMAL_X, low:high], source[NORMAL_Y, low:high],
                source[RETURN, low:high], inverse_length, tiny, walls_return, fluid,
            )
            approach += b[0]
            dd += b[1]
            du += b[2]
            dv += b[3]
        i = particle[j]
        full_density = fluid.reference_density + density
        out[0, i] += dd - full_density * approach
        out[1, i] += du / full_density
        out[2, i] += dv / full_density
