"""Projection of fields onto the trial basis at the particles (Eq. 3.21).

The basis is (n_particles, n_modes, 3): for each particle, mode by mode, the state's first field and
two components of velocity. Fields are (3, n_particles). The pseudo-inverse is taken in the inner
product, whose weights (n_particles,) are the particles' volumes or one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from sphrom.kernels import projection

Array = NDArray[np.float64]


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
        """Return the part that the projection leaves out, Pi' f (Alg. 3.5)."""
        remainder = np.empty_like(fields)
        projection.leave_out(self._basis, self._separate_mean, self(fields), fields, remainder)
        return remainder
