"""Statistics of outputs of many independent runs: quantiles, mean and deviation, with intervals.

The truth y* of a run is known up to the model's error: |y* - y| <= e. With y_(k) the k-th of n
sorted values, the p-quantile of the truth lies with a confidence of 95 % in

    [ (y - e)_(l), (y + e)_(u) ],

where l and u - 1 are the 2.5 % and 97.5 % quantiles of the binomial distribution of n draws with
probability p. Such an interval holds for any distribution: order statistics enclose the quantile
whatever the distribution is, and the quantile is monotonic in the values. Without e it is that of
sampling alone. The mean and the standard deviation s lie in

    mean(y) +- (z s / sqrt(n) + mean(e)),    s +- (z sqrt((m4 - s^4) / n) / 2 s + sqrt(mean(e^2))),

z = 1.96 and m4 the fourth moment about the mean, by the central limit theorem; the deviation is a
seminorm, so that it changes by no more than the root mean square of the error.

Errors that are estimates and no bounds make intervals that are no better than the estimates.
Intervals are for independent draws: of draws that fill a box, as Sobol's, they are too wide.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CONFIDENCE = 0.95
"""Of intervals."""
Z = 1.959963984540054
"""Quantile of the normal distribution for it."""


@dataclass(frozen=True)
class Spread:
    """Statistics of outputs; an interval (2, ...) has a low and a high end."""

    mean: Array
    """(n_outputs,)."""
    mean_interval: Array
    """(2, n_outputs)."""
    deviation: Array
    """(n_outputs,), the standard deviation."""
    deviation_interval: Array
    """(2, n_outputs)."""
    quantiles: Array
    """(n_levels, n_outputs)."""
    sampling_interval: Array
    """(2, n_levels, n_outputs) of the quantiles, by sampling alone."""
    interval: Array
    """(2, n_levels, n_outputs) of the quantiles, by sampling and the model's error."""


def fewest_runs(levels: tuple[float, ...]) -> int:
    """Return how many runs it takes that all quantiles have intervals."""
    nearest = min(min(level, 1.0 - level) for level in levels)
    return int(np.ceil(np.log(0.5 * (1.0 - CONFIDENCE)) / np.log1p(-nearest)))


def ranks(n_runs: int, level: float) -> tuple[int, int]:
    """Return the places, from zero, of the sorted values that enclose a quantile.

    Raises ValueError where there are too few runs for that.
    """
    from scipy.special import bdtr

    # The binomial distribution's quantiles, without loading scipy.stats.
    cumulative = bdtr(np.arange(n_runs + 1.0), n_runs, level)
    tail = 0.5 * (1.0 - CONFIDENCE)
    low, high = (int(np.searchsorted(cumulative, share)) for share in (tail, 1.0 - tail))
    if low < 1 or high >= n_runs:
        raise ValueError(f"{n_runs} runs are too few for an interval of the quantile {level:g}")
    return low - 1, high


def spread(values: Array, errors: Array | None, levels: tuple[float, ...]) -> Spread:
    """Return the statistics of values (n_runs, n_outputs).

    Parameters
    ----------
    errors : (n_runs, n_outputs) of the model, not negative; None where none are known.

    Raises ValueError where there are too few runs for intervals.
    """
    places = [ranks(len(values), level) for level in levels]
    low, high = (list(each) for each in zip(*places, strict=True))
    ordered = np.sort(values, axis=0)
    sampling = np.stack((ordered[low], ordered[high]))
    interval = sampling
    mean_error = root_error = np.zeros(values.shape[1])
    if errors is not None:
        below, above = np.sort(values - errors, axis=0), np.sort(values + errors, axis=0)
        interval = np.stack((below[low], above[high]))
        mean_error, root_error = errors.mean(axis=0), np.sqrt(np.mean(errors**2, axis=0))
    mean, deviation = values.mean(axis=0), values.std(axis=0)
    of_mean = Z * deviation / np.sqrt(len(values)) + mean_error
    of_deviation = _deviation_error(values - mean, deviation) + root_error
    ends = np.array([-1.0, 1.0])[:, None]
    return Spread(
        mean=mean,
        mean_interval=mean + ends * of_mean,
        deviation=deviation,
        deviation_interval=np.maximum(deviation + ends * of_deviation, 0.0),
        quantiles=_quantiles(ordered, levels),
        sampling_interval=sampling,
        interval=interval,
    )


def _deviation_error(departures: Array, deviation: Array) -> Array:
    """Return half of the interval of a standard deviation, from departures from the mean."""
    excess = np.maximum(np.mean(departures**4, axis=0) - deviation**4, 0.0) / len(departures)
    size = 2.0 * deviation
    return np.divide(Z * np.sqrt(excess), size, out=np.zeros_like(size), where=size > 0.0)


def _quantiles(ordered: Array, levels: tuple[float, ...]) -> Array:
    """Return quantiles (n_levels, n_outputs) of sorted values, linear between neighbours."""
    place = np.array(levels) * (len(ordered) - 1)
    below = np.minimum(place.astype(np.int64), len(ordered) - 2)
    share = (place - below)[:, None]
    return np.asarray((1.0 - share) * ordered[below] + share * ordered[below + 1])
