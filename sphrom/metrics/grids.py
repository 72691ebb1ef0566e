"""Points on lines and grids, and the slices of a three-dimensional box that pictures show.

Points are the midpoints of equal intervals, so that none is on the edges of a box, or twice on the
two sides of a periodic one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array

GAP = 0.06
"""Distance between slices in a picture, relative to the longest edge of the box."""
VIEWS = ((0, 1), (2, 1), (0, 2))
"""The axes to the right and upwards of each slice of a three-dimensional box."""
Extent = tuple[float, float, float, float]
"""Left, right, lower and upper edge of a picture [m]."""


def midpoints(lower: float, upper: float, n_points: int) -> Array:
    """Return the midpoints (n_points,) [m] of equal intervals between two bounds."""
    return lower + (np.arange(n_points) + 0.5) * (upper - lower) / n_points


def spread(spans: Sequence[tuple[float, float]], n_points: int) -> Array:
    """Return points (n_points,) [m], evenly spread over consecutive intervals."""
    starts = np.array([low for low, _ in spans])
    lengths = np.array([high - low for low, high in spans])
    ends = np.cumsum(lengths)
    along = midpoints(0.0, float(ends[-1]), n_points)
    piece = np.minimum(np.searchsorted(ends, along), len(spans) - 1)
    return np.asarray(starts[piece] + (along - (ends - lengths)[piece]))


def grid_points(lower: Sequence[float], upper: Sequence[float], shape: Sequence[int]) -> Array:
    """Return the points (n_points, n_dim) [m] of a grid over a box, row by row from below.

    `reshape(shape)` turns a field there into a picture with shape (ny, nx), or (nz, ny, nx).
    """
    axes = [midpoints(*each) for each in zip(lower, upper, shape[::-1], strict=True)]
    return np.stack([each.ravel() for each in np.meshgrid(*axes[::-1], indexing="ij")][::-1], 1)


@dataclass(frozen=True)
class Slices:
    """The part of a box that pictures show: a plane box as a whole, a three-dimensional one in
    slices.

    The slices go through the middle of the box and lie side by side as in a technical drawing: that
    of x and y, to its right that of z and y, and above it that of x and z.
    """

    lower: Sequence[float]
    """The lower corner of the box [m]."""
    upper: Sequence[float]

    @property
    def is_plane(self) -> bool:
        """Whether the box is in a plane, and the picture is the box."""
        return len(self.lower) == 2

    @property
    def _starts(self) -> Array:
        """Where z begins along both axes of the picture [m]."""
        longest = float(np.subtract(self.upper, self.lower).max())
        return np.array(self.upper[:2]) + GAP * longest

    @property
    def extent(self) -> Extent:
        """The edges of the picture [m]."""
        right, top = self.upper[:2]
        if not self.is_plane:
            right, top = (self._starts + self.upper[2] - self.lower[2]).tolist()
        return self.lower[0], right, self.lower[1], top

    @property
    def rectangles(self) -> list[list[float]]:
        """The left, right, lower and upper edge of each slice in space [m]."""
        (left, bottom), (right, top) = self.lower[:2], self.upper[:2]
        x, y = self._starts.tolist()
        _, right_end, _, top_end = self.extent
        return [
            [left, right, bottom, top],
            [x, right_end, bottom, top],
            [left, right, y, top_end],
        ]

    def shown(self, view: int, points: Array) -> Array:
        """Return the places (n_points, 2) in the picture of points (n_points, 3) [m] in a slice."""
        axes = VIEWS[view]
        shift = np.where(np.array(axes) == 2, self._starts - self.lower[2], 0.0)
        return points[:, axes] + shift

    def places(self, shown: Array) -> Array:
        """Return the points (n_points, n_dim) of places (n_points, 2) in the picture [m].

        Between slices they are NaN.
        """
        if self.is_plane:
            return shown
        points = np.tile(0.5 * np.add(self.lower, self.upper), (len(shown), 1))
        beyond = shown >= self._starts
        depth = self.lower[2] + shown - self._starts
        points[:, :2] = np.where(beyond, points[:, :2], shown)
        points[:, 2] = np.where(beyond[:, 0], depth[:, 0], points[:, 2])
        points[:, 2] = np.where(beyond[:, 1], depth[:, 1], points[:, 2])
        between = (shown > self.upper[:2]) & ~beyond
        points[between.any(axis=1) | beyond.all(axis=1)] = np.nan
        return points

    def ticks(self, axis: int) -> tuple[list[float], list[str]]:
        """Return places of numbers along an axis of a picture of slices, and the numbers."""
        ends = np.array([self.lower, self.upper])
        fractions = np.array([0.0, 0.5, 1.0])
        along, depth = (low + fractions * (high - low) for low, high in ends[:, [axis, 2]].T)
        # The upper end of the first axis has no number: that of the second begins beside it.
        places = [*along[:2], *(self._starts[axis] + depth - self.lower[2])]
        return places, [f"{value:.3g}" for value in (*along[:2], *depth)]
