"""Tensor-product cubic B-splines on a lattice: values and gradients at many positions.

A position is in one cell of the lattice of points. Its value is a sum over sixteen coefficients
around the cell, with weights that are products of one per axis. Coefficients are stored row by row,
all columns of a node together, so that the four nodes of a row are contiguous in memory and the
loop over columns vectorises. Positions outside use the polynomials of the nearest cell. Every
position is computed independently, so results are the same with any number of threads.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import prange

from sphrom.arrays import Array
from sphrom.kernels.jit import parallel, term

Four = tuple[float, float, float, float]


class Axis(NamedTuple):
    """The cells between points of a lattice along an axis."""

    origin: float
    """The first point [m]."""
    spacing: float
    """[m]"""
    n_cells: int
    """The number of points if periodic, else one less."""
    period: float
    """The period in spacings; zero if the axis is not periodic."""


@term
def locate(coordinate: float, axis: Axis) -> tuple[int, float]:
    """Return the cell for a coordinate, and the coordinate's position in it (0 to 1 inside)."""
    along = (coordinate - axis.origin) / axis.spacing
    if axis.period > 0.0:
        along -= axis.period * math.floor(along / axis.period)
    cell = min(max(math.floor(along), 0), axis.n_cells - 1)
    return cell, along - cell


@term
def weights(t: float) -> Four:
    """Return the four cubic B-splines of a cell at the position `t` in it."""
    s = 1.0 - t
    return (
        s * s * s / 6.0,
        (4.0 - 3.0 * t * t * (1.0 + s)) / 6.0,
        (4.0 - 3.0 * s * s * (1.0 + t)) / 6.0,
        t * t * t / 6.0,
    )


@term
def slopes(t: float) -> Four:
    """Return the derivatives of the four B-splines."""
    s = 1.0 - t
    return -0.5 * s * s, 0.5 * t * (3.0 * t - 4.0), 0.5 * s * (4.0 - 3.0 * s), 0.5 * t * t


@term
def add_row(nodes: Array, factor: float, along: Four, values: Array) -> None:
    """Add a row of four nodes (4 n_columns,) to values (n_columns,)."""
    n = values.size
    a = factor * along[0]
    b = factor * along[1]
    c = factor * along[2]
    d = factor * along[3]
    for k in range(n):
        values[k] += a * nodes[k] + b * nodes[n + k] + (c * nodes[2 * n + k] + d * nodes[3 * n + k])


@parallel
def evaluate(
    x: Array, y: Array, x_axis: Axis, y_axis: Axis, coefficients: Array, values: Array
) -> None:
    """Evaluate every column at every position.

    Parameters
    ----------
    x, y : (n_positions,) [m].
    coefficients : (n_rows + 3, (n_columns + 3) n) of the nodes, each with all `n` columns.
    values : (n_positions, n) the result.
    """
    n = values.shape[1]
    for i in prange(x.size):
        column, tx = locate(x[i], x_axis)
        row, ty = locate(y[i], y_axis)
        along = weights(tx)
        up = weights(ty)
        first = column * n
        last = first + 4 * n
        here = values[i]
        here[:] = 0.0
        add_row(coefficients[row, first:last], up[0], along, here)
        add_row(coefficients[row + 1, first:last], up[1], along, here)
        add_row(coefficients[row + 2, first:last], up[2], along, here)
        add_row(coefficients[row + 3, first:last], up[3], along, here)


@parallel
def evaluate_with_gradients(
    x: Array,
    y: Array,
    x_axis: Axis,
    y_axis: Axis,
    coefficients: Array,
    values: Array,
    gradients: Array,
) -> None:
    """Evaluate every column and its gradient at every position.

    Parameters
    ----------
    x, y, x_axis, y_axis, coefficients : as for `evaluate`.
    values, gradients : (n_positions, n), (n_positions, n, 2) the results.
    """
    n = values.shape[1]
    for i in prange(x.size):
        column, tx = locate(x[i], x_axis)
        row, ty = locate(y[i], y_axis)
        along = weights(tx)
        steep = slopes(tx)
        up = weights(ty)
        rise = slopes(ty)
        first = column * n
        for k in range(n):
            value = dx = dy = 0.0
            for r in range(4):
                a = coefficients[row + r, first + k]
                b = coefficients[row + r, first + n + k]
                c = coefficients[row + r, first + 2 * n + k]
                d = coefficients[row + r, first + 3 * n + k]
                line = along[0] * a + along[1] * b + (along[2] * c + along[3] * d)
                value += up[r] * line
                dy += rise[r] * line
                dx += up[r] * (steep[0] * a + steep[1] * b + (steep[2] * c + steep[3] * d))
            values[i, k] = value
            gradients[i, k, 0] = dx / x_axis.spacing
            gradients[i, k, 1] = dy / y_axis.spacing
