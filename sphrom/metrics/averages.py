"""Moving averages of a time series, which take its fast oscillations out."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Array = NDArray[np.float64]


def hat(n_half: int) -> Array:
    """Return weights (2 n_half - 1,) that rise and fall linearly, and sum up to one.

    Averages with them lose oscillations whose period is a part of n_half intervals, and nearly
    lose faster ones.
    """
    box = np.full(n_half, 1.0 / n_half)
    return np.convolve(box, box)


def moving_average(values: Array, weights: Array) -> Array:
    """Return averages (n - n_weights + 1, ...) along the first axis of values (n, ...).

    Raises ValueError when there are fewer values than weights.
    """
    return np.asarray(sliding_window_view(values, len(weights), axis=0) @ weights)
