"""The monomials of coordinates up to the second degree: 1, a_k, and a_k a_l with k <= l."""

from __future__ import annotations

import numpy as np

from sphrom.arrays import Array, Indices


def monomials(states: Array) -> Array:
    """Return the monomials (..., n_monomials) of coordinates (..., n_modes), up to degree two."""
    first, second = np.triu_indices(states.shape[-1])
    ones = np.ones((*states.shape[:-1], 1))
    return np.concatenate((ones, states, states[..., first] * states[..., second]), axis=-1)


def monomials_of(modes: Indices, n_modes: int) -> Indices:
    """Return the indices of some modes' monomials among those of all modes, ascending."""
    first, second = np.triu_indices(n_modes)
    products = np.flatnonzero(np.isin(first, modes) & np.isin(second, modes))
    return np.concatenate(([0], 1 + modes, 1 + n_modes + products))
