"""Sobol indices: which share of an output's variance a parameter causes.

Of an output y of independent parameters the index of first order of parameter i is the variance of
the mean of y given x_i, over that of y: what x_i causes alone. The total one is the mean of the
variance given all parameters but x_i, over that of y: what x_i has any part in. In Saltelli's
design (2010) two samples A and B of n points are mixed: in AB_i, column i of A is that of B. Then

    V = var(y_A, y_B),  S_i = mean(y_B (y_ABi - y_A)) / V,  T_i = mean((y_A - y_ABi)^2) / 2 V,

with the mean of y_A and y_B taken out of all. It takes n (d + 2) runs for d parameters.
`scipy.stats.sobol_indices` computes the indices. Intervals are those of a bootstrap: the same sums
over n points that are drawn anew from the n, with replacement, between whose percentiles the index
lies. Scipy's own takes memory that grows with the square of n; a resample here is a row of counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CONFIDENCE = 0.95
"""Of intervals."""
N_RESAMPLES = 500
"""Of the bootstrap."""
LEAST_SPREAD = 1e-9
"""Standard deviation over the largest value below which an output doesn't vary but by rounding."""


@dataclass(frozen=True)
class SobolIndices:
    """Indices by parameter and output, and where the truth lies with a confidence of 95 %."""

    first: Array
    """(n_parameters, n_outputs)."""
    first_interval: Array
    """(2, n_parameters, n_outputs), low and high."""
    total: Array
    """(n_parameters, n_outputs)."""
    total_interval: Array
    """(2, n_parameters, n_outputs), low and high."""


def saltelli_design(unit: Array) -> Array:
    """Return A, B and AB_1 to AB_d one after the other ((d + 2) n, d).

    `unit` (n, 2 d) are points of a unit cube: columns of A, then those of B.
    """
    first, second = np.hsplit(unit, 2)
    mixed = []
    for column in range(first.shape[1]):
        mixed.append(first.copy())
        mixed[-1][:, column] = second[:, column]
    return np.concatenate([first, second, *mixed])


def parts_of(values: Array, n_parameters: int) -> tuple[Array, Array, Array]:
    """Split values ((d + 2) n, n_outputs) of a design into those of A, B (n, ...), AB (d, n, ...).

    They are as `saltelli_design` has its points.
    """
    blocks = values.reshape(n_parameters + 2, -1, *values.shape[1:])
    return blocks[0], blocks[1], blocks[2:]


def varying(values: Array) -> NDArray[np.bool_]:
    """Return which outputs of values (n_runs, n_outputs) vary by more than rounding."""
    return np.asarray(values.std(axis=0) > LEAST_SPREAD * np.abs(values).max(axis=0))


def sobol_indices(values: Array, n_parameters: int, seed: int = 0) -> SobolIndices:
    """Return the indices of values ((d + 2) n, n_outputs) of a design, n a power of two.

    Outputs that don't vary have indices of zero.
    """
    from scipy import stats  # it takes long to load

    own, other, mixed = parts_of(values, n_parameters)
    n_points, n_outputs = own.shape
    found = stats.sobol_indices(
        func={"f_A": own.T, "f_B": other.T, "f_AB": mixed.transpose(0, 2, 1)}, n=n_points
    )
    shape = n_parameters, n_outputs
    # Scipy has outputs first, and no axis of one output.
    first, total = (
        order.reshape(n_outputs, n_parameters).T.reshape(shape)
        for order in (found.first_order, found.total_order)
    )
    vary = varying(np.concatenate((own, other)))
    resampled = _resampled(own, other, mixed, _drawn(n_points, seed))
    ends = 0.5 * (1.0 - CONFIDENCE) * np.array([1.0, -1.0]) + np.array([0.0, 1.0])
    intervals = [np.quantile(each, ends, axis=0) for each in resampled]
    return SobolIndices(
        *(np.where(vary, each, 0.0) for each in (first, intervals[0], total, intervals[1]))
    )


@lru_cache(maxsize=2)
def _drawn(n_points: int, seed: int) -> Array:
    """Return how often each resample draws each point (n_resamples, n_points)."""
    share = np.full(n_points, 1.0 / n_points)
    counts = np.random.default_rng(seed).multinomial(n_points, share, N_RESAMPLES)
    return counts.astype(np.float64)


def _resampled(own: Array, other: Array, mixed: Array, counts: Array) -> tuple[Array, Array]:
    """Return both orders (n_resamples, n_parameters, n_outputs) of points that count some times."""
    n_points = len(own)
    mean = 0.5 * (own.mean(axis=0) + other.mean(axis=0))
    own, other, mixed = own - mean, other - mean, mixed - mean
    weights = counts / n_points
    means = 0.5 * weights @ (own + other)
    variance = 0.5 * weights @ (own**2 + other**2) - means**2
    variance = np.where(variance > 0.0, variance, 1.0)
    shape = (len(counts), len(mixed), own.shape[1])
    first, total = np.empty(shape), np.empty(shape)
    for i, each in enumerate(mixed):
        first[:, i] = weights @ (other * (each - own)) / variance
        total[:, i] = 0.5 * weights @ (own - each) ** 2 / variance
    return first, total
