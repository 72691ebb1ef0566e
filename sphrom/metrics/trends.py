"""Kinetic energy, and rates fitted to series: an order of convergence, an exponential rate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def kinetic_energy(velocity: Array, mass: Array | float) -> Array:
    """Return sum m |u|^2 / 2 [J per metre of depth] of velocities (..., n_particles, n_dim)."""
    return 0.5 * np.sum(mass * np.sum(velocity**2, axis=-1), axis=-1)


def order_of_convergence(spacing: Array, error: Array) -> float:
    """Return the slope of log(error) over log(spacing), by least squares.

    Raises ValueError for fewer than two different spacings or values that are not positive.
    """
    return _slope(_logarithm(spacing, "spacing"), _logarithm(error, "error"))


def exponential_rate(time: Array, value: Array) -> float:
    """Return the slope of log(value) over time [1/s], by least squares: negative for a decay.

    Raises ValueError for fewer than two different times or values that are not positive.
    """
    return _slope(np.asarray(time, dtype=float), _logarithm(value, "value"))


def _logarithm(values: Array, name: str) -> Array:
    values = np.asarray(values, dtype=float)
    if not np.all(np.isfinite(values) & (values > 0.0)):
        raise ValueError(f"a logarithmic fit needs every {name} positive and finite")
    return np.log(values)


def _slope(abscissa: Array, ordinate: Array) -> float:
    if abscissa.shape != ordinate.shape or np.unique(abscissa).size < 2:
        raise ValueError("a slope needs two different points or more, and as many values")
    centred = abscissa - abscissa.mean()
    return float(centred @ (ordinate - ordinate.mean()) / (centred @ centred))
