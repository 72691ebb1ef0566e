"""Linear fits of the fluid's fields around the mirror points of ghosts, which continue them there.

Offsets o from a mirror point are over the smoothing length h, and W is the kernel times h^2, so
that moments have no units. With M = sum_j W (1, o_j)(1, o_j)^T, the fit of a field f has the value
and the slope M^-1 sum_j W (1, o_j) f_j there. Ghosts that share a mirror point share its fit.
`source` is laid out as in `sphrom.kernels.fields`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.cells import Search, range_in_row
from sphrom.kernels.fields import X, vector_at
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.pairs import kernel_of
from sphrom.kernels.sums import over_rows
from sphrom.kernels.vectors import Vector, element, minus, times

Sums = tuple[float, ...]

LEAST_SPREAD = 1e-3
"""Determinant of the covariance, relative to h^4, below which fluid is too sparse for a slope."""


class Mirrors(NamedTuple):
    """Mirror points, and the ghosts that share them."""

    place: Array
    """(2, n_mirrors) [m], for `transposed` in ascending order of y."""
    start: Indices
    """(n_mirrors + 1,) the first of each point's ghosts."""
    ghost: Indices
    """(n_ghosts,) the ghosts, point by point."""
    way: Array
    """(2, n_ghosts) from a ghost's mirror point to the ghost, relative to h."""


@term
def _moment_row(
    total: Sums,
    place: Vector,
    target: None,
    source: Array,
    columns: slice,
    values: Array,
    inverse_length: float,
) -> Sums:
    places = vector_at(source, X, columns)
    some = values[columns]
    s = sx = sy = sxx = sxy = syy = f = fx = fy = 0.0
    for k in range(some.size):
        ox, oy = times(inverse_length, minus(element(places, k), place))
        w = kernel_of((ox, oy), 1.0)
        wx = w * ox
        wy = w * oy
        s += w
        sx += wx
        sy += wy
        sxx += wx * ox
        sxy += wx * oy
        syy += wy * oy
        f += w * some[k]
        fx += wx * some[k]
        fy += wy * some[k]
    return (
        total[0] + s,
        total[1] + sx,
        total[2] + sy,
        total[3] + sxx,
        total[4] + sxy,
        total[5] + syy,
        total[6] + f,
        total[7] + fx,
        total[8] + fy,
    )


@term
def _solved(inverse: Array, sums: Sums) -> Sums:
    """Return the product of M^-1, as in `fits`, and three sums."""
    f, fx, fy = sums
    return (
        inverse[0] * f + inverse[1] * fx + inverse[2] * fy,
        inverse[1] * f + inverse[3] * fx + inverse[4] * fy,
        inverse[2] * f + inverse[4] * fx + inverse[5] * fy,
    )


@term
def _continue(fit: Sums, mirrors: Mirrors, i: int, out: Array) -> None:
    """Set the values (n_ghosts,) at the ghosts of mirror point i."""
    value, slope_x, slope_y = fit
    for ghost in mirrors.ghost[mirrors.start[i] : mirrors.start[i + 1]]:
        out[ghost] = value + slope_x * mirrors.way[0, ghost] + slope_y * mirrors.way[1, ghost]


@parallel
def fits(
    mirrors: Mirrors, source: Array, values: Array, search: Search, inverse: Array, out: Array
) -> None:
    """Compute the inverse moments, and the values of a field at ghosts.

    Where the fluid is too sparse for a slope, the fit is its mean; without fluid it is zero.

    Parameters
    ----------
    values : (n_sources,) of the fluid.
    inverse : (6, n_mirrors) M^-1: its first row, then xx, xy, yy.
    out : (n_ghosts,)
    """
    for i in prange(inverse.shape[1]):
        zeros = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        sums = over_rows(
            _moment_row, zeros, vector_at(mirrors.place, 0, i), None, source, search, values
        )
        s, sx, sy, sxx, sxy, syy, f, fx, fy = sums
        inverse[:, i] = 0.0
        if s > 0.0:
            mean_x = sx / s
            mean_y = sy / s
            xx = sxx / s - mean_x * mean_x
            xy = sxy / s - mean_x * mean_y
            yy = syy / s - mean_y * mean_y
            spread = xx * yy - xy * xy
            if spread > LEAST_SPREAD:
                inverse[1, i] = (xy * mean_y - yy * mean_x) / (spread * s)
                inverse[2, i] = (xy * mean_x - xx * mean_y) / (spread * s)
                inverse[3, i] = yy / (spread * s)
                inverse[4, i] = -xy / (spread * s)
                inverse[5, i] = xx / (spread * s)
            inverse[0, i] = 1.0 / s - inverse[1, i] * mean_x - inverse[2, i] * mean_y
        _continue(_solved(inverse[:, i], (f, fx, fy)), mirrors, i, out)


@term
def _value_row(
    total: Sums,
    place: Vector,
    target: None,
    source: Array,
    columns: slice,
    values: Array,
    inverse_length: float,
) -> Sums:
    places = vector_at(source, X, columns)
    some = values[columns]
    f = fx = fy = 0.0
    for k in range(some.size):
        ox, oy = times(inverse_length, minus(element(places, k), place))
        w = kernel_of((ox, oy), 1.0) * some[k]
        f += w
        fx += w * ox
        fy += w * oy
    return total[0] + f, total[1] + fx, total[2] + fy


@parallel
def fits_again(
    mirrors: Mirrors, inverse: Array, source: Array, values: Array, search: Search, out: Array
) -> None:
    """Compute the values (n_ghosts,) of another field, with the inverse moments of `fits`."""
    for i in prange(inverse.shape[1]):
        zeros = (0.0, 0.0, 0.0)
        sums = over_rows(
            _value_row, zeros, vector_at(mirrors.place, 0, i), None, source, search, values
        )
        _continue(_solved(inverse[:, i], sums), mirrors, i, out)


@term
def _spread(place: Vector, fit: Sums, places: Vector, inverse_length: float, out: Array) -> None:
    a, bx, by = fit
    for k in range(out.size):
        ox, oy = times(inverse_length, minus(element(places, k), place))
        out[k] += kernel_of((ox, oy), 1.0) * (a + bx * ox + by * oy)


@term
def _gathered(given: Array, mirrors: Mirrors, i: int) -> Sums:
    """Return the sums of a quantity (n_ghosts,) and its moments over the ghosts of point i."""
    f = fx = fy = 0.0
    for ghost in mirrors.ghost[mirrors.start[i] : mirrors.start[i + 1]]:
        f += given[ghost]
        fx += given[ghost] * mirrors.way[0, ghost]
        fy += given[ghost] * mirrors.way[1, ghost]
    return f, fx, fy


@parallel
def transposed(
    mirrors: Mirrors, inverse: Array, given: Array, source: Array, search: Search, out: Array
) -> None:
    """Compute the transposed product of the fits and some quantity of ghosts.

    Rows of cells are independent, because each source is in one of them.

    Parameters
    ----------
    given : (n_ghosts,)
    out : (n_sources,)
    """
    for row in prange(search.n_rows):
        start = search.cell_start[row * search.n_columns]
        end = search.cell_start[(row + 1) * search.n_columns]
        out[start:end] = 0.0
        south = search.y_origin + row * search.cell_height
        north = south + search.cell_height
        first = np.searchsorted(mirrors.place[1], south - search.reach)
        last = np.searchsorted(mirrors.place[1], north + search.reach)
        for i in range(first, last):
            x, y = vector_at(mirrors.place, 0, i)
            low, high = range_in_row(x, y, row, search)
            places = vector_at(source, X, slice(low, high))
            fit = _solved(inverse[:, i], _gathered(given, mirrors, i))
            _spread((x, y), fit, places, search.inverse_length, out[low:high])
