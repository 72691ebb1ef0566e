"""The kinetic energy of states of a basis, from their coordinates alone: a square of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.trial_basis import TrialBasis

Array = NDArray[np.float64]


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
