"""Where the fluid is: a box, periodic along some axes, or the part of it that rectangles cover."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rectangle:
    """An axis-parallel rectangle; lengths in [m]."""

    lower: tuple[float, float]
    upper: tuple[float, float]

    @property
    def area(self) -> float:
        """The rectangle's area [m2]."""
        return (self.upper[0] - self.lower[0]) * (self.upper[1] - self.lower[1])

    def contains(self, position: Array) -> NDArray[np.bool_]:
        """Return which positions (n_points, 2) [m] lie in it, its edges among them."""
        inside = (position >= self.lower) & (position <= self.upper)
        return np.asarray(inside.all(axis=1))


@dataclass(frozen=True)
class Domain:
    """An axis-parallel box, periodic along the axes that say so; lengths in [m].

    Fluid fills the box, or the rectangles in it, which may share edges but not overlap. Where an
    axis isn't periodic, and where rectangles end, there are walls.
    """

    lower: tuple[float, float]
    upper: tuple[float, float]
    periodic: tuple[bool, bool]
    rectangles: tuple[Rectangle, ...] = ()

    @property
    def lengths(self) -> tuple[float, float]:
        """The box's edges [m]."""
        return (self.upper[0] - self.lower[0], self.upper[1] - self.lower[1])

    @property
    def parts(self) -> tuple[Rectangle, ...]:
        """The rectangles that fluid fills."""
        return self.rectangles or (Rectangle(self.lower, self.upper),)

    @property
    def area(self) -> float:
        """The area that fluid fills [m2]."""
        return sum(part.area for part in self.parts)

    @property
    def has_walls(self) -> bool:
        """Whether anything bounds the fluid."""
        return bool(self.rectangles) or not all(self.periodic)

    def contains(self, position: Array) -> NDArray[np.bool_]:
        """Return which positions (n_points, 2) [m] lie in the fluid, once wrapped."""
        wrapped = self.wrap(position)
        inside = np.zeros(len(wrapped), dtype=np.bool_)
        for part in self.parts:
            inside |= part.contains(wrapped)
        return inside

    def wrap(self, position: Array) -> Array:
        """Return positions (n_particles, 2) [m] moved into the box along its periodic axes."""
        wrapped = np.array(position, dtype=np.float64)
        for axis, (low, length) in enumerate(zip(self.lower, self.lengths, strict=True)):
            if self.periodic[axis]:
                inside = np.mod(wrapped[:, axis] - low, length)
                # np.mod of a tiny negative number rounds up to the length itself.
                inside[inside >= length] = 0.0
                wrapped[:, axis] = low + inside
        return wrapped
