"""Interpolation from particles to fixed points: Shepard (Eq. 3.15) and moving least squares.

Both take sources sorted by cell, with three fields each, and any points. Moving least squares fit a
full quadratic polynomial, weighted by the kernel, and return its value at the point, or for the
first field a mean of this value and that of a linear polynomial. Coordinates are offsets over the
smoothing length, so that all moments have a similar size.
"""

from __future__ import annotations

import math

from numba import prange

from sphrom.arrays import Array
from sphrom.kernels.cells import Search, range_in_row, rows_within
from sphrom.kernels.fields import vector_at
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.pairs import kernel_of
from sphrom.kernels.sums import over_rows
from sphrom.kernels.vectors import Vector, element, minus, times

N_TERMS, N_LINEAR = 6, 3
"""Terms of a quadratic polynomial in two dimensions: 1, x, y, x^2, x y, y^2; the linear ones."""
N_CHUNKS = 64
"""Number of parts into which points are divided; each has its own scratch memory."""
N_SUMS = 33
"""15 moments up to the fourth order, and 3 fields times 6 terms."""

LEAST_PIVOT = 1e-8
"""A pivot below this share of its diagonal is rounding: there are too few sources, or they are on
one conic, such as one line or two. In corners of walls 1e-3 was found, beside voids there 1e-5."""

# The powers of x and y of each term, which give the place of the moment x^a y^b among the sums.
X_POWER = (0, 1, 0, 2, 1, 0)
Y_POWER = (0, 0, 1, 0, 1, 2)


@term
def _shepard_row(
    total: tuple[float, ...],
    place: Vector,
    target: None,
    source: Array,
    columns: slice,
    given: None,
    inverse_length: float,
) -> tuple[float, ...]:
    places = vector_at(source, 0, columns)
    first = source[2, columns]
    second = source[3, columns]
    third = source[4, columns]
    norm = a = b = c = 0.0
    for k in range(first.size):
        weight = kernel_of(minus(place, element(places, k)), inverse_length)
        norm += weight
        a += weight * first[k]
        b += weight * second[k]
        c += weight * third[k]
    return total[0] + norm, total[1] + a, total[2] + b, total[3] + c


@parallel
def shepard(points: Array, source: Array, search: Search, out: Array) -> None:
    """Interpolate by the kernel's normalised weights (Eq. 3.15).

    Parameters
    ----------
    points : (2, n_points) [m].
    source : (5, n_sources) rows x, y [m] and three fields, sorted by cell.
    out : (3, n_points) the fields; NaN if no source is within reach.
    """
    for i in prange(points.shape[1]):
        zeros = (0.0, 0.0, 0.0, 0.0)
        place = vector_at(points, 0, i)
        sums = over_rows(_shepard_row, zeros, place, None, source, search, None)
        for f in range(3):
            out[f, i] = sums[1 + f] / sums[0]


@term
def _add_moments(
    place: Vector, source: Array, columns: slice, inverse_length: float, sums: Array
) -> None:
    """Add the moments and right-hand sides of one range of sources to `sums`."""
    places = vector_at(source, 0, columns)
    first = source[2, columns]
    second = source[3, columns]
    third = source[4, columns]
    m00 = m10 = m01 = m20 = m11 = m02 = m30 = m21 = m12 = m03 = 0.0
    m40 = m31 = m22 = m13 = m04 = 0.0
    a0 = a1 = a2 = a3 = a4 = a5 = 0.0
    b0 = b1 = b2 = b3 = b4 = b5 = 0.0
    c0 = c1 = c2 = c3 = c4 = c5 = 0.0
    for k in range(first.size):
        ox, oy = times(inverse_length, minus(element(places, k), place))
        w = kernel_of((ox, oy), 1.0)
        wx = w * ox
        wy = w * oy
        wxx = wx * ox
        wxy = wx * oy
        wyy = wy * oy
        m00 += w
        m10 += wx
        m01 += wy
        m20 += wxx
        m11 += wxy
        m02 += wyy
        m30 += wxx * ox
        m21 += wxx * oy
        m12 += wxy * oy
        m03 += wyy * oy
        m40 += wxx * ox * ox
        m31 += wxx * ox * oy
        m22 += wxx * oy * oy
        m13 += wxy * oy * oy
        m04 += wyy * oy * oy
        f = first[k]
        a0 += w * f
        a1 += wx * f
        a2 += wy * f
        a3 += wxx * f
        a4 += wxy * f
        a5 += wyy * f
        f = second[k]
        b0 += w * f
        b1 += wx * f
        b2 += wy * f
        b3 += wxx * f
        b4 += wxy * f
        b5 += wyy * f
        f = third[k]
        c0 += w * f
        c1 += wx * f
        c2 += wy * f
        c3 += wxx * f
        c4 += wxy * f
        c5 += wyy * f
    moments = (m00, m10, m01, m20, m11, m02, m30, m21, m12, m03, m40, m31, m22, m13, m04)
    for s in range(15):
        sums[s] += moments[s]
    sides = (a0, a1, a2, a3, a4, a5, b0, b1, b2, b3, b4, b5, c0, c1, c2, c3, c4, c5)
    for s in range(18):
        sums[15 + s] += sides[s]


@term
def _is_determined(sums: Array, factor: Array) -> bool:
    """Return whether every pivot of M = C C^T is larger than rounding of M's diagonal."""
    determined = True
    for i in range(N_TERMS):
        order = 2 * (X_POWER[i] + Y_POWER[i])
        diagonal = sums[order * (order + 1) // 2 + 2 * Y_POWER[i]]
        # A comparison with NaN, the root of a negative pivot, is false.
        determined = determined and factor[i, i] * factor[i, i] > LEAST_PIVOT * diagonal
    return determined


@term
def _solve_first(factor: Array, n_terms: int) -> None:
    """Solve M z = e_0 with the first terms of M = C C^T; z is the last row of `factor`."""
    z = factor[N_TERMS]
    for i in range(n_terms):
        value = 1.0 if i == 0 else 0.0
        for k in range(i):
            value -= factor[i, k] * z[k]
        z[i] = value / factor[i, i]
    for r in range(n_terms):
        i = n_terms - 1 - r
        value = z[i]
        for k in range(i + 1, n_terms):
            value -= factor[k, i] * z[k]
        z[i] = value / factor[i, i]


@term
def _constant_of(field: int, sums: Array, factor: Array, n_terms: int) -> float:
    """Return the constant term z . b of the polynomial of a field."""
    value = 0.0
    for i in range(n_terms):
        value += factor[N_TERMS, i] * sums[15 + N_TERMS * field + i]
    return value


@term
def _value_at_origin(sums: Array, factor: Array, linear: float, solution: Array) -> None:
    """Solve the 6 x 6 normal equations by Cholesky's method for the constants of the polynomials.

    With M = C C^T, the constant term of M^-1 b is z . b for M z = e_0, so only z is solved for. If
    M is singular up to rounding, the result is NaN. The first rows of C are those of the linear
    polynomial, which has the share `linear` in the first field.
    """
    for i in range(N_TERMS):
        for j in range(i + 1):
            a = X_POWER[i] + X_POWER[j]
            b = Y_POWER[i] + Y_POWER[j]
            order = a + b
            value = sums[order * (order + 1) // 2 + b]
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            factor[i, j] = math.sqrt(value) if i == j else value / factor[j, j]
    _solve_first(factor, N_TERMS)
    for f in range(3):
        solution[f] = _constant_of(f, sums, factor, N_TERMS)
    if linear > 0.0:
        _solve_first(factor, N_LINEAR)
        solution[0] += linear * (_constant_of(0, sums, factor, N_LINEAR) - solution[0])
    if not _is_determined(sums, factor):
        solution[:] = math.nan


@parallel
def moving_least_squares(
    points: Array, linear: Array, source: Array, search: Search, scratch: Array, out: Array
) -> None:
    """Interpolate by a quadratic polynomial fitted around each point (Lancaster, Salkauskas 1981).

    Parameters
    ----------
    points : (2, n_points) [m].
    linear : (n_points,) share of a linear polynomial in the first field.
    source : (5, n_sources) rows x, y [m] and three fields, sorted by cell.
    scratch : (N_CHUNKS, 90) scratch memory.
    out : (3, n_points) the fields; NaN if the sources within reach do not determine a polynomial.
    """
    n_points = points.shape[1]
    for chunk in prange(N_CHUNKS):
        sums = scratch[chunk, :N_SUMS]
        factor = scratch[chunk, 40:82].reshape((N_TERMS + 1, N_TERMS))
        solution = scratch[chunk, 84:87]
        for i in range(chunk * n_points // N_CHUNKS, (chunk + 1) * n_points // N_CHUNKS):
            x, y = vector_at(points, 0, i)
            sums[:] = 0.0
            first, last = rows_within(y, y, search)
            for row in range(first, last):
                low, high = range_in_row(x, y, row, search)
                _add_moments((x, y), source, slice(low, high), search.inverse_length, sums)
            _value_at_origin(sums, factor, linear[i], solution)
            for f in range(3):
                out[f, i] = solution[f]
