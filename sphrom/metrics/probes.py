"""Where fields are compared: a vertical line, and a regular grid over a box.

Points stand in the middle of equal intervals, so that none falls on a wall, or twice onto the
two sides of a periodic box.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def midpoints(lower: float, upper: float, n_points: int) -> Array:
    """Return the middles (n_points,) [m] of equal intervals between two bounds.

    Raises ValueError when there is no point or no interval.
    """
    if n_points < 1 or not upper > lower:
        raise ValueError(f"no {n_points} points fit between {lower} and {upper}")
    return lower + (np.arange(n_points) + 0.5) * (upper - lower) / n_points


def vertical_line(x: float, lower: float, upper: float, n_points: int) -> Array:
    """Return points (n_points, 2) [m] on a vertical line, from below."""
    y = midpoints(lower, upper, n_points)
    return np.stack((np.full(n_points, float(x)), y), axis=1)


def vertical_centreline(
    lower: tuple[float, float], upper: tuple[float, float], n_points: int
) -> Array:
    """Return points (n_points, 2) [m] on the vertical centreline of a box, from below."""
    return vertical_line(0.5 * (lower[0] + upper[0]), lower[1], upper[1], n_points)


def grid_points(
    lower: tuple[float, float], upper: tuple[float, float], shape: tuple[int, int]
) -> Array:
    """Return the points (ny nx, 2) [m] of a grid over a box, row by row from below.

    A field there takes its picture's form by `reshape(shape)`, with shape (ny, nx).
    """
    y = midpoints(lower[1], upper[1], shape[0])
    x = midpoints(lower[0], upper[0], shape[1])
    columns, rows = np.meshgrid(x, y)
    return np.stack((columns.ravel(), rows.ravel()), axis=1)
