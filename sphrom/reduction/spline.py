"""Local polyharmonic splines of the trial basis, by cell (Eq. 3.17-3.20, Alg. 3.2-3.3).

The domain is divided into cells. Each cell has one spline per column, through all points of the 3x3
cells around it. A position uses the spline of its own cell, so the result jumps between cells by a
few times the mean error; errors are largest there. Along a periodic axis the cell count continues
past the edge, with the domain's length added per turn, so one or two cells along an axis suffice.

At a wall, a cell has points on one side only. Particles come closer to the wall than the points, so
the spline extrapolates by up to half a spacing. With the paper's linear polynomial the error in
that last half spacing is 50 to 270 times that of the interior (measured with cubic splines on
100x100 points). A cubic polynomial reduces it 17 times, and the interior error 9 times, while it
amplifies noise at the wall by 20 % more: walls call for `polynomial_degree` 3.

If walls run through the box, a cell may contain no points: it is solid, or contains a sliver of
fluid narrower than the spacing of points. Such a cell uses the points of an adjacent cell, so that
particles in the sliver, or slightly beyond the wall, have a spline. Deeper inside the solid a cell
has no spline, and the result is NaN.

Coordinates are relative to the cell's centre and scaled by its width, so that the conditioning does
not depend on the size of the domain. This leaves Eq. 3.17 unchanged for odd orders; for even orders
k >= 4 it requires a polynomial of degree k/2 or more. Eq. 3.19 is guaranteed to have a solution
with a polynomial of degree floor(k/2) or higher. The paper's linear polynomial, the default,
sufficed for orders 1 to 5 in all tests; at order 7 it may fail (cells of 1.5 spacings did).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from sphrom.arrays import Array, Indices
from sphrom.kernels import polyharmonic
from sphrom.kernels.cells import Grid, sort_by_cell
from sphrom.reduction.mode_splines import (
    CELL_WIDTH_RATIO,
    CellSplines,
    ModeSplines,
    Vector,
    coordinates,
)
from sphrom.sph.domain import Domain

FACES = ((0, -1), (0, 1), (-1, 0), (1, 0))
CORNERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))
"""Steps in row and column to the cells that share a face, or only a corner, with a cell."""
WHOLE = 1.0 - 1e-9
"""A cell with a larger share of fluid contains no solid."""


def fitting_cells(domain: Domain, cell_width: float) -> tuple[int, int]:
    """Return the numbers of cells, of at least a width [m], that fit along x and y; one or more."""
    # Up to rounding, a width that divides the length is meant to divide it.
    columns, rows = (
        max(1, math.floor(length / cell_width * (1.0 + 1e-9))) for length in domain.lengths
    )
    return columns, rows


def cell_grid(domain: Domain, cell_shape: tuple[int, int]) -> Grid:
    """Return the grid that divides a domain into cells."""
    width, height = (length / n for length, n in zip(domain.lengths, cell_shape, strict=True))
    left, low = domain.lower
    return Grid(left, low, width, height, *cell_shape)


def length_scale(grid: Grid) -> float:
    """Return the unit of length [m] of both coordinates in a cell."""
    return max(grid.cell_width, grid.cell_height)


def cell_centre(grid: Grid, cell: int) -> Array:
    """Return a cell's centre (2,) [m]."""
    row, column = divmod(cell, grid.n_columns)
    x = grid.x_origin + (column + 0.5) * grid.cell_width
    y = grid.y_origin + (row + 0.5) * grid.cell_height
    return np.array((x, y))


def points_by_cell(
    position: Array, grid: Grid, domain: Domain, least: int
) -> tuple[Indices, Array, Indices]:
    """Find the points that every cell uses.

    Parameters
    ----------
    position : (n_points, 2) in the fluid [m].
    least : minimum number of points per cell, unless it is solid.

    Returns
    -------
    near : (n_seen,) the points of the first cell, then of the second, ...
    local : (2, n_seen) their coordinates from the cell's centre, over the grid's length scale.
    cell_start : (n_cells + 1,) the start of each cell in these arrays.

    Raises ValueError if a cell that contains fluid has fewer points than `least`.
    """
    columns = np.ascontiguousarray(position.T)
    order, start = sort_by_cell(columns[0], columns[1], grid)
    share = fluid_share(grid, domain)
    near, local = [], []
    for cell in range(start.size - 1):
        place = divmod(cell, grid.n_columns)
        if start[cell] == start[cell + 1] and share[cell] < WHOLE:
            place = _nearest_with_points(place, grid, domain, start)
        members, translation = _neighbours(place, grid, domain, order, start)
        centre = cell_centre(grid, cell)
        if members.size < least and (members.size or share[cell]):
            raise ValueError(
                f"around the cell at ({centre[0]:.6g}, {centre[1]:.6g}) m there are {members.size}"
                f" points, and the spline needs {least}: use wider cells or a lower degree"
            )
        near.append(members)
        local.append((position[members] + translation - centre).T / length_scale(grid))
    cell_start = np.cumsum([0, *(members.size for members in near)], dtype=np.int64)
    return np.concatenate(near), np.concatenate(local, axis=1), cell_start


def fluid_share(grid: Grid, domain: Domain) -> Array:
    """Return the share of fluid (n_cells,) in each cell; zero if it is only rounding."""
    x: Array = grid.x_origin + grid.cell_width * np.arange(grid.n_columns + 1.0)
    y: Array = grid.y_origin + grid.cell_height * np.arange(grid.n_rows + 1.0)
    return domain.fluid_share((x, y)).ravel()


def _nearest_with_points(
    place: tuple[int, int], grid: Grid, domain: Domain, start: Indices
) -> tuple[int, int]:
    """Return row and column of the neighbour with the most points, preferably across a face.

    If none has points, return the cell itself. Beyond a periodic edge the count continues.
    """
    for steps in (FACES, CORNERS):
        candidates = [(place[0] + j, place[1] + i) for j, i in steps]
        sources = [_source(other, grid, domain) for other in candidates]
        counts = [0 if s is None else int(start[s[0] + 1] - start[s[0]]) for s in sources]
        if any(counts):
            return candidates[int(np.argmax(counts))]
    return place


def _source(
    place: tuple[int, int], grid: Grid, domain: Domain
) -> tuple[int, tuple[int, int]] | None:
    """Return the cell at a row and column, and its offset in boxes; None if there is no such cell.

    Along a periodic axis rows and columns continue past the edge.
    """
    image_y, row = divmod(place[0], grid.n_rows)
    image_x, column = divmod(place[1], grid.n_columns)
    if (image_x and not domain.periodic[0]) or (image_y and not domain.periodic[1]):
        return None
    return row * grid.n_columns + column, (image_x, image_y)


def _neighbours(
    place: tuple[int, int], grid: Grid, domain: Domain, order: Indices, start: Indices
) -> tuple[Indices, Array]:
    """Return the points of the 3x3 cells around a row and column, and their translations [m]."""
    members, counts, images = [], [], []
    for j in range(place[0] - 1, place[0] + 2):
        for i in range(place[1] - 1, place[1] + 2):
            if (source := _source((j, i), grid, domain)) is None:
                continue
            members.append(order[start[source[0]] : start[source[0] + 1]])
            counts.append(members[-1].size)
            images.append(source[1])
    translation = np.array(images) * np.array(domain.lengths)
    return np.concatenate(members), np.repeat(translation, counts, axis=0)


WORST_CONDITION_NUMBER = 1.0 / float(np.finfo(np.float64).eps)
"""Beyond it the weights have no correct digit."""


class LocalSplines(CellSplines, ModeSplines):
    """Splines of `n_columns` functions in every cell of a domain.

    Raises ValueError if the arrays do not fit one another.
    """

    order: int
    """k of Eq. 3.18."""
    polynomial_degree: int
    """-1 for no polynomial."""
    domain: Domain

    def __post_init__(self) -> None:
        # Compiled loops do not check indices.
        n_cells = math.prod(self.cell_shape)
        start = self.cell_start
        if min(self.cell_shape) < 1 or len(start) != n_cells + 1:
            raise ValueError(f"{len(start)} boundaries do not fit {self.cell_shape} cells")
        if start[0] != 0 or start[-1] != self.points.shape[1] or np.any(np.diff(start) < 0):
            raise ValueError("the cells do not divide the points among them")
        shapes = self.radial_weights.shape, self.polynomial_weights.shape
        terms = math.comb(self.polynomial_degree + 2, 2)
        if shapes != ((self.n_columns, start[-1]), (n_cells, terms, self.n_columns)):
            raise ValueError(f"weights {shapes} do not fit the points and cells")

    @cached_property
    def _systems(self) -> polyharmonic.Systems:
        return polyharmonic.Systems(
            points=np.ascontiguousarray(self.points),
            cell_start=np.ascontiguousarray(self.cell_start),
            radial_weights=np.ascontiguousarray(self.radial_weights),
            polynomial_weights=np.ascontiguousarray(self.polynomial_weights.transpose(2, 0, 1)),
        )

    @property
    def n_columns(self) -> int:
        return len(self.radial_weights)

    @property
    def grid(self) -> Grid:
        """The cells of the domain [m]."""
        return cell_grid(self.domain, (int(self.cell_shape[0]), int(self.cell_shape[1])))

    def _fill(self, place: Vector, *out: Array) -> None:
        sweep: Callable[..., None] = polyharmonic.evaluate
        if len(out) == 2:
            sweep = polyharmonic.evaluate_with_gradients
        most = int(np.max(np.diff(self.cell_start))) + self.polynomial_weights.shape[1]
        scratch = np.empty((polyharmonic.N_CHUNKS, 2 * len(out), most))
        # Kernels take positions inside the domain, cell by cell.
        inside_x, inside_y = coordinates(self.domain.wrap(np.column_stack(place)))
        particle, start = sort_by_cell(inside_x, inside_y, self.grid)
        sweep(
            inside_x,
            inside_y,
            particle,
            start,
            self.grid,
            length_scale(self.grid),
            self.order,
            self.polynomial_degree,
            self._systems,
            scratch,
            *out,
        )

    def combine(self, coefficients: ArrayLike) -> LocalSplines:
        factors = np.ascontiguousarray(coefficients, dtype=np.float64)
        radial = np.empty((factors.shape[1], self._systems.radial_weights.shape[1]))
        polyharmonic.combine(self._systems.radial_weights, factors, radial)
        return replace(
            self, radial_weights=radial, polynomial_weights=self.polynomial_weights @ factors
        )

    def first(self, n_modes: int) -> LocalSplines:
        radial = self.radial_weights[: 3 * n_modes].copy()  # frees the others
        polynomial = self.polynomial_weights[..., : 3 * n_modes].copy()
        return replace(self, radial_weights=radial, polynomial_weights=polynomial)


def default_cell_width(domain: Domain, n_points: int) -> float:
    """Return the cell width [m] for evenly spread points: three times their spacing.

    On 50x50 points, a wave as long as the domain then has relative errors of 1e-5 in value and 2e-4
    in gradient at order 3. At order 5 they are a sixth of these, for the same cost.
    """
    return CELL_WIDTH_RATIO * math.sqrt(domain.area / n_points)


def fit_splines(
    points: ArrayLike,
    values: ArrayLike,
    domain: Domain,
    *,
    order: int = 3,
    polynomial_degree: int = 1,
    cell_width: float,
    progress: Callable[[int], None] = lambda n_cells: None,
) -> LocalSplines:
    """Fit a spline to every column of values, in every cell (Eq. 3.19, Alg. 3.3).

    Parameters
    ----------
    points : (n_points, 2) the reference points, in the fluid [m].
    values : (n_points, n_columns), the values of the functions there, such as the modes by field.
    order : k of Eq. 3.18, odd or even.
    polynomial_degree : -1 (no polynomial) to 3.
    cell_width : minimum width of a cell [m]; as many cells as fit are used.
    progress : called with 1 after each cell.

    Raises ValueError if a point is outside, or a cell's points do not determine a spline.
    """
    position = domain.wrap(np.asarray(points, dtype=np.float64))
    right = np.asarray(values, dtype=np.float64)
    inside = domain.contains(position)
    if not inside.all():
        raise ValueError(f"{np.sum(~inside)} points are not inside the domain")
    grid = cell_grid(domain, fitting_cells(domain, cell_width))
    n_terms = math.comb(polynomial_degree + 2, 2)
    n_columns = right.shape[1]
    near, local, cell_start = points_by_cell(position, grid, domain, max(1, n_terms))
    radial = np.empty((n_columns, near.size))
    polynomial = np.zeros((cell_start.size - 1, n_terms, n_columns))
    condition_number = np.zeros(cell_start.size - 1)
    for cell in range(cell_start.size - 1):
        here = slice(cell_start[cell], cell_start[cell + 1])
        if here.start < here.stop:
            n_rows = here.stop - here.start + n_terms
            matrix = np.empty((n_rows, n_rows))
            scratch = np.empty(n_rows - n_terms)
            seen = np.ascontiguousarray(local[:, here])
            polyharmonic.assemble(seen, order, polynomial_degree, scratch, matrix)
            weights, condition_number[cell] = _solve(matrix, right[near[here]])
            if not condition_number[cell] < WORST_CONDITION_NUMBER:
                x, y = cell_centre(grid, cell)
                raise ValueError(
                    f"the points around the cell at ({x:.6g}, {y:.6g}) m do not determine a spline:"
                    " they coincide or lie on one line, or the order is too high for this cell"
                )
            radial[:, here] = weights[: matrix.shape[0] - n_terms].T
            polynomial[cell] = weights[matrix.shape[0] - n_terms :]
        progress(1)
    return LocalSplines(
        order=order,
        polynomial_degree=polynomial_degree,
        domain=domain,
        cell_shape=np.array((grid.n_columns, grid.n_rows), dtype=np.int64),
        cell_start=cell_start,
        points=local,
        radial_weights=radial,
        polynomial_weights=polynomial,
        condition_number=condition_number,
    )


def _solve(matrix: Array, values: Array) -> tuple[Array, float]:
    """Solve Eq. 3.19 for all columns with one factorisation; return the condition number too."""
    right = np.zeros((matrix.shape[0], values.shape[1]), order="F")
    right[: values.shape[0]] = values
    norm = float(np.max(np.sum(np.abs(matrix), axis=0)))
    # The matrix is symmetric, so its transpose has LAPACK's memory order. Separate getrf and getrs
    # are avoided: OpenBLAS spreads even the smallest getrs over threads, which on a busy machine is
    # a hundred times slower.
    factors, _, weights, info = lapack.dgesv(matrix.T, right, overwrite_a=True, overwrite_b=True)
    reciprocal = lapack.dgecon(factors, norm)[0] if info == 0 else 0.0
    return weights, 1.0 / reciprocal if reciprocal > 0.0 else math.inf
