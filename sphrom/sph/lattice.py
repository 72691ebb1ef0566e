"""Lattices of points in a box: their order, and their images beyond the ends of its axes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.kernels.lattice_sums import Images
from sphrom.sph.domain import Domain

LATTICE_TOLERANCE = 1e-6
"""Largest distance of a point from the lattice, relative to its spacing."""


def lattice_order(position: Array, domain: Domain) -> tuple[tuple[int, ...], Indices]:
    """Return the lattice's shape, and the indices of its points in `position`, row by row.

    Raises ValueError if positions (n_points, n_dim) [m] are not on one.
    """
    n_points, n_dim = position.shape
    near_first = LATTICE_TOLERANCE * (math.prod(domain.lengths) / n_points) ** (1.0 / n_dim)
    # Points of a lattice that share a coordinate are one in n_columns, or n_rows, or n_layers.
    shared = (np.abs(position - position[0]) < near_first).sum(axis=0)
    shape = np.maximum(n_points // shared, 1)
    cells = (position - domain.lower) / domain.lengths * shape - 0.5
    nearest = np.rint(cells).astype(np.int64)
    number = nearest @ np.cumprod((1, *shape[:-1]))
    is_near = np.abs(cells - nearest) < LATTICE_TOLERANCE
    if not (is_near.all() and np.array_equal(np.sort(number), np.arange(shape.prod()))):
        raise ValueError("points on a lattice are needed, and these are not on one")
    return tuple(shape.tolist()), np.argsort(number)


@dataclass(frozen=True)
class Lattice:
    """A lattice in a box, and the neighbours of its points."""

    domain: Domain
    shape: tuple[int, ...]
    """Number of points along each axis."""
    depth: int
    """Number of points within the kernel's support, on each side along an axis."""

    @property
    def pitches(self) -> Array:
        """Distances of the points along each axis (3,) [m]."""
        return np.divide(self.domain.lengths, self.shape)

    def reach(self, axis: int) -> tuple[Indices, Indices]:
        """Return the points behind the coordinates within reach, and the walls crossed (0 or 1)."""
        n = self.shape[axis]
        places = np.arange(-self.depth, n + self.depth)
        if self.domain.periodic[axis]:
            return places % n, np.zeros_like(places)
        beyond = ((places < 0) | (places >= n)).astype(np.int64)
        # Reflected at the first wall, then at the second: a short axis may need both.
        folded = np.mod(places, 2 * n)
        return np.minimum(folded, 2 * n - 1 - folded), beyond

    def images(self, *factors: Array | float) -> Images:
        """Return the images.

        The factors by axis are those of images behind its walls, or of all coordinates.
        """
        axes = [self.reach(axis) for axis in range(len(factors))]
        x, y, z = (
            factor if isinstance(factor, np.ndarray) else np.where(beyond, factor, 1.0)
            for factor, (_, beyond) in zip(factors, axes, strict=True)
        )
        return Images(self.depth, axes[0][0], axes[1][0], axes[2][0], x, y, z)
