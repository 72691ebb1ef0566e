"""Distances from walls of any shape: chains of straight segments, with the fluid on their left.

Segments are listed by cell: a cell's list contains the segment nearest to any point in it, and
those within some reach of it. For a position beyond all cells, every segment is searched.

The nearest point of a chain is within a segment or at the corner where one begins. At a corner, the
side follows from the sum of both segments' normals; neither normal alone always gives it correctly.
"""

from __future__ import annotations

import math

from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.cells import Grid
from sphrom.kernels.fields import BesideWalls, U, V, X, Y
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.rectangles import Limits, shifting_change

# Columns of a segment: its two ends, and the start of the segment before [m].
X0, Y0, X1, Y1, X_BEFORE, Y_BEFORE = range(6)
N_PASSES = 32
"""Largest number of passes in which walls limit shifting in turn; acute angles need several."""
SETTLED = 1e-6
"""The last pass changes less than this share of the first."""


@term
def _way(x: float, y: float, segment: Array) -> tuple[float, float, float]:
    """Return the vector from a point to a segment [m], and the position of its end along it.

    The position is 0 to 1 within the segment, and less or more at its ends.
    """
    along_x = segment[X1] - segment[X0]
    along_y = segment[Y1] - segment[Y0]
    where = ((x - segment[X0]) * along_x + (y - segment[Y0]) * along_y) / (
        along_x * along_x + along_y * along_y
    )
    share = min(max(where, 0.0), 1.0)
    return segment[X0] + share * along_x - x, segment[Y0] + share * along_y - y, where


@term
def _is_left(x: float, y: float, where: float, segment: Array) -> bool:
    """Return whether a point is on the fluid's side of the nearest segment or corner."""
    along_x = segment[X1] - segment[X0]
    along_y = segment[Y1] - segment[Y0]
    if where <= 0.0:
        length = math.sqrt(along_x * along_x + along_y * along_y)
        before_x = segment[X0] - segment[X_BEFORE]
        before_y = segment[Y0] - segment[Y_BEFORE]
        length_before = math.sqrt(before_x * before_x + before_y * before_y)
        along_x = along_x / length + before_x / length_before
        along_y = along_y / length + before_y / length_before
    return along_x * (y - segment[Y0]) - along_y * (x - segment[X0]) >= 0.0


@term
def _is_passed(x: float, y: float, segment: Array) -> bool:
    """Return whether a point is past the end of the segment before this one."""
    before_x = segment[X0] - segment[X_BEFORE]
    before_y = segment[Y0] - segment[Y_BEFORE]
    return (x - segment[X0]) * before_x + (y - segment[Y0]) * before_y >= 0.0


@term
def cell_of(x: float, y: float, grid: Grid) -> int:
    """Return the cell that contains a point, or -1 beyond all cells."""
    column = math.floor((x - grid.x_origin) / grid.cell_width)
    row = math.floor((y - grid.y_origin) / grid.cell_height)
    if column < 0 or column >= grid.n_columns or row < 0 or row >= grid.n_rows:
        return -1
    return row * grid.n_columns + column


@term
def _nearest(
    x: float, y: float, segments: Array, listed: Indices, start: Indices, grid: Grid
) -> tuple[int, float, float, float]:
    """Return the nearest segment, the vector to it [m], and the vector's end along it."""
    cell = cell_of(x, y, grid)
    first = start[cell] if cell >= 0 else 0
    last = start[cell + 1] if cell >= 0 else segments.shape[0]
    least = math.inf
    nearest = -1
    nearest_x = nearest_y = nearest_where = 0.0
    for n in range(first, last):
        k = listed[n] if cell >= 0 else n
        wx, wy, where = _way(x, y, segments[k])
        square = wx * wx + wy * wy
        # At an end, the segment that begins there represents both.
        if where < 1.0 and square < least:
            least = square
            nearest = k
            nearest_x, nearest_y, nearest_where = wx, wy, where
    return nearest, nearest_x, nearest_y, nearest_where


@parallel
def signed_distances(
    position: Array,
    segments: Array,
    listed: Indices,
    start: Indices,
    grid: Grid,
    out: Array,
    nearest: Indices,
) -> None:
    """Compute the distances of points from walls, and the normals there.

    Parameters
    ----------
    position : (2, n_points) [m].
    segments, listed, start, grid : (n_segments, 6), and the lists that `list_by_cell` made of
        them (`sphrom/sph/polygon_domain.py`).
    out : (3, n_points) rows: distance, positive in the fluid [m]; normal x, y, into the fluid.
    nearest : (n_points,) the nearest segment.
    """
    for i in prange(position.shape[1]):
        x = position[0, i]
        y = position[1, i]
        k, wx, wy, where = _nearest(x, y, segments, listed, start, grid)
        nearest[i] = k
        distance = math.sqrt(wx * wx + wy * wy)
        sign = 1.0 if _is_left(x, y, where, segments[k]) else -1.0
        along_x = segments[k, X1] - segments[k, X0]
        along_y = segments[k, Y1] - segments[k, Y0]
        length = math.sqrt(along_x * along_x + along_y * along_y)
        normal_x = -along_y / length
        normal_y = along_x / length
        if where <= 0.0 and distance > 0.0:
            normal_x = -sign * wx / distance
            normal_y = -sign * wy / distance
        out[0, i] = sign * distance
        out[1, i] = normal_x
        out[2, i] = normal_y


@parallel
def wall_distances(
    targets: Indices,
    target: Array,
    segments: Array,
    listed: Indices,
    start: Indices,
    grid: Grid,
    out: Array,
) -> None:
    """Compute the distances of particles from solids, zero inside them.

    Parameters
    ----------
    targets, target : the particles among the fluid's sources, and the sources.
    out : (n_targets,) [m].
    """
    for t in prange(targets.size):
        x = target[X, targets[t]]
        y = target[Y, targets[t]]
        k, wx, wy, where = _nearest(x, y, segments, listed, start, grid)
        inside = _is_left(x, y, where, segments[k])
        out[t] = math.sqrt(wx * wx + wy * wy) if inside else 0.0


@parallel
def hold_back(
    beside: BesideWalls,
    segments: Array,
    listed: Indices,
    start: Indices,
    grid: Grid,
    limits: Limits,
    shifting: Array,
) -> None:
    """Change shifting velocities so that no particle passes a wall; see `rectangles.hold_back`.

    Every local nearest point of walls limits them, and all walls do so in several passes.
    """
    target = beside.source
    for t in prange(beside.targets.size):
        j = beside.targets[t]
        i = beside.particle[j]
        x = target[X, j]
        y = target[Y, j]
        cell = cell_of(x, y, grid)
        first = start[cell] if cell >= 0 else 0
        last = start[cell + 1] if cell >= 0 else segments.shape[0]
        wanted_x = shifting[0, i]
        wanted_y = shifting[1, i]
        largest = 0.0
        for _ in range(N_PASSES):
            changed = 0.0
            for n in range(first, last):
                k = listed[n] if cell >= 0 else n
                wx, wy, where = _way(x, y, segments[k])
                distance = math.sqrt(wx * wx + wy * wy)
                within = where < 1.0 and distance < limits.felt and distance > 0.0
                comes_nearest = within and (where > 0.0 or _is_passed(x, y, segments[k]))
                if comes_nearest and _is_left(x, y, where, segments[k]):
                    wx /= distance
                    wy /= distance
                    change = shifting_change(
                        shifting[0, i] * wx + shifting[1, i] * wy,
                        wanted_x * wx + wanted_y * wy,
                        limits.against * (target[U, j] * wx + target[V, j] * wy),
                        distance,
                        limits,
                    )
                    shifting[0, i] += change * wx
                    shifting[1, i] += change * wy
                    changed = max(changed, abs(change))
            largest = max(largest, changed)
            if changed <= SETTLED * largest:
                break
