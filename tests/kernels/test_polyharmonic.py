"""Radial functions and their gradients against direct formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sphrom.kernels import polyharmonic

STEP = 1e-6


def radial(order: int, distance: float) -> float:
    """Eq. 3.18, written out."""
    if order % 2 == 1:
        return distance**order
    return distance**order * math.log(distance) if distance > 0.0 else 0.0


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(1).uniform(-1.5, 1.5, (2, 11))


def values(x: float, y: float, points: np.ndarray, order: int) -> np.ndarray:
    square, value = np.empty((2, points.shape[1]))
    polyharmonic.radial_values(x, y, points[0], points[1], order, square, value)
    return value


def gradients(x: float, y: float, points: np.ndarray, order: int) -> np.ndarray:
    square, value, dx, dy = np.empty((4, points.shape[1]))
    polyharmonic.radial_gradients(x, y, points[0], points[1], order, square, value, dx, dy)
    return np.stack((value, dx, dy))


@pytest.mark.parametrize("order", range(1, 10))
def test_values_are_the_radial_function(points: np.ndarray, order: int) -> None:
    expected = [radial(order, math.hypot(0.2 - x, -0.1 - y)) for x, y in points.T]
    np.testing.assert_allclose(values(0.2, -0.1, points, order), expected, rtol=1e-13, atol=1e-15)


@pytest.mark.parametrize("order", range(1, 10))
def test_gradients_are_the_derivatives(points: np.ndarray, order: int) -> None:
    x, y = 0.2, -0.1
    value, dx, dy = gradients(x, y, points, order)
    np.testing.assert_allclose(value, values(x, y, points, order), rtol=1e-13, atol=1e-15)
    along_x = values(x + STEP, y, points, order) - values(x - STEP, y, points, order)
    along_y = values(x, y + STEP, points, order) - values(x, y - STEP, points, order)
    np.testing.assert_allclose(dx, along_x / (2.0 * STEP), rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(dy, along_y / (2.0 * STEP), rtol=1e-7, atol=1e-7)
