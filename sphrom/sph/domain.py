"""The box that particles live in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Domain:
    """An axis-parallel box, periodic along the axes that say so; lengths in [m]."""

    lower: tuple[float, float]
    upper: tuple[float, float]
    periodic: tuple[bool, bool]

    @property
    def lengths(self) -> tuple[float, float]:
        """The box's edges [m]."""
        return (self.upper[0] - self.lower[0], self.upper[1] - self.lower[1])

    @property
    def area(self) -> float:
        """The box's area [m2]."""
        return self.lengths[0] * self.lengths[1]

    def wrap(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions (n_particles, 2) [m] moved into the box along its periodic axes."""
        wrapped = np.array(position, dtype=np.float64)
        for axis, (low, length) in enumerate(zip(self.lower, self.lengths, strict=True)):
            if self.periodic[axis]:
                inside = np.mod(wrapped[:, axis] - low, length)
                # np.mod of a tiny negative number rounds up to the length itself.
                inside[inside >= length] = 0.0
                wrapped[:, axis] = low + inside
        return wrapped
