"""The share of space filled with particles: the height of a free surface, and dry places.

The share at a place is the sum of the particles' volumes times their kernel. Mirror images complete
it beside the sides of the box; beside solids it is divided by the share that they leave. The
surface is where it is one half.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from sphrom.arrays import Array
from sphrom.errors import SphromError

Filled = Callable[[Array, Array], Array]
"""Returns the filled share of space at fixed points (n_points,), given positions (n_particles, 2)
[m] and density fluctuations (n_particles,) [kg/m3] of particles."""
HALF = 0.5
"""The share at the surface."""
LEAST_LEFT = 0.05
"""Smallest assumed share of the kernel outside solids."""


class Filling:
    """The share of space that particles fill at fixed points.

    Parameters
    ----------
    points : (n_points, 2) [m].
    radius : of the kernel's support [m].
    lower, upper, periodic : corners of the box [m], and whether each axis is periodic.
    solid, solid_volume : (n_solid, 2) [m] points in solids, and the volume of each [m2].
    """

    def __init__(
        self,
        points: Array,
        radius: float,
        lower: tuple[float, ...],
        upper: tuple[float, ...],
        periodic: tuple[bool, ...] = (False, False),
        solid: Array | None = None,
        solid_volume: float = 0.0,
    ) -> None:
        from scipy.spatial import cKDTree  # importing it takes long

        self._tree = cKDTree(points)
        self._radius = radius
        self._box = lower, upper, periodic
        self._left: Array | float = 1.0
        if solid is not None and len(solid):
            taken = self._sums(solid, np.full(len(solid), solid_volume))
            self._left = np.maximum(1.0 - taken, LEAST_LEFT)

    def __call__(self, position: Array, volume: Array) -> Array:
        """Return the shares (n_points,), given positions (n_particles, 2) [m] and volumes [m2]."""
        return self._sums(position, volume) / self._left

    def _sums(self, position: Array, volume: Array) -> Array:
        from scipy.spatial import cKDTree

        for axis, (lower, upper, periodic) in enumerate(zip(*self._box, strict=True)):
            x = position[:, axis]
            low, high = x < lower + self._radius, x > upper - self._radius
            beside = position[low], position[high]
            for own, wall, way in zip(beside, (lower, upper), (1.0, -1.0), strict=True):
                x = own[:, axis]
                own[:, axis] = x + way * (upper - lower) if periodic else 2.0 * wall - x
            position = np.concatenate((position, *beside))
            volume = np.concatenate((volume, volume[low], volume[high]))
        near = self._tree.sparse_distance_matrix(
            cKDTree(position), self._radius, output_type="ndarray"
        )
        offset = near["v"] / self._radius
        kernel = 7.0 / (math.pi * self._radius**2) * (1.0 - offset) ** 4 * (1.0 + 4.0 * offset)
        sums = np.bincount(near["i"], kernel * volume[near["j"]], minlength=self._tree.n)
        return np.asarray(sums, dtype=float)


def columns_of(x: Array, heights: Array) -> Array:
    """Return points (n_columns n_heights, 2) [m] at all heights, column by column."""
    return np.stack((np.repeat(x, len(heights)), np.tile(heights, len(x))), axis=1)


def lowest_surface(share: Array, heights: Array) -> Array:
    """Return the lowest height (n_columns,) [m] where shares (n_columns, n_heights) are one half.

    It is the surface of the fluid on the floor; drops above it do not count. It is the height of
    the floor in a column that is dry there, and the largest height in a full column.
    """
    wet = np.pad(share > HALF, ((0, 0), (0, 1)))
    dry = wet.argmin(axis=1)
    columns = np.arange(len(share))
    above = np.minimum(dry, len(heights) - 1)
    below = np.maximum(dry - 1, 0)
    excess, fall = share[columns, below] - HALF, share[columns, below] - share[columns, above]
    part = np.divide(excess, fall, out=np.zeros_like(fall), where=above > below)
    return np.asarray(heights[below] + part * (heights[above] - heights[below]))


def find_elevation(
    position: Array, volume: Array, columns: Array, radius: float, walls: tuple[float, float, float]
) -> Array:
    """Return the heights (n_columns,) [m] at which the sums of the particles' kernels are one half.

    Parameters
    ----------
    position, volume : (n_particles, 2) [m], (n_particles,) [m2].
    columns : (n_columns,) [m], along x.
    radius : of the kernel's support [m].
    walls : left, right and bottom [m]; images of the particles complete the sums there.

    Raises SphromError if a column has no fluid or more than one surface.
    """
    left, right, bottom = walls
    heights = np.arange(bottom, position[:, 1].max() + radius, radius / 16)
    filling = Filling(columns_of(columns, heights), radius, (left, bottom), (right, math.inf))
    share = filling(position, volume).reshape(len(columns), -1)
    wet = share > HALF
    crossings = np.count_nonzero(wet[:, 1:] != wet[:, :-1], axis=1)
    for number in np.flatnonzero((crossings != 1) | ~wet[:, 0])[:1]:
        state = "more than one surface" if wet[number].any() else "no fluid"
        raise SphromError(f"The column x = {columns[number]:.4g} m has {state}.")
    return lowest_surface(share, heights)
