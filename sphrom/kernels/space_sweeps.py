"""The two sweeps of the delta-plus-SPH functional in three dimensions (compare `sweeps`).

The terms are those of `pairs`, so they are the same as in two dimensions. Walls are not separate
sums here: the sources include reflected images of particles.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.blocks import N_CHUNKS, Blocks
from sphrom.kernels.fields import Derived, Flow, FluidConstants, RegularityConstants
from sphrom.kernels.jit import inlined, parallel, term
from sphrom.kernels.pairs import (
    density_exchange,
    friction,
    laplacian,
    push,
    shifting_push,
    slope_weight,
)
from sphrom.kernels.space_lists import SpaceSearch, list_space_candidates
from sphrom.kernels.vectors import Vector, dot, element, minus, plus, times

# Rows of `source`; vectors have three rows.
PLACE, DENSITY, VELOCITY, VOLUME, PRESSURE, VISCOUS, GRADIENT = 0, 3, 4, 7, 8, 9, 10
N_FIELDS = 13
# Rows of the result of `space_regularity`; the first five are in the order of `source`.
OWN_PRESSURE, OWN_VISCOUS, OWN_GRADIENT, OWN_SHIFT, DIVERGENCE, SUPPORT = 0, 1, 2, 5, 8, 9
N_REGULAR_ROWS = 12
N_SHARED = OWN_SHIFT
"""Number of rows of the result that neighbours need."""


class SpaceSums(NamedTuple):
    """The sums of `space_regularity` for one particle (compare `sums.Regularity`)."""

    matrix: tuple[float, float, float, float, float, float]
    """xx, xy, yy, xz, yz, zz."""
    gradient: Vector
    support: Vector
    push: Vector
    moment: float
    divergence: float


@parallel
def gather_space(
    particle: Indices, image: Array, flip: Array, fields: Array, first: int, source: Array
) -> None:
    """Copy particle fields to all sources, from row `first` on; x becomes flip x + image."""
    for k in prange(particle.size):
        i = particle[k]
        for f in range(fields.shape[0]):
            source[first + f, k] = fields[f, i]
        if first == PLACE:
            for axis in range(3):
                source[axis, k] = flip[axis, k] * source[axis, k] + image[axis, k]


@inlined
def space_vector(fields: Array, first: int, columns: Any) -> Vector:
    """Return the vector whose components are three rows of an array from the first one on."""
    return fields[first, columns], fields[first + 1, columns], fields[first + 2, columns]


@inlined
def space_flow(source: Array, columns: Any) -> Flow:
    """Return the fields of a source, or of those in a slice."""
    return Flow(
        space_vector(source, PLACE, columns),
        source[DENSITY, columns],
        space_vector(source, VELOCITY, columns),
        source[VOLUME, columns],
    )


@inlined
def space_derived(fields: Array, first: int, columns: Any) -> Derived:
    """Return the derived fields in the rows from `first` on, of one source or of a slice of
    them."""
    return Derived(
        fields[first, columns],
        fields[first + 1, columns],
        space_vector(fields, first + 2, columns),
    )


@term
def space_regularity_sums(
    place: Vector,
    own: Flow,
    near: Array,
    n: int,
    constants: RegularityConstants,
    inverse_length: float,
) -> SpaceSums:
    """Add up the first n candidates `near` of a particle."""
    places, densities, velocities, volumes = space_flow(near, slice(0, n))
    xx = xy = yy = xz = yz = zz = gx = gy = gz = sx = sy = sz = dx = dy = dz = 0.0
    moment = divergence = 0.0
    for k in range(n):
        offset = minus(place, element(places, k))
        weight = slope_weight(offset, volumes[k], inverse_length)
        wx, wy, wz = times(weight, offset)
        xx += offset[0] * wx
        xy += offset[0] * wy
        yy += offset[1] * wy
        xz += offset[0] * wz
        yz += offset[1] * wz
        zz += offset[2] * wz
        jump = densities[k] - own.density
        gx += jump * wx
        gy += jump * wy
        gz += jump * wz
        sx += wx
        sy += wy
        sz += wz
        moment += dot(offset, offset) * laplacian(offset, inverse_length) * weight
        divergence += dot(minus(element(velocities, k), own.velocity), (wx, wy, wz))
        shove = shifting_push(offset, constants, inverse_length)
        dx += shove * wx
        dy += shove * wy
        dz += shove * wz
    return SpaceSums(
        (xx, xy, yy, xz, yz, zz), (gx, gy, gz), (sx, sy, sz), (dx, dy, dz), moment, divergence
    )


@term
def space_gradient(
    matrix: tuple[float, float, float, float, float, float], gradient: Vector
) -> Vector:
    """Return a sum over differences as a gradient (Eq. 2.11), by the matrix of cofactors."""
    xx, xy, yy, xz, yz, zz = matrix
    gx, gy, gz = gradient
    a = yy * zz - yz * yz
    b = xz * yz - xy * zz
    c = xy * yz - xz * yy
    d = xx * zz - xz * xz
    e = xy * xz - xx * yz
    f = xx * yy - xy * xy
    determinant = xx * a + xy * b + xz * c
    return (
        -(a * gx + b * gy + c * gz) / determinant,
        -(b * gx + d * gy + e * gz) / determinant,
        -(c * gx + e * gy + f * gz) / determinant,
    )


@parallel
def space_regularity(
    blocks: Blocks,
    search: SpaceSearch,
    source: Array,
    constants: RegularityConstants,
    out: Array,
) -> None:
    """Compute the shifting, and the values of particles and neighbours that the rates need.

    Parameters
    ----------
    source : (>= 8, n_sources).
    out : (12, n_particles) rows as in `sweeps.regularity`, with vectors of three components.
    """
    n_blocks = blocks.start.size - 1
    for chunk in prange(N_CHUNKS):
        near = blocks.scratch[chunk, : VOLUME + 1]
        for block in range(chunk * n_blocks // N_CHUNKS, (chunk + 1) * n_blocks // N_CHUNKS):
            here = blocks.targets[blocks.start[block] : blocks.start[block + 1]]
            n = list_space_candidates(source, here, search, near)
            origin = space_vector(source, PLACE, here[0])
            for t in range(here.size):
                i = blocks.particle[here[t]]
                own = space_flow(source, here[t])
                place = minus(own.place, origin)
                sums = space_regularity_sums(place, own, near, n, constants, search.inverse_length)
                gradient = space_gradient(sums.matrix, sums.gradient)
                speed = constants.magnitude * math.sqrt(dot(sums.push, sums.push))
                scale = -constants.magnitude
                if speed > constants.limit:
                    scale *= constants.limit / speed
                out[OWN_PRESSURE, i] = own.density - constants.damping * sums.divergence
                out[OWN_VISCOUS, i] = -3.0 / sums.moment
                for axis in range(3):
                    out[OWN_GRADIENT + axis, i] = gradient[axis]
                    out[OWN_SHIFT + axis, i] = scale * sums.push[axis]
                    out[SUPPORT + axis, i] = sums.support[axis]
                out[DIVERGENCE, i] = sums.divergence


@term
def space_rate_sums(
    place: Vector,
    own: Flow,
    derived: Derived,
    shifting: Vector,
    near: Array,
    n: int,
    fluid: FluidConstants,
    inverse_length: float,
) -> tuple[float, float, float, float]:
    """Add up the first n candidates `near` for the rates of a particle."""
    places, densities, velocities, volumes = space_flow(near, slice(0, n))
    pressures, viscosities, gradients = space_derived(near, PRESSURE, slice(0, n))
    dd = du = dv = dw = 0.0
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
        dw += gain[2] * weight
    return dd, du, dv, dw


@parallel
def space_rates(
    blocks: Blocks,
    search: SpaceSearch,
    source: Array,
    regular: Array,
    fluid: FluidConstants,
    out: Array,
) -> None:
    """Compute the rates of density and velocity (Eq. 2.6-2.12, without body force).

    Parameters
    ----------
    source : (13, n_sources).
    regular : (12, n_particles) the result of `space_regularity`.
    out : (4, n_particles) rows: rate of density [kg/m3/s], acceleration x, y, z [m/s2].
    """
    n_blocks = blocks.start.size - 1
    for chunk in prange(N_CHUNKS):
        near = blocks.scratch[chunk]
        for block in range(chunk * n_blocks // N_CHUNKS, (chunk + 1) * n_blocks // N_CHUNKS):
            here = blocks.targets[blocks.start[block] : blocks.start[block + 1]]
            n = list_space_candidates(source, here, search, near)
            origin = space_vector(source, PLACE, here[0])
            for t in range(here.size):
                i = blocks.particle[here[t]]
                own = space_flow(source, here[t])
                derived = space_derived(regular, OWN_PRESSURE, i)
                shifting = space_vector(regular, OWN_SHIFT, i)
                place = minus(own.place, origin)
                dd, du, dv, dw = space_rate_sums(
                    place, own, derived, shifting, near, n, fluid, search.inverse_length
                )
                full_density = fluid.reference_density + own.density
                out[0, i] = dd - full_density * regular[DIVERGENCE, i]
                out[1, i] = du / full_density
                out[2, i] = dv / full_density
                out[3, i] = dw / full_density
