"""Projection of the functional onto the trial basis at the particles (Eq. 3.21-3.22, Alg. 3.5).

The basis is (n_particles, n_modes, 3): for each particle, mode by mode, the state's first field and
two components of velocity. Fields are (3, n_particles). The pseudo-inverse is taken in the inner
product, whose weights (n_particles,) are the particles' volumes or one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from sphrom.kernels import projection

Array = NDArray[np.float64]

MEMORY_RATIO = 0.2
"""Automatic memory length times the reduced Jacobian's spectral radius."""
ACOUSTIC_RATIO = 0.5
"""Largest automatic memory length over the time that sound takes to cross h."""


class Projector:
    """The weighted pseudo-inverse of a basis at particles.

    Parameters
    ----------
    separate_mean : whether a constant first field is one vector more of the basis, its last.
    """

    def __init__(self, basis: Array, weights: Array, *, separate_mean: bool = False) -> None:
        self._basis, self._weights, self._separate_mean = basis, weights, separate_mean
        self._n_vectors = basis.shape[1] + separate_mean
        n_chunks, n = projection.N_CHUNKS, self._n_vectors
        partial = np.empty((n_chunks, n, n))
        scratch = np.empty((n_chunks, n, 3 * projection.BLOCK))
        projection.gram(basis, weights, separate_mean, scratch, partial)
        self._factor = cho_factor(partial.sum(axis=0), lower=True)

    def __call__(self, fields: Array) -> Array:
        """Return the coordinates (n_vectors,) of the field nearest to `fields`."""
        partial = np.empty((projection.N_CHUNKS, self._n_vectors))
        projection.products(self._basis, self._weights, self._separate_mean, fields, partial)
        return np.asarray(cho_solve(self._factor, partial.sum(axis=0)))

    def orthogonal(self, fields: Array) -> Array:
        """Return what the projection leaves out, Pi' f (Alg. 3.5)."""
        remainder = np.empty_like(fields)
        projection.leave_out(self._basis, self._separate_mean, self(fields), fields, remainder)
        return remainder


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
