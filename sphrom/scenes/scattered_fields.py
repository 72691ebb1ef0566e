"""Fields that are known at scattered points: linear between them, the nearest point's beyond."""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay, QhullError, cKDTree

Array = NDArray[np.float64]


MOST_ON_CIRCLE = 2000
"""Points that may lie on one circle: the time that Qhull takes grows with their number squared."""
JOGGLED = "QJ Qbb Qc Q12"
"""Qhull's options by which it moves points by rounding, so that no four are on a circle."""


class ScatteredFields:
    """Velocity and pressure at scattered points.

    Parameters
    ----------
    position : (n_points, 2) [m], three or more, no two alike.
    values : (n_points, 3) velocity [m/s] and pressure [Pa].

    Raises
    ------
    ValueError
        When all points lie on a line.
    """

    def __init__(self, position: Array, values: Array) -> None:
        self._position = position
        self._values = values
        self._triangles = _triangles(position)

    @cached_property
    def _between(self) -> LinearNDInterpolator:
        return LinearNDInterpolator(self._triangles, self._values)

    def _at(self, position: Array) -> Array:
        found = np.asarray(self._between(position))
        beyond = ~np.isfinite(found).all(axis=1)
        if beyond.any():
            _, nearest = cKDTree(self._position).query(position[beyond])
            found[beyond] = self._values[nearest]
        return found

    def velocity(self, position: Array) -> Array:
        """Return the velocity (n_particles, 2) [m/s] at positions (n_particles, 2) [m]."""
        return self._at(position)[:, :2]

    def pressure(self, position: Array) -> Array:
        """Return the pressure (n_particles,) [Pa] at positions (n_particles, 2) [m]."""
        return self._at(position)[:, 2]


def _triangles(position: Array) -> Delaunay:
    """Return the triangles between points (n_points, 2). Raises ValueError for those on a line."""
    try:
        Delaunay(position[:: max(1, len(position) // MOST_ON_CIRCLE)])
        if len(position) > MOST_ON_CIRCLE:
            with suppress(QhullError):  # points may be nearer to each other than they are moved
                return Delaunay(position, qhull_options=JOGGLED)
        return Delaunay(position)
    except QhullError as error:
        raise ValueError("all its points lie on a line") from error
