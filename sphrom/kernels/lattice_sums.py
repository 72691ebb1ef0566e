"""Sums over the neighbours of lattice points in three dimensions.

All points have the same stencil of offsets, so its weights are computed once and no pairs are
stored. Beyond the ends of an axis a neighbour is the image of a point: moved by a period, or
reflected at the wall. For each axis, `index` is the coordinate of the point behind every coordinate
of the stencil's reach, and `factor` multiplies the fields of such images.
"""

from __future__ import annotations

from typing import NamedTuple

from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.jit import parallel


class Images(NamedTuple):
    """The points behind all coordinates from `depth` before the first of each axis."""

    depth: int
    x: Indices
    """(n_columns + 2 depth,)"""
    y: Indices
    z: Indices
    x_factor: Array
    y_factor: Array
    z_factor: Array


@parallel
def sums(
    targets: Indices,
    fields: Array,
    stencil: Indices,
    weights: Array,
    images: Images,
    out: Array,
) -> None:
    """Sum fields over the neighbours of some points.

    Parameters
    ----------
    targets : (n,) numbers of these points, along x first, then along y.
    fields : (n_points, n_fields) at all points.
    stencil : (n_neighbours, 3) offsets in numbers of points, along x first.
    weights : (n_neighbours, n_sums).
    out : (n_sums, n, n_fields) the sums at n points.
    """
    n_columns = images.x.size - 2 * images.depth
    n_rows = images.y.size - 2 * images.depth
    n_fields = fields.shape[1]
    for r in prange(out.shape[1]):
        point = targets[r]
        x = point % n_columns + images.depth
        y = point // n_columns % n_rows + images.depth
        z = point // (n_columns * n_rows) + images.depth
        for k in range(out.shape[0]):
            for f in range(n_fields):
                out[k, r, f] = 0.0
        for s in range(stencil.shape[0]):
            i = x + stencil[s, 0]
            j = y + stencil[s, 1]
            l = z + stencil[s, 2]
            source = fields[(images.z[l] * n_rows + images.y[j]) * n_columns + images.x[i]]
            factor = images.x_factor[i] * images.y_factor[j] * images.z_factor[l]
            for k in range(out.shape[0]):
                weight = factor * weights[s, k]
                here = out[k, r]
                for f in range(n_fields):
                    here[f] += weight * source[f]
