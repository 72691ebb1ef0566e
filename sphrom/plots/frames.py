"""Frames of pictures: a part of the plane, or slices of a three-dimensional box, as pixels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array
from sphrom.metrics.grids import Extent, Slices, grid_points

Solids = tuple[Array, Array, Array]
"""Solids as x (nx,) and y (ny,) of pixels [m], and their signed distance (ny, nx) from walls [m],
negative in the solid."""
PIXELS_PER_SPACING = 3.0
MAX_PIXELS = 400
"""Largest number of pixels along the longer side of a raster."""
NOWHERE = 1e30
"""Coordinate of pixels between slices, far from all points [m]."""
REACH = 1.1
"""Distance from the nearest point, in spacings, above which a pixel is outside of the fluid."""


@dataclass(frozen=True)
class Frame:
    """The part of the plane that a picture shows."""

    extent: Extent
    """Left, right, lower and upper edge [m]."""
    solids: Solids | None = None
    slices: Slices | None = None
    """The slices that the picture shows, of a box in space."""
    has_air: bool = False
    """Whether places without fluid are air rather than solids."""

    @property
    def ends(self) -> Extent:
        """The coordinates at its left, right, lower and upper edge [m]."""
        left, right, lower, upper = self.extent
        if self.slices is not None:
            right = upper = self.slices.upper[2]
        return left, right, lower, upper

    @property
    def aspect(self) -> float:
        """Its height over its width."""
        left, right, lower, upper = self.extent
        return (upper - lower) / (right - left)

    @property
    def labels(self) -> tuple[str, str]:
        """The labels of the axes."""
        return ("x [m]", "y [m]") if self.slices is None else ("x, then z [m]", "y, then z [m]")

    def raster(self, position: Array) -> Callable[[Array], Array]:
        """Return a function that turns values at points (n_points, n_dim) [m] into pixels (ny, nx).

        Each pixel has the value of the nearest point, and NaN outside of the fluid.
        """
        from scipy.spatial import cKDTree  # importing it takes long

        left, right, lower, upper = self.extent
        sides = np.array([upper - lower, right - left])
        spacing = float(np.sqrt(np.prod(sides) / len(position)))
        if self.slices is not None:
            edges = np.subtract(self.slices.upper, self.slices.lower)
            spacing = float(np.cbrt(np.prod(edges) / len(position)))
        pixel = max(spacing / PIXELS_PER_SPACING, float(np.max(sides)) / MAX_PIXELS)
        ny, nx = map(int, np.maximum(1, np.ceil(sides / pixel)))
        points = grid_points((left, lower), (right, upper), (ny, nx))
        if self.slices is not None:
            points = np.nan_to_num(self.slices.places(points), nan=NOWHERE)
        distance, nearest = cKDTree(position).query(points.reshape(ny, nx, -1))
        return lambda values: np.where(distance <= REACH * spacing, values[nearest], np.nan)
