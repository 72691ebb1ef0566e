"""The cells of local splines: which points each cell sees, and in which coordinates (Alg. 3.2).

A cell sees the points of the 3x3 cells around it. Along a periodic axis these are found by
counting on past the edge, each turn adding the domain's length, so that one or two cells along an
axis are as good as many.

Where walls run through the box, a cell may hold no points: it lies in the solid, or has a sliver of
fluid narrower than the points' spacing. Such a cell sees what the cell next to it sees, so that a
particle in the sliver, or a little beyond the wall, is served as its neighbours are. Farther inside
the solid a cell sees nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sphrom.kernels.cells import Grid, sort_by_cell
from sphrom.sph.domain import Domain

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FACES = ((0, -1), (0, 1), (-1, 0), (1, 0))
CORNERS = ((-1, -1), (-1, 1), (1, -1), (1, 1))
"""Steps in row and column to the cells that share a face, or only a corner, with a cell."""
WHOLE = 1.0 - 1e-9
"""A cell with a larger share of fluid has no solid in it."""


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
    position : (n_points, 2) in the fluid [m].
    least : how many points a cell must see, unless it lies in the solid.

    Returns
    -------
    near : (n_seen,) the points of the first cell, then of the second, ...
    local : (2, n_seen) their coordinates from the cell's centre, over the grid's length scale.
    cell_start : (n_cells + 1,) where each cell begins among them.

    Raises
    ------
    ValueError
        If a cell with fluid in it sees fewer points than `least`.
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
    cell_start = np.zeros(len(near) + 1, np.int64)
    np.cumsum([members.size for members in near], out=cell_start[1:])
    return np.concatenate(near), np.concatenate(local, axis=1), cell_start


def fluid_share(grid: Grid, domain: Domain) -> Array:
    """Return the share of fluid (n_cells,) in each cell of the box; zero where it is rounding."""
    x: Array = grid.x_origin + grid.cell_width * np.arange(grid.n_columns + 1.0)
    y: Array = grid.y_origin + grid.cell_height * np.arange(grid.n_rows + 1.0)
    return domain.fluid_share((x, y)).ravel()


def _nearest_with_points(
    place: tuple[int, int], grid: Grid, domain: Domain, start: Indices
) -> tuple[int, int]:
    """Return row and column of the neighbour with the most points, one across a face if any has.

    The cell itself where none has any. Beyond a periodic edge the count goes on.
    """
    row, column = place
    for steps in (FACES, CORNERS):
        found = [(row + j, column + i) for j, i in steps]
        counts = [_count(other, grid, domain, start) for other in found]
        if any(counts):
            return found[int(np.argmax(counts))]
    return place


def _count(place: tuple[int, int], grid: Grid, domain: Domain, start: Indices) -> int:
    """Return how many points the cell at a row and column holds; none beyond a closed edge."""
    source = _source(place, grid, domain)
    return 0 if source is None else int(start[source[0] + 1] - start[source[0]])


def _source(
    place: tuple[int, int], grid: Grid, domain: Domain
) -> tuple[int, tuple[int, int]] | None:
    """Return the cell that a row and column mean, and how many boxes away; None if there is none.

    Along a periodic axis rows and columns go on past the edge.
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


def wrapped(coordinate: Array, domain: Domain, axis: int) -> Array:
    """Return coordinates (n,) along one axis [m], moved into the domain if the axis is periodic."""
    coordinate = np.ascontiguousarray(coordinate, dtype=np.float64)
    if not domain.periodic[axis]:
        return coordinate
    length = domain.lengths[axis]
    return coordinate - length * np.floor((coordinate - domain.lower[axis]) / length)
