"""Tensor-product cubic B-splines on a lattice in three dimensions, as in `bspline` in two.

A value is a sum over 64 coefficients around a cell. Coefficients are (n_layers + 3, n_rows + 3,
(n_columns + 3) n): layer by layer and row by row, all `n` functions of a node together.
"""

from __future__ import annotations

from numba import prange

from sphrom.arrays import Array
from sphrom.kernels.bspline import Axis, add_row, locate, slopes, weights
from sphrom.kernels.jit import parallel


@parallel
def evaluate(
    x: Array,
    y: Array,
    z: Array,
    x_axis: Axis,
    y_axis: Axis,
    z_axis: Axis,
    coefficients: Array,
    values: Array,
) -> None:
    """Evaluate every function at positions x, y, z (n_positions,) [m].

    `values` (n_positions, n) is the result.
    """
    n = values.shape[1]
    for i in prange(x.size):
        column, tx = locate(x[i], x_axis)
        row, ty = locate(y[i], y_axis)
        layer, tz = locate(z[i], z_axis)
        along = weights(tx)
        up = weights(ty)
        deep = weights(tz)
        first = column * n
        last = first + 4 * n
        here = values[i]
        here[:] = 0.0
        for l in range(4):
            for r in range(4):
                nodes = coefficients[layer + l, row + r, first:last]
                add_row(nodes, deep[l] * up[r], along, here)


@parallel
def evaluate_with_gradients(
    x: Array,
    y: Array,
    z: Array,
    x_axis: Axis,
    y_axis: Axis,
    z_axis: Axis,
    coefficients: Array,
    values: Array,
    gradients: Array,
) -> None:
    """Evaluate every function and its gradient.

    Parameters
    ----------
    x, y, z, x_axis, y_axis, z_axis, coefficients : as for `evaluate`.
    values, gradients : (n_positions, n), (n_positions, n, 3) the results.
    """
    n = values.shape[1]
    for i in prange(x.size):
        column, tx = locate(x[i], x_axis)
        row, ty = locate(y[i], y_axis)
        layer, tz = locate(z[i], z_axis)
        along = weights(tx)
        steep = slopes(tx)
        up = weights(ty)
        rise = slopes(ty)
        deep = weights(tz)
        sink = slopes(tz)
        first = column * n
        for k in range(n):
            value = dx = dy = dz = 0.0
            for l in range(4):
                for r in range(4):
                    nodes = coefficients[layer + l, row + r]
                    a = nodes[first + k]
                    b = nodes[first + n + k]
                    c = nodes[first + 2 * n + k]
                    d = nodes[first + 3 * n + k]
                    line = along[0] * a + along[1] * b + (along[2] * c + along[3] * d)
                    tilt = steep[0] * a + steep[1] * b + (steep[2] * c + steep[3] * d)
                    value += deep[l] * up[r] * line
                    dx += deep[l] * up[r] * tilt
                    dy += deep[l] * rise[r] * line
                    dz += sink[l] * up[r] * line
            values[i, k] = value
            gradients[i, k, 0] = dx / x_axis.spacing
            gradients[i, k, 1] = dy / y_axis.spacing
            gradients[i, k, 2] = dz / z_axis.spacing
