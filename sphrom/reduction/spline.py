"""Local polyharmonic splines of the trial basis, by cell (Eq. 3.17-3.20, Alg. 3.2-3.3).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack

from sphrom.kernels import polyharmonic
from sphrom.kernels.cells import Grid, sort_by_cell
from sphrom.sph.domain import Domain

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

HIGHEST_DEGREE = 3
N_CHUNKS = 64


def default_cell_width(domain: Domain, n_points: int, ratio: float = 3.0) -> float:
    return ratio * math.sqrt(domain.area / n_points)


@dataclass(frozen=True)
class LocalSplines:
    order: int
    polynomial_degree: int
    domain: Domain
    grid: Grid
    scale: float
    points: Array
    point_start: Indices
    radial_weights: Array
    polynomial_weights: Array
    condition_number: Array

    @property
    def n_columns(self) -> int:
        return self.radial_weights.shape[0]

    def values(self, positions: ArrayLike) -> Array:
        position = np.asarray(positions, dtype=np.float64)
        return self.evaluate(position[:, 0], position[:, 1])

    def gradients(self, positions: ArrayLike) -> Array:
        return self.values_and_gradients(positions)[1]

    def values_and_gradients(self, positions: ArrayLike) -> tuple[Array, Array]:
        position = np.asarray(positions, dtype=np.float64)
        return self.evaluate_with_gradients(position[:, 0], position[:, 1])

    def evaluate(self, x: Array, y: Array, out: Array | None = None) -> Array:
        out = np.empty((x.size, self.n_columns)) if out is None else out
        polyharmonic.evaluate(*self._arguments(x, y, 2), out)
        return out

    def evaluate_with_gradients(self, x, y, values=None, gradients=None):
        values = np.empty((x.size, self.n_columns)) if values is None else values
        gradients = np.empty((x.size, self.n_columns, 2)) if gradients is None else gradients
        polyharmonic.evaluate_with_gradients(*self._arguments(x, y, 4), values, gradients)
        return values, gradients

    def combine(self, coefficients):
        return replace(
            self,
            radial_weights=coefficients.T @ self.radial_weights,
            polynomial_weights=np.tensordot(coefficients.T, self.polynomial_weights, 1),
        )

    def _arguments(self, x, y, rows):
        inside_x = wrapped(x, self.domain, 0)
        inside_y = wrapped(y, self.domain, 1)
        particle, start = sort_by_cell(inside_x, inside_y, self.grid)
        most = int(np.max(np.diff(self.point_start)))
        scratch = np.empty((N_CHUNKS, rows, most + self.polynomial_weights.shape[2]))
        systems = polyharmonic.Systems(
            self.points, self.point_start, self.radial_weights, self.polynomial_weights
        )
        return (
            inside_x, inside_y, particle, start, self.grid, self.scale, self.order,
            self.polynomial_degree, systems, scratch,
        )


def wrapped(coordinate: Array, domain: Domain, axis: int) -> Array:
    if not domain.periodic[axis]:
        return coordinate
    length = domain.lengths[axis]
    return coordinate - length * np.floor((coordinate - domain.lower[axis]) / length)


def covering_cells(domain, cell_width):
    shape = [max(1, math.floor(length / cell_width + 1e-9)) for length in domain.lengths]
    return Grid(
        domain.lower[0], domain.lower[1], domain.lengths[0] / shape[0],
        domain.lengths[1] / shape[1], shape[0], shape[1],
    )


def neighbouring_points(cell, grid, domain, order, start):
    row, column = divmod(cell, grid.n_columns)
    found, shifts = [], []
    for j in (row - 1, row, row + 1):
        if not (domain.periodic[1] or 0 <= j < grid.n_rows):
            continue
        for i in (column - 1, column, column + 1):
            if not (domain.periodic[0] or 0 <= i < grid.n_columns):
                continue
            source = (j % grid.n_rows) * grid.n_columns + i % grid.n_columns
            members = order[start[source] : start[source + 1]]
            found.append(members)
            image = (i // grid.n_columns * domain.lengths[0], j // grid.n_rows * domain.lengths[1])
            shifts.append(np.tile(np.array(image), (members.size, 1)))
    return np.concatenate(found), np.concatenate(shifts)


def fit_splines(points, values, domain, *, order=3, polynomial_degree=1, cell_width, progress=None):
    grid = covering_cells(domain, cell_width)
    inside = domain.wrap(points)
    members, start = sort_by_cell(inside[:, 0].copy(), inside[:, 1].copy(), grid)
    n_cells = grid.n_columns * grid.n_rows
    scale = max(grid.cell_width, grid.cell_height)
    n_terms = (polynomial_degree + 1) * (polynomial_degree + 2) // 2
    all_points, radial, polynomial, condition, counts = [], [], [], [], [0]
    for cell in range(n_cells):
        near, shift = neighbouring_points(cell, grid, domain, members, start)
        row, column = divmod(cell, grid.n_columns)
        centre = np.array([grid.x_origin + (column + 0.5) * grid.cell_width, grid.y_origin + (row + 0.5) * grid.cell_height])
        local = np.ascontiguousarray(((inside[near] + shift - centre) / scale).T)
        n = near.size
        matrix = np.empty((n + n_terms, n + n_terms))
        polyharmonic.assemble(local, order, polynomial_degree, np.empty(n), matrix)
        norm = np.abs(matrix).sum(axis=0).max()
        lu, piv, info = lapack.dgetrf(matrix.T, overwrite_a=True)
        rcond, _ = lapack.dgecon(lu, norm)
        right = np.zeros((n + n_terms, values.shape[1]), order="F")
        right[:n] = values[near]
        sol, _ = lapack.dgetrs(lu, piv, right, overwrite_b=True)
        all_points.append(local); radial.append(sol[:n].T); polynomial.append(sol[n:].T); condition.append(1 / max(rcond,1e-300)); counts.append(n)
    return LocalSplines(order, polynomial_degree, domain, grid, scale, np.concatenate(all_points, 1), np.cumsum(counts),
        np.concatenate(radial, 1), np.ascontiguousarray(np.stack(polynomial, 1)), np.array(condition))
