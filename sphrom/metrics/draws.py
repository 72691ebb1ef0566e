"""Random draws of independent parameters, and statistics of the outputs of many runs.

A distribution is a name in scipy.stats with its arguments: its shape parameters, `loc` and `scale`.
Draws are its quantile function at points of a unit cube.

`docs/uncertainty.md` explains the intervals of quantiles and Sobol indices. With e the model's
error, by the central limit theorem, the mean and the standard deviation s lie in

    mean(y) +- (z s / sqrt(n) + mean(e)),    s +- (z sqrt((m4 - s^4) / n) / 2 s + sqrt(mean(e^2))),

with z = 1.96 and m4 the fourth central moment. If the errors are independent of the parameters,
full runs have the variance s^2 + mean(e^2).

In Saltelli's design (2010) of two samples A and B of n points, AB_i is A with column i of B. Then

    V = var(y_A, y_B),  S_i = mean(y_B (y_ABi - y_A)) / V,  T_i = mean((y_A - y_ABi)^2) / 2 V,

after subtracting the mean of y_A and y_B from all, with n (d + 2) runs for d parameters, computed
by `scipy.stats.sobol_indices`. Intervals are percentiles of a bootstrap, which resamples the n
points. The memory of scipy's grows with the square of n; here a resample is a row of counts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache, lru_cache
from typing import Any, Literal

import numpy as np

from sphrom.arrays import Array
from sphrom.declaration import Record, attribute, dataset

CONFIDENCE = 0.95
"""Confidence level of intervals."""
Z = 1.959963984540054
"""The corresponding quantile of the normal distribution."""
NEAREST_SHARE = 2.0**-33
"""Least distance of shares from zero and one, where quantiles may be infinite."""
USUAL = "uniform, norm, truncnorm, lognorm, triang, beta, gamma, loguniform"
"""Distributions that messages suggest."""
COMMON = ("loc", "scale")
"""Arguments of every distribution, 0 and 1 by default."""
N_RESAMPLES = 500
"""Number of resamples of the bootstrap."""
LEAST_SPREAD = 1e-9
"""Standard deviation, relative to the largest value, below which an output varies by rounding
only."""
Along = Literal["time", "mean", "line"]
"""The meaning of an output's instants."""


@cache
def _known(name: str) -> Any:
    """Return scipy's distribution of a name, or None if it has no quantile function of its own."""
    from scipy import stats  # importing it takes long

    distribution = getattr(stats, name, None)
    if not isinstance(distribution, stats.rv_continuous):
        return None
    # Without one scipy inverts numerically, which takes minutes for many draws.
    own = type(distribution)._ppf is not stats.rv_continuous._ppf
    return distribution if own else None


def problem(name: str, arguments: Mapping[str, float]) -> str | None:
    """Return a message if a distribution or its arguments are invalid, else None."""
    if (known := _known(name)) is None:
        reason = f"scipy.stats has no continuous distribution {name} with a quantile function"
        return f"{reason}; it has {USUAL} and others"
    shapes = set(known.shapes.replace(" ", "").split(",") if known.shapes else ())
    given = ", ".join(f"{argument}: {value:g}" for argument, value in arguments.items())
    if not shapes <= arguments.keys() <= shapes.union(COMMON):
        takes = ", ".join((*sorted(shapes), *COMMON))
        return f"{name} takes {takes}; got {given or 'none of them'}"
    with np.errstate(invalid="ignore"):
        values = quantiles(name, arguments, np.array([0.01, 0.5, 0.99]))
    if not np.all(np.isfinite(values)):
        return f"{name} has no values with {given}"
    return None


def quantiles(name: str, arguments: Mapping[str, float], shares: Array) -> Array:
    """Return the quantiles (...) of a distribution at probabilities `shares` (...)."""
    inside = np.clip(shares, NEAREST_SHARE, 1.0 - NEAREST_SHARE)
    return np.asarray(_known(name).ppf(inside, **arguments), dtype=np.float64)


def share_outside(name: str, arguments: Mapping[str, float], low: float, high: float) -> float:
    """Return the probability of values below one bound or above another."""
    distribution = _known(name)
    below = distribution.cdf(np.nextafter(low, -math.inf), **arguments)
    return float(below + distribution.sf(high, **arguments))


class OutputStatistics(Record):
    """Statistics of an output over time, of its mean over time, or along a line at the end."""

    mean: Array = dataset("instant", "of the output", "mean of the runs")
    mean_interval: Array = dataset(
        "end instant", "of the output", "low and high end of the mean's interval"
    )
    deviation: Array = dataset("instant", "of the output", "standard deviation of the runs")
    deviation_interval: Array = dataset(
        "end instant", "of the output", "low and high end of the deviation's interval"
    )
    quantiles: Array = dataset("level instant", "of the output", "quantiles of the runs")
    sampling_interval: Array = dataset(
        "end level instant", "of the output", "95 % intervals of the quantiles, from sampling alone"
    )
    interval: Array = dataset(
        "end level instant",
        "of the output",
        "intervals of the quantiles, from sampling and the model's estimated error",
    )
    error_share: Array | None = dataset(
        "instant",
        "1",
        "share of the model's squared error in the variance of full runs",
        default=None,
    )
    unit: str = attribute("", "unit of the output")
    along: Along = attribute("", "meaning of the instants: snapshots, places, or one time average")
    model_error: Literal["estimated", "unknown"] = attribute(
        "", "whether the model's error is known, so that intervals include it"
    )


class OutputIndices(Record):
    """Sobol indices of an output, by parameter; zero if the output does not vary."""

    first: Array = dataset(
        "parameter instant", "1", "share of the variance due to the parameter alone", "S"
    )
    first_interval: Array = dataset(
        "end parameter instant", "1", "low and high end of its 95 % interval, by a bootstrap"
    )
    total: Array = dataset(
        "parameter instant", "1", "share of the variance to which the parameter contributes", "T"
    )
    total_interval: Array = dataset(
        "end parameter instant", "1", "low and high end of its 95 % interval, by a bootstrap"
    )


def fewest_runs(levels: tuple[float, ...]) -> int:
    """Return the smallest number of runs for which all quantiles have intervals."""
    nearest = min(min(level, 1.0 - level) for level in levels)
    return int(np.ceil(np.log(0.5 * (1.0 - CONFIDENCE)) / np.log1p(-nearest)))


def ranks(n_runs: int, level: float) -> tuple[int, int]:
    """Return the indices of the sorted values that enclose a quantile.

    Raises ValueError if there are too few runs.
    """
    from scipy.special import bdtr

    # The quantiles of the binomial distribution, without importing scipy.stats.
    cumulative = bdtr(np.arange(n_runs + 1.0), n_runs, level)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = (int(np.searchsorted(cumulative, share)) for share in (tail, 1.0 - tail))
    if low < 1 or high >= n_runs:
        raise ValueError(f"{n_runs} runs are too few for an interval of the quantile {level:g}")
    return low - 1, high


def spread(
    values: Array,
    errors: Array | None,
    levels: tuple[float, ...],
    unit: str = "",
    along: Along = "time",
) -> OutputStatistics:
    """Return the statistics of values (n_runs, n_instants) of an output.

    Parameters
    ----------
    errors : (n_runs, n_instants) of the model, not negative; None if they are unknown.

    Raises ValueError if there are too few runs for intervals.
    """
    low, high = np.array([ranks(len(values), level) for level in levels]).T
    ordered = np.sort(values, axis=0)
    sampling = np.stack((ordered[low], ordered[high]))
    rank = np.array(levels) * (len(ordered) - 1)
    before = np.minimum(rank.astype(np.int64), len(ordered) - 2)
    between = (rank - before)[:, None]
    interval = sampling
    mean_error = root_error = np.zeros(values.shape[1])
    if errors is not None:
        below = np.sort(values - errors, axis=0)
        above = np.sort(values + errors, axis=0)
        interval = np.stack((below[low], above[high]))
        mean_error = errors.mean(axis=0)
        root_error = np.sqrt(np.mean(errors**2, axis=0))
    mean = values.mean(axis=0)
    deviation = values.std(axis=0)
    of_mean = Z * deviation / np.sqrt(len(values)) + mean_error
    moment = np.mean((values - mean) ** 4, axis=0)
    size = 2.0 * deviation
    excess = Z * np.sqrt(np.maximum(moment - deviation**4, 0.0) / len(values))
    of_deviation = np.divide(excess, size, out=np.zeros_like(size), where=size > 0.0) + root_error
    ends = np.array([-1.0, 1.0])[:, None]
    variance = deviation**2 + root_error**2
    share = np.divide(root_error**2, variance, out=np.zeros_like(variance), where=variance > 0.0)
    return OutputStatistics(
        mean=mean,
        mean_interval=mean + ends * of_mean,
        deviation=deviation,
        deviation_interval=np.maximum(deviation + ends * of_deviation, 0.0),
        quantiles=(1.0 - between) * ordered[before] + between * ordered[before + 1],
        sampling_interval=sampling,
        interval=interval,
        error_share=None if errors is None else share,
        unit=unit,
        along=along,
        model_error="unknown" if errors is None else "estimated",
    )


def saltelli_design(unit: Array) -> Array:
    """Return A, B and AB_1 to AB_d, concatenated ((d + 2) n, d).

    `unit` (n, 2 d) are points of a unit cube: the columns of A, then those of B.
    """
    first, second = np.hsplit(unit, 2)
    mixed = []
    for column in range(first.shape[1]):
        mixed.append(first.copy())
        mixed[-1][:, column] = second[:, column]
    return np.concatenate([first, second, *mixed])


def sobol_indices(values: Array, n_parameters: int, seed: int = 0) -> OutputIndices:
    """Return the indices of values ((d + 2) n, n_outputs) of a design, with n a power of two.

    Outputs that do not vary have indices of zero.
    """
    from scipy import stats  # importing it takes long

    blocks = values.reshape(n_parameters + 2, -1, *values.shape[1:])
    own, other, mixed = blocks[0], blocks[1], blocks[2:]
    n_points, n_outputs = own.shape
    found = stats.sobol_indices(
        func={"f_A": own.T, "f_B": other.T, "f_AB": mixed.transpose(0, 2, 1)}, n=n_points
    )
    # Scipy puts outputs first, and has no axis for a single output.
    orders = found.first_order, found.total_order
    first, total = (order.reshape(n_outputs, n_parameters).T for order in orders)
    both = np.concatenate((own, other))
    vary = both.std(axis=0) > LEAST_SPREAD * np.abs(both).max(axis=0)
    resampled = _resampled(own, other, mixed, _drawn(n_points, seed))
    ends = 0.5 * (1.0 - CONFIDENCE) * np.array([1.0, -1.0]) + np.array([0.0, 1.0])
    intervals = [np.quantile(orders, ends, axis=0) for orders in resampled]
    found = OutputIndices(
        first=first, first_interval=intervals[0], total=total, total_interval=intervals[1]
    )
    return found.mapped(lambda each: np.where(vary, each, 0.0))


@lru_cache(maxsize=2)
def _drawn(n_points: int, seed: int) -> Array:
    """Return how many times each resample draws each point (n_resamples, n_points)."""
    share = np.full(n_points, 1.0 / n_points)
    counts = np.random.default_rng(seed).multinomial(n_points, share, N_RESAMPLES)
    return counts.astype(np.float64)


def _resampled(own: Array, other: Array, mixed: Array, counts: Array) -> tuple[Array, Array]:
    """Return both orders (n_resamples, n_parameters, n_outputs) with points weighted by counts."""
    n_points = len(own)
    mean = 0.5 * (own.mean(axis=0) + other.mean(axis=0))
    own, other, mixed = own - mean, other - mean, mixed - mean
    weights = counts / n_points
    means = 0.5 * weights @ (own + other)
    variance = 0.5 * weights @ (own**2 + other**2) - means**2
    variance = np.where(variance > 0.0, variance, 1.0)
    shape = (len(counts), len(mixed), own.shape[1])
    first = np.empty(shape)
    total = np.empty(shape)
    for i, each in enumerate(mixed):
        first[:, i] = weights @ (other * (each - own)) / variance
        total[:, i] = 0.5 * weights @ (own - each) ** 2 / variance
    return first, total
