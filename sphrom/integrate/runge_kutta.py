"""The classical fourth-order Runge-Kutta scheme (Eq. 2.18), for any state that adds and scales."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def runge_kutta_step(functional: Callable[[Array], Array], state: Array, time_step: float) -> Array:
    """Return the state one step of `time_step` [s] later (Eq. 2.18)."""
    first = functional(state)
    second = functional(state + 0.5 * time_step * first)
    third = functional(state + 0.5 * time_step * second)
    fourth = functional(state + time_step * third)
    return state + time_step / 6.0 * (first + 2.0 * (second + third) + fourth)
