"""The full model as the time loop sees it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.sph.domain import Domain
from sphrom.sph.functional import Functional
from sphrom.sph.neighbourhood import Neighbourhood
from sphrom.sph.time_loop import Snapshot

Array = NDArray[np.float64]


class FullModel:
    """The full model as the time loop sees it; states are (5, n_particles)."""

    def __init__(self, functional: Functional) -> None:
        self._functional = functional

    @property
    def domain(self) -> Domain:
        """Where the fluid is."""
        return self._functional.domain

    @property
    def neighbourhood(self) -> Neighbourhood:
        """The list of neighbours that rates are summed over."""
        return self._functional.neighbourhood

    def rates(self, state: Array, time: float) -> Array:
        """Return the rates of a state (Eq. 2.17)."""
        return self._functional(state, time)

    def position(self, state: Array) -> Array:
        """Return the positions (2, n_particles) [m]."""
        return state[:2]

    def wrapped(self, state: Array) -> Array:
        """Return the state with its particles in the box, and forget their neighbours."""
        self._functional.neighbourhood.forget()
        return np.vstack((self._functional.domain.wrap(state[:2].T).T, state[2:]))

    def snapshot(self, state: Array) -> Snapshot:
        """Return the fields of a state."""
        return Snapshot(state[:2], state[2], state[3:])
