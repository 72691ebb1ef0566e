"""Interpolation from particles to fixed points in three dimensions, by moving least squares.

As in `interpolation` in two: a full quadratic polynomial, weighted by the kernel, is fitted around
each point, and its value there is the result. The first field may have a share of a linear
polynomial.
"""

from __future__ import annotations

import math

from numba import prange

from sphrom.arrays import Array
from sphrom.kernels.interpolation import LEAST_PIVOT
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.pairs import kernel_of
from sphrom.kernels.space_lists import SpaceSearch, cells_within, gap_to, sources_in_row

N_TERMS, N_LINEAR = 10, 4
"""Terms of a quadratic polynomial: 1, x, y, z, x^2, y^2, z^2, x y, x z, y z; the linear ones."""
N_FIELDS = 4
N_CHUNKS = 64
"""Number of parts into which points are divided; each has its own scratch memory."""
WIDTH = 64
"""Number of sources whose products are summed at once, so that sums run over sources."""
N_COLUMNS = N_TERMS + N_FIELDS
N_ROWS = 3 * N_TERMS + N_COLUMNS + 1
"""Rows of scratch memory: sums; the factor C and its solution; terms and fields of sources, and
their terms times the weight."""


@term
def _keep_source(
    k: int, kept: int, place: tuple[float, float, float], source: Array, inverse: float, rows: Array
) -> int:
    """Store the terms and fields of a source after `kept` others, if it is within the support."""
    x = (source[0, k] - place[0]) * inverse
    y = (source[1, k] - place[1]) * inverse
    z = (source[2, k] - place[2]) * inverse
    if x * x + y * y + z * z >= 4.0:
        return kept
    weight = kernel_of((x, y, z), 1.0)
    terms = (1.0, x, y, z, x * x, y * y, z * z, x * y, x * z, y * z)
    for i in range(N_TERMS):
        rows[i, kept] = terms[i]
        rows[N_COLUMNS + i, kept] = weight * terms[i]
    for f in range(N_FIELDS):
        rows[N_TERMS + f, kept] = source[3 + f, k]
    return kept + 1


@term
def _add_products(kept: int, rows: Array, sums: Array) -> None:
    """Add the products of the terms of sources, and of terms with fields, to `sums`."""
    for i in range(N_TERMS):
        weighted = rows[N_COLUMNS + i]
        for j in range(N_COLUMNS):
            if j <= i or j >= N_TERMS:
                values = rows[j]
                total = 0.0
                for k in range(kept):
                    total += weighted[k] * values[k]
                sums[i, j] += total


@term
def _factorise(sums: Array, factor: Array) -> bool:
    """Set M = C C^T; return whether every pivot is larger than rounding of M's diagonal."""
    determined = True
    for i in range(N_TERMS):
        for j in range(i + 1):
            value = sums[i, j]
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            factor[i, j] = math.sqrt(value) if i == j else value / factor[j, j]
        # A comparison with NaN, the root of a negative pivot, is false.
        determined = determined and factor[i, i] * factor[i, i] > LEAST_PIVOT * sums[i, i]
    return determined


@term
def _solve_first(factor: Array, solution: Array, n_terms: int) -> None:
    """Solve M z = e_0 with the first terms of M = C C^T."""
    for i in range(n_terms):
        value = 1.0 if i == 0 else 0.0
        for k in range(i):
            value -= factor[i, k] * solution[k]
        solution[i] = value / factor[i, i]
    for r in range(n_terms):
        i = n_terms - 1 - r
        value = solution[i]
        for k in range(i + 1, n_terms):
            value -= factor[k, i] * solution[k]
        solution[i] = value / factor[i, i]


@term
def _constant_of(field: int, sums: Array, solution: Array, n_terms: int) -> float:
    """Return the constant term z . b of the polynomial of a field."""
    total = 0.0
    for i in range(n_terms):
        total += solution[i] * sums[i, N_TERMS + field]
    return total


@parallel
def moving_least_squares(
    points: Array,
    linear: Array,
    source: Array,
    search: SpaceSearch,
    scratch: Array,
    out: Array,
) -> None:
    """Interpolate by a quadratic polynomial fitted around each point (Lancaster, Salkauskas 1981).

    Parameters
    ----------
    points : (3, n_points) [m].
    linear : (n_points,) share of a linear polynomial in the first field.
    source : (7, n_sources) rows x, y, z [m] and four fields, sorted by cell.
    search : with the kernel's support radius as the reach.
    scratch : (N_CHUNKS, N_ROWS, WIDTH) zeros.
    out : (4, n_points) the fields; NaN if the sources within reach do not determine a polynomial.
    """
    n_points = points.shape[1]
    for chunk in prange(N_CHUNKS):
        sums = scratch[chunk, :N_TERMS]
        factor = scratch[chunk, N_TERMS : 2 * N_TERMS]
        solution = scratch[chunk, 2 * N_TERMS]
        rows = scratch[chunk, 2 * N_TERMS + 1 :]
        for i in range(chunk * n_points // N_CHUNKS, (chunk + 1) * n_points // N_CHUNKS):
            place = (points[0, i], points[1, i], points[2, i])
            sums[:] = 0.0
            kept = 0
            south, north = cells_within(place[1], place[1], 1, search)
            back, front = cells_within(place[2], place[2], 2, search)
            for layer in range(back, front):
                behind = gap_to(place[2], place[2], layer, 2, search)
                for row in range(south, north):
                    below = gap_to(place[1], place[1], row, 1, search)
                    square = below * below + behind * behind
                    first, last = sources_in_row(place[0], place[0], square, row, layer, search)
                    for k in range(first, last):
                        kept = _keep_source(k, kept, place, source, search.inverse_length, rows)
                        if kept == WIDTH:
                            _add_products(kept, rows, sums)
                            kept = 0
            _add_products(kept, rows, sums)
            determined = _factorise(sums, factor)
            _solve_first(factor, solution, N_TERMS)
            for f in range(N_FIELDS):
                value = _constant_of(f, sums, solution, N_TERMS)
                out[f, i] = value if determined else math.nan
            if linear[i] > 0.0:
                _solve_first(factor, solution, N_LINEAR)
                value = _constant_of(0, sums, solution, N_LINEAR)
                out[0, i] += linear[i] * (value - out[0, i])
