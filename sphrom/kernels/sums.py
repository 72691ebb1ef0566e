"""Sums over the neighbours of one particle or ghost, in one range of contiguous sources.

Sums are local numbers, because the compiler makes no vectors of loops that add up tuples. The
functions for rows of cells take the sums of the rows before, and return those with one more row.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from sphrom.arrays import Array
from sphrom.kernels.cells import Search, range_in_row, rows_within
from sphrom.kernels.fields import (
    DEPTH,
    FIRST,
    NORMAL_X,
    PRESSURE,
    RETURN,
    VISCOUS,
    Derived,
    Flow,
    FluidConstants,
    RegularityConstants,
    X,
    derived_at,
    flow_at,
    vector_at,
)
from sphrom.kernels.jit import inlined, like, term
from sphrom.kernels.pairs import (
    TINY,
    density_exchange,
    extrapolated,
    friction,
    kernel_of,
    laplacian,
    pair_friction,
    push,
    shifting_push,
    slope_weight,
)
from sphrom.kernels.vectors import Vector, dot, element, minus, plus, times
from sphrom.kernels.wendland import gradient_factor, kernel

Sums = tuple[float, ...]


class Regularity(NamedTuple):
    """The sums of `sweeps.regularity` for one particle."""

    matrix: tuple[float, float, float]
    """xx, xy, yy of minus the inverse of L_i (Eq. 2.11)."""
    gradient: Vector
    """The gradient of the density, to be multiplied by L_i."""
    support: Vector
    """The sum of the kernel's gradient."""
    push: Vector
    """The sum of Eq. 2.14."""
    moment: float
    """The second moment of the Laplacian."""
    divergence: float
    slopes: tuple[Vector, ...]
    """The gradients of additional fields, like that of the density."""


@term
def regularity_sums(
    place: Vector,
    own: Flow,
    near: Array,
    n: int,
    extra: Sums,
    constants: RegularityConstants,
    inverse_length: float,
) -> Regularity:
    """Add up the first n candidates `near` of a particle; `extra` are its additional fields."""
    places, densities, velocities, volumes = flow_at(near, slice(0, n))
    if len(extra) == 3:
        first = near[FIRST, :n]
        second = near[FIRST + 1, :n]
        third = near[FIRST + 2, :n]
    zero = like(0.0, inverse_length)
    lxx = lxy = lyy = gx = gy = sx = sy = dx = dy = zero
    moment = divergence = ax = ay = bx = by = cx = cy = zero
    for k in range(n):
        offset = minus(place, element(places, k))
        weight = slope_weight(offset, volumes[k], inverse_length)
        wx, wy = times(weight, offset)
        lxx += offset[0] * wx
        lxy += offset[0] * wy
        lyy += offset[1] * wy
        gx += (densities[k] - own.density) * wx
        gy += (densities[k] - own.density) * wy
        sx += wx
        sy += wy
        moment += dot(offset, offset) * laplacian(offset, inverse_length) * weight
        divergence += dot(minus(element(velocities, k), own.velocity), (wx, wy))
        shove = shifting_push(offset, constants, inverse_length)
        dx += shove * wx
        dy += shove * wy
        if len(extra) == 3:
            ax += first[k] * wx
            ay += first[k] * wy
            bx += second[k] * wx
            by += second[k] * wy
            cx += third[k] * wx
            cy += third[k] * wy
    # Splitting the sum of a difference saves a subtraction per pair.
    slopes: tuple[Vector, ...] = ()
    if len(extra) == 3:
        slopes = (
            (ax - extra[0] * sx, ay - extra[0] * sy),
            (bx - extra[1] * sx, by - extra[1] * sy),
            (cx - extra[2] * sx, cy - extra[2] * sy),
        )
    return Regularity((lxx, lxy, lyy), (gx, gy), (sx, sy), (dx, dy), moment, divergence, slopes)


@term
def rate_sums(
    place: Vector,
    own: Flow,
    derived: Derived,
    shifting: Vector,
    near: Array,
    n: int,
    fluid: FluidConstants,
    inverse_length: float,
) -> tuple[float, float, float]:
    """Add up the first n candidates `near` for the rates of a particle."""
    places, densities, velocities, volumes = flow_at(near, slice(0, n))
    pressures, viscosities, gradients = derived_at(near, PRESSURE, slice(0, n))
    dd = du = dv = like(0.0, inverse_length)
    for k in range(n):
        offset = minus(place, element(places, k))
        jump = minus(element(velocities, k), own.velocity)
        carried = dot(shifting, offset)
        slope = dot(plus(element(gradients, k), derived.gradient), offset)
        force = push(pressures[k] + derived.pressure, fluid)
        pull = friction(offset, viscosities[k] + derived.viscous, fluid, inverse_length)
        weight = slope_weight(offset, volumes[k], inverse_length)
        dd += density_exchange(densities[k] - own.density, carried, slope, fluid) * weight
        carry = fluid.reference_density * carried - pull
        gain = minus(times(carry, jump), times(force, offset))
        du += gain[0] * weight
        dv += gain[1] * weight
    return dd, du, dv


@inlined
def over_rows(
    row_sums: Callable[..., Any],
    zeros: Any,
    place: Vector,
    target: Any,
    source: Array,
    search: Search,
    given: Any,
) -> Any:
    """Add up the sources within reach of a place [m], row of cells by row of cells.

    Parameters
    ----------
    row_sums : one of the functions below.
    target : the fields of the particle or ghost there.
    given : constants, and arrays of sources besides `source`.
    """
    x, y = place
    total = zeros
    first, last = rows_within(y, y, search)
    for row in range(first, last):
        low, high = range_in_row(x, y, row, search)
        columns = slice(low, high)
        total = row_sums(total, place, target, source, columns, given, search.inverse_length)
    return total


@term
def wall_regularity_row(
    total: Sums,
    place: Vector,
    target: tuple[Flow, float],
    source: Array,
    columns: slice,
    constants: RegularityConstants,
    inverse_length: float,
) -> Sums:
    """Add a row of ghosts for `wall_sweeps.wall_regularity`."""
    own, distance = target
    places, _, velocities, volumes = flow_at(source, columns)
    depth = source[DEPTH, columns]
    normal = vector_at(source, NORMAL_X, columns)
    returned = source[RETURN, columns]
    sx = sy = dx = dy = moment = divergence = 0.0
    for k in range(volumes.size):
        offset = minus(place, element(places, k))
        weight = slope_weight(offset, volumes[k], inverse_length)
        shove = shifting_push(offset, constants, inverse_length)
        sx += weight * offset[0]
        sy += weight * offset[1]
        dx += shove * weight * offset[0]
        dy += shove * weight * offset[1]
        moment += dot(offset, offset) * laplacian(offset, inverse_length) * weight
        jump = extrapolated(minus(element(velocities, k), own.velocity), depth[k], distance)
        along = jump[0] * offset[0] * normal[0][k] + jump[1] * offset[1] * normal[1][k]
        flux = dot(own.velocity, offset) * weight
        flux += returned[k] * kernel_of(offset, inverse_length) / own.volume
        divergence += along * weight - constants.walls_return * flux
    return (
        total[0] + sx,
        total[1] + sy,
        total[2] + dx,
        total[3] + dy,
        total[4] + moment,
        total[5] + divergence,
    )


@term
def wall_rate_row(
    total: Vector,
    place: Vector,
    target: tuple[Flow, float, float, float],
    source: Array,
    columns: slice,
    fluid: FluidConstants,
    inverse_length: float,
) -> Vector:
    """Add a row of ghosts for `wall_sweeps.wall_rates`."""
    # By hand: with vectors the compiler would unroll this loop, and sums would change their order.
    own, distance, pressure, viscous = target
    places, _, velocities, volumes = flow_at(source, columns)
    pressures = source[PRESSURE, columns]
    depth = source[DEPTH, columns]
    tiny = TINY / (inverse_length * inverse_length)
    strength = fluid.pair_viscosity * fluid.reference_density
    du = dv = 0.0
    for k in range(volumes.size):
        ox = place[0] - places[0][k]
        oy = place[1] - places[1][k]
        square = ox * ox + oy * oy
        weight = gradient_factor(math.sqrt(square), inverse_length) * volumes[k]
        stretch = 1.0 + depth[k] / distance
        jump_u = stretch * (velocities[0][k] - own.velocity[0])
        jump_v = stretch * (velocities[1][k] - own.velocity[1])
        approach = jump_u * ox + jump_v * oy
        force = -push(pressures[k] + pressure, fluid) - strength * approach / (square + tiny)
        pull = friction((ox, oy), 2.0 * viscous, fluid, inverse_length)
        du += (force * ox - pull * jump_u) * weight
        dv += (force * oy - pull * jump_v) * weight
    return plus(total, (du, dv))


@term
def ghost_force_row(
    total: Sums,
    place: Vector,
    target: tuple[Flow, float, float],
    source: Array,
    columns: slice,
    given: tuple[FluidConstants, Array],
    inverse_length: float,
) -> Sums:
    """Add a row of fluid for `wall_sweeps.ghost_forces`."""
    ghost, pressure, depth = target
    fluid, all_distances = given
    places, _, velocities, volumes = flow_at(source, columns)
    pressures = source[PRESSURE, columns]
    viscosities = source[VISCOUS, columns]
    distances = all_distances[columns]
    px = py = sx = sy = 0.0
    for k in range(volumes.size):
        offset = minus(element(places, k), place)
        weight = slope_weight(offset, volumes[k], inverse_length)
        jump = minus(ghost.velocity, element(velocities, k))
        jump = extrapolated(jump, depth, distances[k])
        force = push(pressure + pressures[k], fluid) * weight
        along = pair_friction(offset, jump, fluid, inverse_length) * weight
        pull = friction(offset, 2.0 * viscosities[k], fluid, inverse_length) * weight
        shear = plus(times(along, offset), times(pull, jump))
        px += force * offset[0]
        py += force * offset[1]
        sx += shear[0]
        sy += shear[1]
    return total[0] + px, total[1] + py, total[2] + sx, total[3] + sy


@term
def mean_row(
    total: Sums,
    place: Vector,
    target: None,
    source: Array,
    columns: slice,
    given: None,
    inverse_length: float,
) -> Sums:
    """Add a row of fluid for `ghost_fields.ghost_means`."""
    places, densities, velocities, volumes = flow_at(source, columns)
    weights = density = u = v = flux = 0.0
    for k in range(volumes.size):
        ox = place[0] - places[0][k]
        oy = place[1] - places[1][k]
        distance = math.sqrt(ox * ox + oy * oy)
        weight = kernel(distance, inverse_length)
        weights += weight
        density += densities[k] * weight
        u += velocities[0][k] * weight
        v += velocities[1][k] * weight
        factor = gradient_factor(distance, inverse_length) * volumes[k]
        flux -= (velocities[0][k] * ox + velocities[1][k] * oy) * factor
    return total[0] + weights, total[1] + density, total[2] + u, total[3] + v, total[4] + flux


@term
def damping_row(
    total: float,
    place: Vector,
    target: None,
    source: Array,
    columns: slice,
    values: Array,
    inverse_length: float,
) -> float:
    """Add a row of fluid for `ghost_fields.ghost_damping`."""
    places = vector_at(source, X, columns)
    pressures = values[columns]
    pressure = 0.0
    for k in range(pressures.size):
        offset = minus(place, element(places, k))
        pressure += pressures[k] * kernel_of(offset, inverse_length)
    return total + pressure
