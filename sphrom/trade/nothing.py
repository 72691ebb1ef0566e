"""The alternatives without a model: training runs, as they are or interpolated, or the start.

They take no time once the training runs are there. Interpolated runs are what interpolating their
coordinates over the parameters gives, in a basis that holds all of them. A model that is no better
than one of them, or slower and no better than a full run, is never recommended.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import ParameterPoint, nearest_point
from sphrom.metrics.histories import Errors, mean_errors
from sphrom.metrics.samples import Samples
from sphrom.reduction.interpolation_weights import spline_weights
from sphrom.trade.table import NothingRow

Array = NDArray[np.float64]

NEAREST = "nearest training run"
INTERPOLATED = "training runs, interpolated"
UNCHANGED = "the start, unchanged"


def nearest(point: ParameterPoint, trained: Iterable[ParameterPoint]) -> ParameterPoint | None:
    """Return the trained value nearest to a point, by their ratio; None where it has no other.

    With several parameters each counts over its largest value.
    """
    others = [other for other in trained if other != point]
    if point.others:
        return nearest_point(point, others) if others else None
    return min(others, key=lambda o: abs(math.log(o.reynolds / point.reynolds)), default=None)


def unchanged(samples: Samples) -> Samples:
    """Return a flow that stays at its first snapshot."""
    return samples.at(np.zeros(len(samples.time), dtype=np.int64))


def interpolated(runs: Sequence[Samples], weights: Array) -> Samples:
    """Return a sum of runs with weights (n_runs,)."""
    velocity = np.tensordot(weights, [run.velocity for run in runs], 1)
    pressure = np.tensordot(weights, [run.pressure for run in runs], 1)
    return Samples(runs[0].time, velocity, pressure)


def nothing_rows(
    full: dict[ParameterPoint, Samples],
    trained: Sequence[ParameterPoint],
    sampled: Callable[[ParameterPoint], Samples],
    errors: Callable[[ParameterPoint, Samples], Errors],
    places: Callable[[Sequence[ParameterPoint]], Array],
) -> Iterator[NothingRow]:
    """Yield the errors without a model at the points of full runs.

    `sampled` gives a training run, `errors` those of samples taken for the full run at a point.
    `places` gives where points are (n_points, n_parameters), as `interpolation_weights` measures
    distances. Without another training run than that of the point there is no nearest one, and
    without two there is nothing to interpolate.
    """
    run_at = cache(sampled)
    near = {point: nearest(point, trained) for point in full}
    if all(other is not None for other in near.values()):
        each = [errors(point, run_at(other)) for point, other in near.items() if other is not None]
        yield NothingRow(NEAREST, mean_errors(each))
    others = {point: [other for other in trained if other != point] for point in full}
    if all(len(known) > 1 for known in others.values()):
        each = []
        for point, known in others.items():
            weights = spline_weights(places(known), places([point])[0])
            each.append(errors(point, interpolated([run_at(one) for one in known], weights)))
        yield NothingRow(INTERPOLATED, mean_errors(each))
    each = [errors(point, unchanged(samples)) for point, samples in full.items()]
    yield NothingRow(UNCHANGED, mean_errors(each))
