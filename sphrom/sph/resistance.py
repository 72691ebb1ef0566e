"""Forces that slow the fluid in proportion to its velocity: resistances, porous bodies, a strip.

A resistance adds -lambda u to the rates of the velocity; a porous body of permeability k has
lambda = nu/k (Darcy's law). An open flow runs in a box that is periodic along the flow, with a
strip across it, a fringe region (Spalart 1988; Nordstrom, Nordin and Henningson 1999, SIAM J. Sci.
Comput. 20). There lambda (U - u) returns the fluid to the velocity U of the inflow.

This force alone would have to balance the pressure drop and friction, so the flow rate would be too
low. As in simulations at a fixed flow rate, the strip therefore also removes the mean of the other
accelerations along the flow: a becomes a - e (e . a), with e the unit vector of all lambda.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array, Mask

RISE, FALL = 0.3, 0.1
"""Shares of a strip's width over which lambda rises, where fluid enters, and falls."""

Rates = Callable[[Array], Array]
"""Return rates (n_positions,) at positions (2, n_positions) [m] in the box."""


@dataclass(frozen=True)
class Strip:
    """A strip across the box that returns the flow to the inflow's velocity."""

    axis: int
    """The axis perpendicular to the strip: 0 is x."""
    start: float
    end: float
    """Its position along that axis [m]."""
    speed: float
    """The largest speed of the inflow [m/s]; negative if fluid leaves the strip at its start."""
    strength: float
    """K."""

    @property
    def largest(self) -> float:
        """The largest lambda [1/s]."""
        width = (self.end - self.start) * (1.0 - 0.5 * (RISE + FALL))
        return self.strength * abs(self.speed) / width

    def contains(self, position: Array) -> Mask:
        """Return whether positions (2, n_positions) [m] in the box are in the strip."""
        return np.asarray((position[self.axis] > self.start) & (position[self.axis] < self.end))

    def rates(self, position: Array) -> Array:
        """Return lambda (n_positions,) [1/s] at positions (2, n_positions) [m] in the box."""
        inside = self.contains(position)
        along = (position[self.axis, inside] - self.start) / (self.end - self.start)
        if self.speed < 0.0:
            along = 1.0 - along
        found = np.zeros(position.shape[1])
        found[inside] = self.largest * _step(along / RISE) * _step((1.0 - along) / FALL)
        return found

    def forcing(self, position: Array, velocity: Callable[[Array], Array]) -> Array:
        """Return lambda U (2, n_positions) [m/s2], given the inflow's velocity [m/s]."""
        out, inside = np.zeros_like(position), np.flatnonzero(self.contains(position))
        out[:, inside] = self.rates(position[:, inside]) * velocity(position[:, inside])
        return out


def _step(x: Array) -> Array:
    """Return a smooth step from 0 at zero to 1 at one, with all derivatives continuous."""
    within = np.clip(x, 1e-3, 1.0 - 1e-3)
    smooth = 1.0 / (1.0 + np.exp(1.0 / (within - 1.0) + 1.0 / within))
    return np.asarray(np.where(x >= 1.0, 1.0, smooth))


@dataclass(frozen=True)
class Resistance:
    """All resistance to the fluid of a scene."""

    own: Rates | None = None
    """lambda without porous bodies and the strip [1/s]."""
    inverse_permeability: Rates | None = None
    """1/k [1/m2]; zero outside porous bodies."""
    strip: Strip | None = None
    in_box: Callable[[Array], Array] = lambda position: position
    """Moves positions (2, n_positions) [m] into the box."""

    def steady(self, position: Array) -> Array:
        """Return lambda without porous bodies (n_positions,) [1/s], independent of viscosity."""
        place = self.in_box(position)
        found = np.zeros(place.shape[1]) if self.own is None else self.own(place)
        return found if self.strip is None else found + self.strip.rates(place)

    def rates(self, position: Array, viscosity: float) -> Array:
        """Return lambda (n_positions,) [1/s] at positions (2, n_positions) [m]."""
        found = self.steady(position)
        if self.inverse_permeability is not None:
            found = found + viscosity * self.inverse_permeability(self.in_box(position))
        return found

    def hold(self, position: Array, acceleration: Array) -> None:
        """Remove the mean of accelerations (2, n_positions) [m/s2] along the strip, in place."""
        if self.strip is not None:
            rates = self.strip.rates(self.in_box(position))
            along = acceleration[self.strip.axis]
            along -= rates * (rates @ along / (rates @ rates))

    def largest(self, samples: Array, viscosity: float) -> float:
        """Return the largest lambda [1/s] at positions (2, n_positions) [m], or in the strip."""
        largest = float(self.rates(samples, viscosity).max())
        return largest if self.strip is None else max(largest, self.strip.largest)
