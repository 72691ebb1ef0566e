"""Where fields are compared: a straight line, and a regular grid over a box.

Points stand in the middle of equal intervals, so that none falls on the edges of a box, or twice
onto the two sides of a periodic one.
"""

from __future__ import annotations

from collections.abc import Sequence

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


def spread(spans: Sequence[tuple[float, float]], n_points: int) -> Array:
    """Return points (n_points,) [m], evenly spread over intervals that follow one another.

    Raises ValueError when there is no point or no interval.
    """
    starts = np.array([low for low, _ in spans])
    lengths = np.array([high - low for low, high in spans])
    ends = np.cumsum(lengths)
    along = midpoints(0.0, float(ends[-1]) if spans else 0.0, n_points)
    piece = np.minimum(np.searchsorted(ends, along), len(spans) - 1)
    return np.asarray(starts[piece] + (along - (ends - lengths)[piece]))


def vertical_line(x: float, spans: Sequence[tuple[float, float]], n_points: int) -> Array:
    """Return points (n_points, 2) [m] on the parts of a vertical line, from below."""
    y = spread(spans, n_points)
    return np.stack((np.full(n_points, float(x)), y), axis=1)


def vertical_centreline(
    lower: tuple[float, float], upper: tuple[float, float], n_points: int
) -> Array:
    """Return points (n_points, 2) [m] on the vertical centreline of a box, from below."""
    return vertical_line(0.5 * (lower[0] + upper[0]), [(lower[1], upper[1])], n_points)


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
