"""The largest speed and the kinetic energy of a reduced run, from its coordinates.

The largest speed over all points and snapshots is found without visiting most of them: a speed is
no larger than the sum of the modes' speeds there times the largest of their coordinates. Where that
bound is below a speed that was found elsewhere, nothing has to be rebuilt.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.trial_basis import TrialBasis

Array = NDArray[np.float64]

N_FIRST = 64
"""Points of the largest bounds, which are looked at first."""
N_BLOCK = 4096
"""Points that are rebuilt at once."""
ROUNDING = 1e-9
"""Slack of bounds."""


class SpeedBounds:
    """Bounds of the speeds that coordinates of a basis can have, by point."""

    def __init__(self, basis: TrialBasis) -> None:
        self._modes = basis.velocity_modes
        self._speeds = np.hypot(basis.velocity_modes[..., 0], basis.velocity_modes[..., 1])
        self._offset = None if basis.offset is None else basis.offset[1]
        if self._offset is not None:
            self._offset_speeds = np.hypot(self._offset[:, 0], self._offset[:, 1])

    def largest(self, coordinates: Array) -> float:
        """Return the largest speed [m/s] of coordinates (n_snapshots, n_modes)."""
        bounds = np.abs(coordinates).max(axis=0) @ self._speeds
        if self._offset is not None:
            bounds = bounds + self._offset_speeds
        n_first = min(N_FIRST, len(bounds))
        first = np.argpartition(bounds, -n_first)[-n_first:]
        found = self._largest_at(coordinates, first)
        left = np.flatnonzero(bounds * (1.0 + ROUNDING) > found)
        blocks = np.split(left, range(N_BLOCK, len(left), N_BLOCK))
        return max([found, *(self._largest_at(coordinates, some) for some in blocks if len(some))])

    def _largest_at(self, coordinates: Array, points: NDArray[np.int64]) -> float:
        velocity = np.tensordot(coordinates, self._modes[:, points], 1)
        if self._offset is not None:
            velocity = velocity + self._offset[points]
        return float(np.sqrt(np.max(velocity[..., 0] ** 2 + velocity[..., 1] ** 2)))


class KineticEnergy:
    """Sum m |u|^2 / 2 of particles of one mass, in coordinates of a basis."""

    def __init__(self, basis: TrialBasis, mass: float) -> None:
        """Multiply the modes with each other; `mass` [kg/m] is a particle's."""
        columns = basis.velocity_modes.reshape(basis.n_modes, -1)
        if basis.offset is not None:
            columns = np.vstack((columns, basis.offset[1].ravel()))
        self._gram = 0.5 * mass * (columns @ columns.T)

    def of(self, coordinates: Array) -> Array:
        """Return the energy (n_states,) [J/m] of coordinates (n_states, n_modes)."""
        n_states, n_modes = coordinates.shape
        constant = np.ones((n_states, len(self._gram) - n_modes))
        factors = np.concatenate((coordinates, constant), axis=1)
        return np.asarray(np.sum((factors @ self._gram) * factors, axis=1))
