"""A reduced model on moving particles as the time loop sees it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.online import ParticleModel
from sphrom.sph.domain import Domain
from sphrom.sph.neighbourhood import Neighbourhood
from sphrom.sph.time_loop import Snapshot

Array = NDArray[np.float64]


class SteppedModel:
    """A reduced model as the time loop sees it."""

    def __init__(self, model: ParticleModel) -> None:
        self._model = model

    @property
    def domain(self) -> Domain:
        """Where the fluid is."""
        return self._model.functional.domain

    @property
    def neighbourhood(self) -> Neighbourhood:
        """The list of neighbours that rates are summed over."""
        return self._model.functional.neighbourhood

    def position(self, state: Array) -> Array:
        """Return the positions (2, n_particles) [m]."""
        return self._model.position(state)

    def rates(self, state: Array, time: float) -> Array:
        """Return the rates of a state (Eq. 3.21 or 3.22, and 3.23)."""
        return self._model(state, time)

    def wrapped(self, state: Array) -> Array:
        """Return the state with its particles in the box, and forget their neighbours."""
        self._model.functional.neighbourhood.forget()
        position = self._model.functional.domain.wrap(self._model.position(state).T)
        return self._model.initial_state(
            self._model.coordinates(state),
            position,
            self._model.mean_density_fluctuation(state),
        )

    def snapshot(self, state: Array) -> Snapshot:
        """Rebuild the fields of a state."""
        fields = self._model.fields(state)
        return Snapshot(
            self._model.position(state),
            fields.density_fluctuation,
            fields.velocity,
            self._model.coordinates(state),
            self._model.mean_density_fluctuation(state),
        )
