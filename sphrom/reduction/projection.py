"""Projection of the functional onto the trial basis at the particles (Eq. 3.21-3.22, Alg. 3.5).

The basis is (n_particles, 3, n_modes): for each particle the state's first field and two
components of velocity. Fields are (3, n_particles). The pseudo-inverse is taken in the inner
product, whose weights (n_particles,) are the particles' volumes or one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Array = NDArray[np.float64]


class Projector:
    """The weighted pseudo-inverse of a basis at particles."""

    def __init__(self, basis: Array, weights: Array) -> None:
        n_modes = basis.shape[2]
        self._rows = basis.reshape(-1, n_modes)
        self._weighted = (basis * weights[:, None, None]).reshape(-1, n_modes)
        self._factor = cho_factor(self._weighted.T @ self._rows)

    def __call__(self, fields: Array) -> Array:
        """Return the coordinates (n_modes,) of the field nearest to `fields`."""
        return np.asarray(cho_solve(self._factor, self._weighted.T @ fields.T.ravel()))

    def orthogonal(self, fields: Array) -> Array:
        """Return what the projection leaves out, Pi' f (Alg. 3.5)."""
        inside = self._rows @ self(fields)
        return fields - inside.reshape(-1, 3).T


@dataclass(frozen=True)
class AdjointPetrovGalerkin:
    """The closure of Eq. 3.22 (Parish, Wentland and Duraisamy 2020)."""

    memory_length: float
    """tau [s]."""
    jacobian_step: float = 1e-5
    """The finite difference's step over the state's size, per field."""


def galerkin(projector: Projector, rates: Array) -> Array:
    """Return the reduced rates (n_modes,) [1/s] of Eq. 3.21."""
    return projector(rates)


def adjoint_petrov_galerkin(
    projector: Projector,
    rates: Array,
    fluctuation: Array,
    closure: AdjointPetrovGalerkin,
    derivative: Callable[[Array, float], Array],
) -> Array:
    """Return the reduced rates (n_modes,) of Eq. 3.22, matrix-free (Alg. 3.5).

    Parameters
    ----------
    fluctuation : (3, n_particles) the state without its constant part, for its size.
    derivative : of the functional along a field, by a finite difference of the given step.
    """
    residual = projector.orthogonal(rates)
    step = closure.jacobian_step * relative_step(fluctuation, residual)
    if step == 0.0:
        return projector(rates)
    return projector(rates + closure.memory_length * derivative(residual, step))


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
