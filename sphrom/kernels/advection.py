"""Advection by sums over pairs, which reduced models use beside the functional.

The sums are written by hand: with the functions of `pairs.py` their last digits change.
"""

from __future__ import annotations

import math

from numba import prange

from sphrom.arrays import Array
from sphrom.kernels.cells import Search, range_in_row, rows_within
from sphrom.kernels.fields import DENSITY, VOLUME, BesideWalls, U, V, X, Y
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.wendland import gradient_factor


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
    beside: BesideWalls,
    source: Array,
    search: Search,
    depth: Array,
    reference_density: float,
    out: Array,
) -> None:
    """Compute the advection of density and velocity by the velocity, as in Eq. 3.5-3.6.

    It has the form of the shifting terms: sum (f_j - f_i) (u_j . offset) G + 2 f_i u_i . s_i.

    Parameters
    ----------
    beside : all particles, infinitely far from walls; or those near walls.
    source : the sources of the sums: the fluid's, or ghosts.
    depth : (n_sources,) depth of ghosts for the extrapolation of velocities, else 0 [m].
    out : (3, n_particles) rows: u . grad rho [kg/m3/s], u . grad u [m/s2].
    """
    for t in prange(beside.targets.size):
        j = beside.targets[t]
        xi = beside.source[X, j]
        yi = beside.source[Y, j]
        density = beside.source[DENSITY, j]
        u = beside.source[U, j]
        v = beside.source[V, j]
        nearness = 1.0 / beside.distance[t]
        td = tu = tv = sx = sy = 0.0
        first, last = rows_within(yi, yi, search)
        for row in range(first, last):
            low, high = range_in_row(xi, yi, row, search)
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
                search.inverse_length,
            )
            td += b[0]
            tu += b[1]
            tv += b[2]
            sx += b[3]
            sy += b[4]
        i = beside.particle[j]
        spread = 2.0 * (u * sx + v * sy)
        out[0, i] = td + (reference_density + density) * spread
        out[1, i] = tu + u * spread
        out[2, i] = tv + v * spread
