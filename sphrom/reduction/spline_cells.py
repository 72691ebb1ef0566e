"""The cells of local splines: which points each cell sees, and in which coordinates (Alg. 3.2).

A cell sees the points of the 3x3 cells around it. Along a periodic axis these are found by
counting on past the edge, each turn adding the domain's length, so that one or two cells along an
axis are as good as many.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sphrom.kernels.cells import Grid, sort_by_cell
from sphrom.sph.domain import Domain

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def fitting_cells(domain: Domain, cell_width: float) -> tuple[int, int]:
    """Return how many cells of at least a width [m] fit along x and y, at least one."""
    # A width that divides the length but for rounding is meant to divide it.
    columns, rows = (
        max(1, math.floor(length / cell_width * (1.0 + 1e-9))) for length in domain.lengths
    )
    return columns, rows


def cell_grid(domain: Domain, cell_shape: tuple[int, int]) -> Grid:
    """Return the grid that divides a domain into cells."""
    return Grid(
        x_origin=domain.lower[0],
        y_origin=domain.lower[1],
        cell_width=domain.lengths[0] / cell_shape[0],
        cell_height=domain.lengths[1] / cell_shape[1],
        n_columns=cell_shape[0],
        n_rows=cell_shape[1],
    )


def length_scale(grid: Grid) -> float:
    """Return the length [m] that both coordinates in a cell are measured in."""
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
    """Find the points that every cell sees.

    Parameters
    ----------
    position : (n_points, 2) inside the domain [m].
    least : how many points a cell must see.

    Returns
    -------
    near : (n_seen,) the points of the first cell, then of the second, ...
    local : (2, n_seen) their coordinates from the cell's centre, over the grid's length scale.
    cell_start : (n_cells + 1,) where each cell begins among them.

    Raises
    ------
    ValueError
        If a cell sees fewer points than `least`.
    """
    columns = np.ascontiguousarray(position.T)
    order, start = sort_by_cell(columns[0], columns[1], grid)
    near, local = [], []
    for cell in range(start.size - 1):
        members, translation = _neighbours(cell, grid, domain, order, start)
        centre = cell_centre(grid, cell)
        if members.size < least:
            raise ValueError(
                f"around the cell at ({centre[0]:.6g}, {centre[1]:.6g}) m there are {members.size}"
                f" points, and the spline needs {least}: use wider cells or a lower degree"
            )
        near.append(members)
        local.append((position[members] + translation - centre).T / length_scale(grid))
    cell_start = np.zeros(len(near) + 1, np.int64)
    np.cumsum([members.size for members in near], out=cell_start[1:])
    return np.concatenate(near), np.concatenate(local, axis=1), cell_start


def _neighbours(
    cell: int, grid: Grid, domain: Domain, order: Indices, start: Indices
) -> tuple[Indices, Array]:
    """Return the points of the 3x3 cells around a cell, and the translation of each [m]."""
    row, column = divmod(cell, grid.n_columns)
    members, counts, images = [], [], []
    for j in range(row - 1, row + 2):
        for i in range(column - 1, column + 2):
            image_x, source_column = divmod(i, grid.n_columns)
            image_y, source_row = divmod(j, grid.n_rows)
            if (image_x and not domain.periodic[0]) or (image_y and not domain.periodic[1]):
                continue
            source = source_row * grid.n_columns + source_column
            members.append(order[start[source] : start[source + 1]])
            counts.append(members[-1].size)
            images.append((image_x, image_y))
    translation = np.array(images) * np.array(domain.lengths)
    return np.concatenate(members), np.repeat(translation, counts, axis=0)


def wrapped(coordinate: Array, domain: Domain, axis: int) -> Array:
    """Return coordinates (n,) along one axis [m], moved into the domain if the axis is periodic."""
    coordinate = np.ascontiguousarray(coordinate, dtype=np.float64)
    if not domain.periodic[axis]:
        return coordinate
    length = domain.lengths[axis]
    return coordinate - length * np.floor((coordinate - domain.lower[axis]) / length)
