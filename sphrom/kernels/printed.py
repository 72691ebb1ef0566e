"""Viscosity and the transport by shifting as printed (Eq. 2.6, 2.7, 2.12), in place of `sweeps`.

With a_i = delta u_i . offset, the shifting terms have a_j in place of a_i, and the additional terms
2 rho_i delta u_i . s_i and 2 rho_0 / rho_i u_i delta u_i . s_i, with s_i the sum of the kernel's
gradient times V_j. Eq. 2.12 has friction along the line between two particles only.
"""

from __future__ import annotations

import math

from numba import prange

from sphrom.arrays import Array
from sphrom.kernels.blocks import N_CHUNKS, Blocks
from sphrom.kernels.cells import Search
from sphrom.kernels.fields import (
    N_FIELDS,
    PRESSURE,
    SHIFT_U,
    Derived,
    Flow,
    FluidConstants,
    derived_at,
    flow_at,
    vector_at,
)
from sphrom.kernels.jit import inlined, parallel, term
from sphrom.kernels.pairs import TINY, density_exchange
from sphrom.kernels.sweeps import rates_of_chunk
from sphrom.kernels.vectors import Vector, dot, element, plus, times
from sphrom.kernels.wendland import gradient_factor, laplacian_weight

N_PRINTED_FIELDS = N_FIELDS + 2
"""Number of rows of `source`, with the neighbours' shifting velocities."""


def are_selected(fluid: FluidConstants) -> bool:
    """Return whether constants select a term as printed."""
    return fluid.advective == 0.0 or fluid.pair_viscosity > 0.0


@term
def printed_sums(
    place: Vector,
    own: Flow,
    derived: Derived,
    shifting: Vector,
    near: Array,
    n: int,
    fluid: FluidConstants,
    inverse_length: float,
) -> tuple[float, float, float]:
    """Add up as `sums.rate_sums`, with those terms as printed that constants select."""
    places, densities, velocities, volumes = flow_at(near, slice(0, n))
    pressures, viscosities, gradients = derived_at(near, PRESSURE, slice(0, n))
    shifts = vector_at(near, SHIFT_U, slice(0, n))
    stiffness = fluid.sound_speed * fluid.sound_speed
    strength = fluid.pair_viscosity * fluid.reference_density
    drag = fluid.laplacian_viscosity * fluid.reference_density
    tiny = TINY / (inverse_length * inverse_length)
    from_others = 1.0 - fluid.advective
    own_u, own_v = times(fluid.advective, shifting)
    dd = du = dv = 0.0
    for k in range(n):
        ox = place[0] - places[0][k]
        oy = place[1] - places[1][k]
        square = ox * ox + oy * oy
        weight = gradient_factor(math.sqrt(square), inverse_length) * volumes[k]
        jump_u = velocities[0][k] - own.velocity[0]
        jump_v = velocities[1][k] - own.velocity[1]
        jump = densities[k] - own.density
        approach = jump_u * ox + jump_v * oy
        carried = from_others * (shifts[0][k] * ox + shifts[1][k] * oy) + own_u * ox + own_v * oy
        slope = dot(plus(element(gradients, k), derived.gradient), (ox, oy))
        dd += density_exchange(jump, carried, slope, fluid) * weight
        force = -stiffness * (pressures[k] + derived.pressure)
        force -= strength * approach / (square + tiny)
        pull = drag * laplacian_weight(square, inverse_length) * (viscosities[k] + derived.viscous)
        carry = fluid.reference_density * carried - pull
        du += (force * ox + carry * jump_u) * weight
        dv += (force * oy + carry * jump_v) * weight
    return dd, du, dv


@inlined
def spreading(shifting: Vector, support: Vector, fluid: FluidConstants) -> float:
    """Return 2 delta u_i . s_i [1/s] if a uniform field spreads with the particles, else zero."""
    shift = dot(shifting, support)
    return (1.0 - fluid.advective) * 2.0 * shift


@parallel
def rates(
    blocks: Blocks,
    search: Search,
    source: Array,
    regular: Array,
    fluid: FluidConstants,
    out: Array,
) -> None:
    """Compute the same as `sweeps.rates`, from sources (12, n_sources)."""
    for chunk in prange(N_CHUNKS):
        rates_of_chunk(printed_sums, spreading, chunk, blocks, search, source, regular, fluid, out)
