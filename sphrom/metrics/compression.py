"""Compression of a reduced model, and the share of its modes (Eq. 4.2, 4.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def compression_factor(n_particles: int, n_modes: int, n_dim: int = 2) -> float:
    """Return N_d / M with the (2n + 1) N values of the full state (Eq. 4.2 inverted, as used)."""
    return (2 * n_dim + 1) * n_particles / _positive(n_modes)


def field_compression_factor(n_particles: int, n_modes: int, n_dim: int = 2) -> float:
    """Return (n + 1) N / M: density and velocity, which are the reduced fields, over modes."""
    return (n_dim + 1) * n_particles / _positive(n_modes)


def cumulative_singular_value_share(singular_values: Array) -> Array:
    """Return 100 sum_1^M sigma / sum sigma [%] for M = 1, 2, ... (Eq. 4.3 as printed)."""
    return _share(singular_values)


def energy(singular_values: Array) -> Array:
    """Return 100 sum_1^M sigma^2 / sum sigma^2 [%] for M = 1, 2, ...: the share of variance."""
    return _share(singular_values**2)


def _share(parts: Array) -> Array:
    total = parts.sum()
    if not total > 0.0:
        raise ValueError("singular values that are all zero or not finite have no shares")
    return 100.0 * np.cumsum(parts) / total


def _positive(n_modes: int) -> int:
    if n_modes < 1:
        raise ValueError(f"a reduced model has at least one mode, not {n_modes}")
    return n_modes
