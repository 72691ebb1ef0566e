"""Eq. 2.18 on equations that are solved by hand."""

from __future__ import annotations

import numpy as np
import pytest

from sphrom.sph.time_loop import runge_kutta_step


def integrate(functional, state: np.ndarray, time: float, n_steps: int) -> np.ndarray:
    step = time / n_steps
    for n in range(n_steps):
        state = runge_kutta_step(functional, state, n * step, step)
    return state


def fitted_order(functional, start: np.ndarray, exact: np.ndarray, time: float) -> float:
    counts = np.array([20, 40, 80, 160])
    errors = [np.max(np.abs(integrate(functional, start, time, n) - exact)) for n in counts]
    return float(-np.polyfit(np.log(counts), np.log(errors), 1)[0])


def test_order_on_a_nonlinear_system() -> None:
    """A rotation whose rate depends on the radius, which stays what it is."""

    def functional(state: np.ndarray, _: float) -> np.ndarray:
        return np.sum(state * state, axis=0) * np.stack((-state[1], state[0]))

    start = np.array([[1.0, 0.5], [0.0, 0.9]])
    angle = 1.5 * np.sum(start * start, axis=0)
    exact = np.stack(
        (
            start[0] * np.cos(angle) - start[1] * np.sin(angle),
            start[0] * np.sin(angle) + start[1] * np.cos(angle),
        )
    )
    assert fitted_order(functional, start, exact, 1.5) == pytest.approx(4.0, abs=0.15)


def test_the_state_is_left_alone_and_seen_four_times() -> None:
    state, seen = np.array([1.0, 2.0]), []

    def functional(y: np.ndarray, time: float) -> np.ndarray:
        seen.append((y.copy(), time))
        return 0.1 * y

    runge_kutta_step(functional, state, 3.0, 1.0)
    assert np.array_equal(state, [1.0, 2.0])
    assert [time for _, time in seen] == [3.0, 3.5, 3.5, 4.0]
    assert np.array_equal(seen[0][0], state)


def test_order_where_time_decides() -> None:
    """dy/dt = -y tan t + 2 cos t, solved by y = (2 t + 1) cos t."""

    def functional(y: np.ndarray, time: float) -> np.ndarray:
        return -y * np.tan(time) + 2.0 * np.cos(time)

    order = fitted_order(functional, np.array([1.0]), np.array([3.0 * np.cos(1.0)]), 1.0)
    assert order == pytest.approx(4.0, abs=0.15)
