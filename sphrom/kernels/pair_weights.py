"""The kernel and its gradient's factor at given distances, for sums that are kept as matrices."""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sphrom.kernels.jit import parallel
from sphrom.kernels.wendland import gradient_factor, kernel

Array = NDArray[np.float64]


@parallel
def weigh(distance: Array, inverse_length: float, values: Array, factors: Array) -> None:
    """Compute W [1/m2] and F [1/m4] (n_pairs,) at distances (n_pairs,) [m]."""
    for k in prange(distance.size):
        values[k] = kernel(distance[k], inverse_length)
        factors[k] = gradient_factor(distance[k], inverse_length)
