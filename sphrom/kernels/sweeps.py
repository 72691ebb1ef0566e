"""The two sweeps over pairs that make up the delta-plus-SPH functional (Eq. 2.6-2.14).

Sources are sorted by cell (`cells.py`); `source[f]` is field f of all sources. A particle's
candidates are the contiguous list of its block (`blocks.py`), so that the loop over them
vectorises. Every pair term contains the factor of the kernel's gradient, which vanishes beyond the
support, and the pair of a particle with itself has no offset. No branch is therefore needed, and
only the 1/r^2 of viscosity needs a guard. Terms and sums have the precision of the lists and of the
constants, which are the same; everything else has double precision.

With G = F V_j and a_i = delta u_i . offset, the advective shifting terms of Eq. 2.6 are
sum (rho_j - rho_i) a_i G, and those of Eq. 2.7 rho_0 / rho_i sum (u_j - u_i) a_i G: they vanish for
a uniform field. `printed.py` has the terms as printed.

The Laplacian of the velocity is -sum (c_i + c_j) (u_j - u_i) w G with the weight w of
`wendland.py`, normalised by its second moment 1/c_i = -1/2 sum r^2 w G. The mean of both factors
keeps the forces of a pair opposite.

The acoustic damper is a pressure -alpha rho_0 c0 h div u (Sun et al., Comput. Methods Appl. Mech.
Eng. 2023), in the same sums as the pressure: a bulk viscosity, which only removes energy.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.blocks import N_CHUNKS, Blocks, list_candidates
from sphrom.kernels.cells import Search
from sphrom.kernels.fields import (
    DENSITY,
    DIVERGENCE,
    FIRST,
    OWN_GRADIENT_X,
    OWN_GRADIENT_Y,
    OWN_PRESSURE,
    OWN_SHIFT_U,
    OWN_SHIFT_V,
    OWN_VISCOUS,
    SUPPORT_X,
    SUPPORT_Y,
    VOLUME,
    Derived,
    Flow,
    FluidConstants,
    RegularityConstants,
    X,
    Y,
    derived_at,
    flow_at,
    vector_at,
)
from sphrom.kernels.jit import inlined, like, parallel, term
from sphrom.kernels.sums import Regularity, rate_sums, regularity_sums
from sphrom.kernels.vectors import Vector, minus, vector_like


@inlined
def in_list(flow: Flow, origin: Vector, near: Array) -> Flow:
    """Return a target's fields as in a list of candidates, which has an origin and a precision."""
    other = near[0, 0]
    return Flow(
        vector_like(minus(flow.place, origin), other),
        like(flow.density, other),
        vector_like(flow.velocity, other),
        like(flow.volume, other),
    )


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
def renormalised(matrix: tuple[float, float, float], gradient: Vector) -> Vector:
    """Return a sum over differences as a gradient (Eq. 2.11)."""
    xx, xy, yy = matrix
    # L_i is the inverse of minus the sum of offset times gradient.
    determinant = xx * yy - xy * xy
    return (
        -(yy * gradient[0] - xy * gradient[1]) / determinant,
        -(xx * gradient[1] - xy * gradient[0]) / determinant,
    )


@term
def finish_regularity(
    sums: Regularity,
    density: float,
    walls: Array,
    i: int,
    constants: RegularityConstants,
    out: Array,
) -> None:
    """Fill particle i's column of `regularity` from its sums and those over walls."""
    sx, sy = sums.support
    dx, dy = sums.push
    moment = sums.moment
    divergence = sums.divergence
    if walls.shape[1] > 0:
        sx += walls[0, i]
        sy += walls[1, i]
        dx += walls[2, i]
        dy += walls[3, i]
        moment += walls[4, i]
        divergence += walls[5, i]
    out[OWN_PRESSURE] = density - constants.damping * divergence
    out[OWN_VISCOUS] = -2.0 / moment
    out[OWN_GRADIENT_X], out[OWN_GRADIENT_Y] = renormalised(sums.matrix, sums.gradient)
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
    blocks: Blocks,
    search: Search,
    source: Array,
    constants: RegularityConstants,
    walls: Array,
    out: Array,
    slopes: tuple[Array, ...],
) -> None:
    """Compute the shifting, and the values of particles and neighbours that the rates need.

    The density's gradient is that of the fluid only; the other sums include walls.

    Parameters
    ----------
    walls : (6, n_particles) the result of `wall_regularity`, or (6, 0) without walls.
    out : (9, n_particles) rows: density fluctuation with the damper's pressure over c0^2 [kg/m3];
        c of the Laplacian; renormalised density gradient x, y [kg/m4] (Eq. 2.11); shifting velocity
        x, y [m/s] (Eq. 2.13-2.14); divergence of the velocity [1/s]; sum of the kernel's gradient
        x, y [1/m].
    slopes : none, or one (n_particles, 3, 2): renormalised gradients of the three fields in the
        rows of `source` after the volume.
    """
    n_blocks = blocks.start.size - 1
    n_rows = VOLUME + 1 + 3 * len(slopes)
    for chunk in prange(N_CHUNKS):
        near = blocks.scratch[chunk, :n_rows]
        for block in range(chunk * n_blocks // N_CHUNKS, (chunk + 1) * n_blocks // N_CHUNKS):
            here = blocks.targets[blocks.start[block] : blocks.start[block + 1]]
            n = list_candidates(source, here, search, near)
            origin = vector_at(source, X, here[0])
            for t in range(here.size):
                j = here[t]
                i = blocks.particle[j]
                own = in_list(flow_at(source, j), origin, near)
                if len(slopes) == 0:
                    extra: tuple[float, ...] = ()
                else:
                    first = like(source[FIRST, j], own.density)
                    second = like(source[FIRST + 1, j], own.density)
                    extra = first, second, like(source[FIRST + 2, j], own.density)
                inverse_length = like(search.inverse_length, own.density)
                sums = regularity_sums(own.place, own, near, n, extra, constants, inverse_length)
                finish_regularity(sums, source[DENSITY, j], walls, i, constants, out[:, i])
                if len(slopes) == 1:
                    for f in range(3):
                        slope = renormalised(sums.matrix, sums.slopes[f])
                        slopes[0][i, f, 0] = slope[0]
                        slopes[0][i, f, 1] = slope[1]


@inlined
def rates_of_chunk(
    pair_sums: Callable[..., Any],
    spreading: Callable[..., float],
    chunk: int,
    blocks: Blocks,
    search: Search,
    source: Array,
    regular: Array,
    fluid: FluidConstants,
    out: Array,
) -> None:
    """Compute the rates of the particles in one chunk of blocks.

    Parameters
    ----------
    pair_sums, spreading : `rate_sums` and `no_spreading`, or those of `printed.py`.
    """
    n_blocks = blocks.start.size - 1
    near = blocks.scratch[chunk, : source.shape[0]]
    for block in range(chunk * n_blocks // N_CHUNKS, (chunk + 1) * n_blocks // N_CHUNKS):
        here = blocks.targets[blocks.start[block] : blocks.start[block + 1]]
        n = list_candidates(source, here, search, near)
        origin = vector_at(source, X, here[0])
        for t in range(here.size):
            j = here[t]
            i = blocks.particle[j]
            flow = flow_at(source, j)
            own = in_list(flow, origin, near)
            inverse_length = like(search.inverse_length, own.density)
            found = derived_at(regular, OWN_PRESSURE, i)
            derived = Derived(
                like(found.pressure, own.density),
                like(found.viscous, own.density),
                vector_like(found.gradient, own.density),
            )
            shifting = vector_at(regular, OWN_SHIFT_U, i)
            shift = vector_like(shifting, own.density)
            dd, du, dv = pair_sums(own.place, own, derived, shift, near, n, fluid, inverse_length)
            spread = spreading(shifting, vector_at(regular, SUPPORT_X, i), fluid)
            full_density = fluid.reference_density + flow.density
            out[0, i] = dd + full_density * (spread - regular[DIVERGENCE, i])
            u, v = flow.velocity
            out[1, i] = (du + fluid.reference_density * u * spread) / full_density
            out[2, i] = (dv + fluid.reference_density * v * spread) / full_density


@inlined
def no_spreading(shifting: Vector, support: Vector, fluid: FluidConstants) -> float:
    """Return zero [1/s]: the shifting of differences adds nothing to a uniform field."""
    return 0.0


@parallel
def rates(
    blocks: Blocks,
    search: Search,
    source: Array,
    regular: Array,
    fluid: FluidConstants,
    out: Array,
) -> None:
    """Compute the rates of density and velocity (Eq. 2.6-2.12, without ghosts and body force).

    Parameters
    ----------
    source : (10, n_sources).
    regular : (9, n_particles) the result of `regularity`.
    out : (3, n_particles) rows: rate of density [kg/m3/s], acceleration x, y [m/s2].
    """
    for chunk in prange(N_CHUNKS):
        rates_of_chunk(rate_sums, no_spreading, chunk, blocks, search, source, regular, fluid, out)
