"""Closures: how the rates at particles become those of the generalized coordinates.

Galerkin projection (Eq. 3.21) takes the rates as they are. Adjoint Petrov-Galerkin (Eq. 3.22,
Alg. 3.5; Parish, Wentland and Duraisamy 2020) adds the effect of the unresolved residual.

Fields are (3, n_particles): the state's first field and two components of velocity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Derivative = Callable[[Array, float], Array]
"""From a field and a step, the derivative of the rates along the field, by a finite difference."""

MEMORY_RATIO = 0.2
"""Automatic memory length times the reduced Jacobian's spectral radius."""
ACOUSTIC_RATIO = 0.5
"""Largest automatic memory length over the time that sound takes to cross h."""


class Projection(Protocol):
    """The projection onto the modes at some particles."""

    def __call__(self, fields: Array) -> Array:
        """Return the coordinates (n_vectors,) of the field nearest to `fields`."""

    def orthogonal(self, fields: Array) -> Array:
        """Return the part of fields that the projection leaves out, Pi' f (Alg. 3.5)."""


class Galerkin:
    """Projection of the rates without a closure (Eq. 3.21), from which closures derive."""

    def reduced_rates(
        self,
        projection: Projection,
        rates: Array,
        fluctuation: Callable[[], Array],
        derivative: Derivative,
    ) -> Array:
        """Return the reduced rates (n_vectors,) [1/s].

        Parameters
        ----------
        fluctuation : returns the state without its constant part (3, n_particles).
        """
        return projection(rates)


@dataclass(frozen=True)
class AdjointPetrovGalerkin(Galerkin):
    """The closure of Eq. 3.22, matrix-free (Alg. 3.5)."""

    memory_length: float
    """tau [s]."""
    jacobian_step: float = 1e-5
    """The finite difference's step over the state's size, per field."""

    def reduced_rates(
        self,
        projection: Projection,
        rates: Array,
        fluctuation: Callable[[], Array],
        derivative: Derivative,
    ) -> Array:
        """Return the projected rates with the effect of the residual after a memory length."""
        residual = projection.orthogonal(rates)
        step = self.jacobian_step * relative_step(fluctuation(), residual)
        if step == 0.0:
            return projection(rates)
        return projection(rates + self.memory_length * derivative(residual, step))


def memory_length(jacobian: Array, smoothing_length: float, sound_speed: float) -> float:
    """Return the automatic memory length [s] for a Galerkin Jacobian (n_modes, n_modes) [1/s].

    0.2 over the spectral radius, and at most half the time in which sound crosses a smoothing
    length: a basis of few modes may represent no sound, but the closure's residual is full of it.
    """
    longest = ACOUSTIC_RATIO * smoothing_length / sound_speed
    radius = float(np.max(np.abs(np.linalg.eigvals(jacobian))))
    return min(MEMORY_RATIO / radius, longest) if radius > 0.0 else longest


def relative_step(state: Array, direction: Array) -> float:
    """Return the largest step that changes no field by more than its own size.

    Density and velocity differ by orders of magnitude, so that one constant (Eq. 3.22 has 1e-5)
    would mean nothing.
    """
    sizes = [
        (float(np.linalg.norm(state[f])), float(np.linalg.norm(direction[f])))
        for f in (slice(0, 1), slice(1, 3))
    ]
    steps = [size / length for size, length in sizes if size > 0.0 and length > 0.0]
    return min(steps, default=0.0)
