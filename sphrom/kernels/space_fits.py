"""Interpolation from particles to fixed points in three dimensions, by moving least squares.

As in `interpolation` in two: a full quadratic polynomial, weighted by the kernel, is fitted around
each point, and its value there is the result. The first field may have a share of a linear
polynomial.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.interpolation import LEAST_PIVOT
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.pairs import kernel_of

N_TERMS, N_LINEAR = 10, 4
"""Terms of a quadratic polynomial: 1, x, y, z, x^2, y^2, z^2, x y, x z, y z; the linear ones."""
N_FIELDS = 4
N_CHUNKS = 64
"""Number of parts into which points are divided; each has its own scratch memory."""
WIDTH = 16
"""Length of a row of sums: products of a term with all terms and fields, padded."""
N_ROWS = 2 * N_TERMS + 2
"""Rows of scratch memory: sums, the factor C, its solution, and the terms of one source."""


class SpaceCells(NamedTuple):
    """Sources sorted by cell, in layers of rows of cells."""

    origin: Array
    """(3,) [m]."""
    shape: Indices
    """(3,) numbers of cells."""
    size: float
    """Edge of a cell [m]."""
    start: Indices
    """(n_cells + 1,) the first source of each cell."""


def sort_by_cell(place: Array, size: float) -> tuple[Indices, SpaceCells]:
    """Return the order of sources at (3, n_sources) [m] by cell, and the cells of a size [m]."""
    origin = place.min(axis=1)
    cell = ((place - origin[:, None]) / size).astype(np.int64)
    shape = cell.max(axis=1) + 1
    number = (cell[2] * shape[1] + cell[1]) * shape[0] + cell[0]
    start = np.concatenate(([0], np.cumsum(np.bincount(number, minlength=int(shape.prod())))))
    cells = SpaceCells(origin, shape, size, start)
    return np.argsort(number, kind="stable"), cells


@term
def _span(place: float, reach: float, origin: float, size: float, n_cells: int) -> tuple[int, int]:
    """Return the first cell along an axis within reach of a place, and one past the last."""
    first = math.floor((place - reach - origin) / size)
    last = math.floor((place + reach - origin) / size)
    return min(max(first, 0), n_cells), max(min(last + 1, n_cells), 0)


@term
def _add_sources(
    place: tuple[float, float, float],
    first: int,
    last: int,
    source: Array,
    inverse_length: float,
    sums: Array,
    terms: Array,
) -> None:
    """Add the products of terms, and of terms with fields, of a range of sources to `sums`."""
    for k in range(first, last):
        x = (source[0, k] - place[0]) * inverse_length
        y = (source[1, k] - place[1]) * inverse_length
        z = (source[2, k] - place[2]) * inverse_length
        if x * x + y * y + z * z >= 4.0:
            continue
        weight = kernel_of((x, y, z), 1.0)
        terms[0] = 1.0
        terms[1] = x
        terms[2] = y
        terms[3] = z
        terms[4] = x * x
        terms[5] = y * y
        terms[6] = z * z
        terms[7] = x * y
        terms[8] = x * z
        terms[9] = y * z
        for f in range(N_FIELDS):
            terms[N_TERMS + f] = source[3 + f, k]
        for i in range(N_TERMS):
            scale = weight * terms[i]
            for j in range(WIDTH):
                sums[i, j] += scale * terms[j]


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
def _value(sums: Array, factor: Array, solution: Array, n_terms: int, field: int) -> float:
    """Return the constant term z . b of the polynomial of a field, with M z = e_0."""
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
    total = 0.0
    for i in range(n_terms):
        total += solution[i] * sums[i, N_TERMS + field]
    return total


@parallel
def moving_least_squares(
    points: Array,
    linear: Array,
    source: Array,
    cells: SpaceCells,
    reach: float,
    scratch: Array,
    out: Array,
) -> None:
    """Interpolate by a quadratic polynomial fitted around each point (Lancaster, Salkauskas 1981).

    Parameters
    ----------
    points : (3, n_points) [m].
    linear : (n_points,) share of a linear polynomial in the first field.
    source : (7, n_sources) rows x, y, z [m] and four fields, sorted by cell.
    reach : the kernel's support radius, two smoothing lengths [m].
    scratch : (N_CHUNKS, N_ROWS, WIDTH) zeros.
    out : (4, n_points) the fields; NaN if the sources within reach do not determine a polynomial.
    """
    n_points = points.shape[1]
    for chunk in prange(N_CHUNKS):
        sums = scratch[chunk, :N_TERMS]
        factor = scratch[chunk, N_TERMS : 2 * N_TERMS]
        solution = scratch[chunk, 2 * N_TERMS]
        terms = scratch[chunk, 2 * N_TERMS + 1]
        for i in range(chunk * n_points // N_CHUNKS, (chunk + 1) * n_points // N_CHUNKS):
            place = (points[0, i], points[1, i], points[2, i])
            sums[:] = 0.0
            west, east = _span(place[0], reach, cells.origin[0], cells.size, cells.shape[0])
            south, north = _span(place[1], reach, cells.origin[1], cells.size, cells.shape[1])
            back, front = _span(place[2], reach, cells.origin[2], cells.size, cells.shape[2])
            for layer in range(back, front):
                for row in range(south, north):
                    base = (layer * cells.shape[1] + row) * cells.shape[0]
                    first = cells.start[base + west]
                    last = cells.start[base + max(west, east)]
                    _add_sources(place, first, last, source, 2.0 / reach, sums, terms)
            determined = _factorise(sums, factor)
            for f in range(N_FIELDS):
                value = _value(sums, factor, solution, N_TERMS, f)
                out[f, i] = value if determined else math.nan
            if linear[i] > 0.0:
                value = _value(sums, factor, solution, N_LINEAR, 0)
                out[0, i] += linear[i] * (value - out[0, i])
