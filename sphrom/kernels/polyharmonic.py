"""Polyharmonic splines at many positions: radial functions, polynomials and their gradients.

The radial function of order k is r^k for odd and r^k ln r for even k (Eq. 3.18). Powers are built
by repeated products with r^2, in passes over the points of one cell, so that every pass vectorises
and all orders share the code. The polynomial of degree d has the monomials 1, x, y, x^2, x y, y^2,
... up to that degree; a degree of -1 means no polynomial.

Coordinates are relative to the cell's centre, in units of `scale`. Weights are stored by column, so
that the points of a cell are contiguous and each column's sum is one dot product. Positions are
sorted by cell, so that a cell's weights are loaded once for all positions inside it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.cells import Grid
from sphrom.kernels.jit import parallel, term

# Guards ln 0 and 1/0 if a position is at a point; the factor offset or r^2 is zero there.
TINY = 1e-200
N_CHUNKS = 64
"""Number of parts into which cells, and the points of all cells, are divided."""


class Systems(NamedTuple):
    """The local splines of all cells, in the layout of the sweeps."""

    points: Array
    """(2, n_points) the points of each cell, cell after cell, in scaled coordinates."""
    cell_start: Indices
    """(n_cells + 1,) the first point of each cell."""
    radial_weights: Array
    """(n_columns, n_points)"""
    polynomial_weights: Array
    """(n_columns, n_cells, n_terms)"""


@term
def radial_values(
    x: float, y: float, xs: Array, ys: Array, order: int, square: Array, value: Array
) -> None:
    """Fill `value` (n,) with Eq. 3.18 of the distances from (x, y); `square` (n,) is scratch."""
    for j in range(xs.size):
        square[j] = (x - xs[j]) * (x - xs[j]) + (y - ys[j]) * (y - ys[j])
    if order % 2 == 1:
        for j in range(xs.size):
            value[j] = math.sqrt(square[j])
    else:
        for j in range(xs.size):
            value[j] = 0.5 * math.log(max(square[j], TINY))
    for _ in range(order // 2):
        for j in range(xs.size):
            value[j] *= square[j]


@term
def radial_gradients(
    x: float, y: float, xs: Array, ys: Array, order: int, square: Array, value: Array, dx: Array,
    dy: Array,
) -> None:  # fmt: skip
    """Fill `value`, `dx` and `dy` (n,) with Eq. 3.18 and its gradient at (x, y)."""
    for j in range(xs.size):
        square[j] = (x - xs[j]) * (x - xs[j]) + (y - ys[j]) * (y - ys[j])
    # `dx` holds (d gamma / dr) / r until the end, `value` holds gamma / r^2.
    if order % 2 == 0:
        for j in range(xs.size):
            value[j] = 0.5 * math.log(max(square[j], TINY))
            dx[j] = order * value[j] + 1.0
    elif order == 1:
        for j in range(xs.size):
            value[j] = 1.0 / math.sqrt(max(square[j], TINY))
            dx[j] = value[j]
    else:
        for j in range(xs.size):
            value[j] = math.sqrt(square[j])
            dx[j] = order * value[j]
    for _ in range((order - 2) // 2):
        for j in range(xs.size):
            value[j] *= square[j]
            dx[j] *= square[j]
    for j in range(xs.size):
        value[j] *= square[j]
        dy[j] = dx[j] * (y - ys[j])
        dx[j] *= x - xs[j]


@term
def monomials(x: float, y: float, degree: int, value: Array) -> None:
    """Fill `value` (n_terms,) with the monomials at (x, y)."""
    index = 0
    for total in range(degree + 1):
        for power in range(total + 1):
            value[index] = x ** (total - power) * y**power
            index += 1


@term
def monomial_gradients(x: float, y: float, degree: int, dx: Array, dy: Array) -> None:
    """Fill `dx` and `dy` (n_terms,) with the gradients of the monomials at (x, y)."""
    index = 0
    for total in range(degree + 1):
        for power in range(total + 1):
            rest = total - power
            dx[index] = rest * x ** max(rest - 1, 0) * y**power
            dy[index] = power * x**rest * y ** max(power - 1, 0)
            index += 1


@term
def assemble(points: Array, order: int, degree: int, square: Array, matrix: Array) -> None:
    """Fill the matrix (n + n_terms, n + n_terms) of Eq. 3.19 for points (2, n)."""
    n = points.shape[1]
    matrix[n:, n:] = 0.0
    for i in range(n):
        x = points[0, i]
        y = points[1, i]
        radial_values(x, y, points[0], points[1], order, square, matrix[i, :n])
        monomials(x, y, degree, matrix[i, n:])
        for t in range(n, matrix.shape[0]):
            matrix[t, i] = matrix[i, t]


@term
def dot(left: Array, right: Array) -> float:
    """Return the dot product of two contiguous vectors."""
    total = 0.0
    for j in range(left.size):
        total += left[j] * right[j]
    return total


@term
def add(factor: float, values: Array, total: Array) -> None:
    """Add `factor` times values to a total."""
    for j in range(total.size):
        total[j] += factor * values[j]


@term
def three_dots(weights: Array, value: Array, dx: Array, dy: Array) -> tuple[float, float, float]:
    """Return the dot products of one vector with three others."""
    total = total_x = total_y = 0.0
    for j in range(weights.size):
        total += weights[j] * value[j]
        total_x += weights[j] * dx[j]
        total_y += weights[j] * dy[j]
    return total, total_x, total_y


@term
def local_coordinates(
    x: float, y: float, cell: int, grid: Grid, scale: float
) -> tuple[float, float]:
    """Return coordinates centred on a cell, in its scale."""
    row = cell // grid.n_columns
    column = cell - row * grid.n_columns
    return (
        (x - grid.x_origin - (column + 0.5) * grid.cell_width) / scale,
        (y - grid.y_origin - (row + 0.5) * grid.cell_height) / scale,
    )


@parallel
def combine(weights: Array, factors: Array, combined: Array) -> None:
    """Fill `combined` (n_combinations, n) with linear combinations of weights (n_columns, n).

    `factors` are (n_columns, n_combinations).
    """
    n = weights.shape[1]
    for chunk in prange(N_CHUNKS):
        here = slice(chunk * n // N_CHUNKS, (chunk + 1) * n // N_CHUNKS)
        for c in range(combined.shape[0]):
            combined[c, here] = 0.0
            for k in range(weights.shape[0]):
                if factors[k, c] != 0.0:
                    add(factors[k, c], weights[k, here], combined[c, here])


@parallel
def evaluate(
    x: Array,
    y: Array,
    particle: Indices,
    particle_start: Indices,
    grid: Grid,
    scale: float,
    order: int,
    degree: int,
    systems: Systems,
    scratch: Array,
    values: Array,
) -> None:
    """Evaluate every column at every position (Eq. 3.20); NaN in a cell without points.

    Parameters
    ----------
    x, y : (n_particles,) positions inside the grid [m].
    particle, particle_start : (n_particles,), (n_cells + 1,) positions sorted by cell.
    scratch : (n_chunks, 2, most points of a cell + n_terms) one row of work space per chunk.
    values : (n_particles, n_columns) the result.
    """
    n_chunks = scratch.shape[0]
    n_cells = particle_start.size - 1
    n_terms = systems.polynomial_weights.shape[2]
    for chunk in prange(n_chunks):
        for cell in range(chunk * n_cells // n_chunks, (chunk + 1) * n_cells // n_chunks):
            low = systems.cell_start[cell]
            high = systems.cell_start[cell + 1]
            square = scratch[chunk, 0, : high - low]
            value = scratch[chunk, 1, : high - low]
            polynomial = scratch[chunk, 1, high - low : high - low + n_terms]
            for k in range(particle_start[cell], particle_start[cell + 1]):
                i = particle[k]
                if low == high:
                    values[i] = math.nan
                    continue
                xi, yi = local_coordinates(x[i], y[i], cell, grid, scale)
                radial_values(
                    xi, yi, systems.points[0, low:high], systems.points[1, low:high], order,
                    square, value,
                )  # fmt: skip
                monomials(xi, yi, degree, polynomial)
                for c in range(values.shape[1]):
                    total = dot(systems.radial_weights[c, low:high], value)
                    total += dot(systems.polynomial_weights[c, cell], polynomial)
                    values[i, c] = total


@parallel
def evaluate_with_gradients(
    x: Array,
    y: Array,
    particle: Indices,
    particle_start: Indices,
    grid: Grid,
    scale: float,
    order: int,
    degree: int,
    systems: Systems,
    scratch: Array,
    values: Array,
    gradients: Array,
) -> None:
    """Evaluate every column and its gradient at every position; NaN in a cell without points.

    Parameters
    ----------
    x, y, particle, particle_start : as for `evaluate`.
    scratch : (n_chunks, 4, most points of a cell + n_terms) work space.
    values, gradients : (n_particles, n_columns), (n_particles, n_columns, 2) the results.
    """
    n_chunks = scratch.shape[0]
    n_cells = particle_start.size - 1
    n_terms = systems.polynomial_weights.shape[2]
    for chunk in prange(n_chunks):
        for cell in range(chunk * n_cells // n_chunks, (chunk + 1) * n_cells // n_chunks):
            low = systems.cell_start[cell]
            high = systems.cell_start[cell + 1]
            n = high - low
            end = n + n_terms
            work = scratch[chunk]
            for k in range(particle_start[cell], particle_start[cell + 1]):
                i = particle[k]
                if low == high:
                    values[i] = math.nan
                    gradients[i] = math.nan
                    continue
                xi, yi = local_coordinates(x[i], y[i], cell, grid, scale)
                radial_gradients(
                    xi, yi, systems.points[0, low:high], systems.points[1, low:high], order,
                    work[0, :n], work[1, :n], work[2, :n], work[3, :n],
                )  # fmt: skip
                monomials(xi, yi, degree, work[1, n:end])
                monomial_gradients(xi, yi, degree, work[2, n:end], work[3, n:end])
                for c in range(values.shape[1]):
                    a = three_dots(
                        systems.radial_weights[c, low:high], work[1, :n], work[2, :n], work[3, :n]
                    )
                    b = three_dots(
                        systems.polynomial_weights[c, cell],
                        work[1, n:end],
                        work[2, n:end],
                        work[3, n:end],
                    )
                    values[i, c] = a[0] + b[0]
                    gradients[i, c, 0] = (a[1] + b[1]) / scale
                    gradients[i, c, 1] = (a[2] + b[2]) / scale
