"""The interaction of fluid particles with the ghosts of walls (Eq. 2.15-2.16).

Ghosts never move: they are sorted once, separately from the fluid, and only scenes with walls run
these sweeps. Every sweep sums over one kind of source at targets of the other kind. `source` is
laid out as in `sphrom.kernels.fields`, except that ghosts have additional rows at its end.

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

from numba import prange

from sphrom.arrays import Array
from sphrom.kernels.cells import Search
from sphrom.kernels.fields import (
    DENSITY,
    DEPTH,
    OWN_PRESSURE,
    OWN_VISCOUS,
    PRESSURE,
    BesideWalls,
    FluidConstants,
    RegularityConstants,
    flow_at,
)
from sphrom.kernels.jit import parallel
from sphrom.kernels.sums import ghost_force_row, over_rows, wall_rate_row, wall_regularity_row


@parallel
def wall_regularity(
    beside: BesideWalls,
    ghosts: Array,
    search: Search,
    constants: RegularityConstants,
    out: Array,
) -> None:
    """Compute the sums over ghosts that `sweeps.regularity` needs.

    Parameters
    ----------
    ghosts : the ghosts' sources.
    out : (6, n_particles) rows: sum of the kernel's gradient x, y, and of Eq. 2.14 x, y [1/m];
        the gradient's second moment; the divergence of the velocity [1/s].
    """
    for t in prange(beside.targets.size):
        j = beside.targets[t]
        i = beside.particle[j]
        own = flow_at(beside.source, j)
        target = own, beside.distance[t]
        zeros = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        sums = over_rows(wall_regularity_row, zeros, own.place, target, ghosts, search, constants)
        for f in range(6):
            out[f, i] = sums[f]


@parallel
def wall_rates(
    beside: BesideWalls,
    ghosts: Array,
    search: Search,
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
    regular : (9, n_particles) the result of `sweeps.regularity`.
    out : (2, n_particles) acceleration x, y [m/s2].
    """
    for t in prange(beside.targets.size):
        j = beside.targets[t]
        i = beside.particle[j]
        own = flow_at(beside.source, j)
        target = own, beside.distance[t], regular[OWN_PRESSURE, i], regular[OWN_VISCOUS, i]
        du, dv = over_rows(wall_rate_row, (0.0, 0.0), own.place, target, ghosts, search, fluid)
        full_density = fluid.reference_density + beside.source[DENSITY, j]
        out[0, i] += du / full_density
        out[1, i] += dv / full_density


@parallel
def ghost_forces(
    ghost: Array,
    source: Array,
    distance: Array,
    search: Search,
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
    for i in prange(ghost.shape[1]):
        own = flow_at(ghost, i)
        target = own, ghost[PRESSURE, i], ghost[DEPTH, i]
        given = fluid, distance
        zeros = (0.0, 0.0, 0.0, 0.0)
        sums = over_rows(ghost_force_row, zeros, own.place, target, source, search, given)
        for f in range(4):
            out[f, i] = sums[f] * own.volume
