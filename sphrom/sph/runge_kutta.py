"""The classical fourth-order Runge-Kutta scheme (Eq. 2.18), for any state that adds and scales."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def runge_kutta_step(
    functional: Callable[[Array, float], Array], state: Array, time: float, time_step: float
) -> Array:
    """Return the state one step of `time_step` [s] after `time` [s] (Eq. 2.18)."""
    half = time + 0.5 * time_step
    first = functional(state, time)
    second = functional(state + 0.5 * time_step * first, half)
    third = functional(state + 0.5 * time_step * second, half)
    fourth = functional(state + time_step * third, time + time_step)
    return state + time_step / 6.0 * (first + 2.0 * (second + third) + fourth)
