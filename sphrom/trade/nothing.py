"""The alternatives without a model: a training run, or a flow that never changes.

Both take no time once the training runs are there. A model that is no better than one of them, or
slower and no better than a full run, is never recommended.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np

from sphrom.case.points import ParameterPoint, nearest_point
from sphrom.metrics.histories import Errors, mean_errors
from sphrom.metrics.samples import Samples
from sphrom.trade.table import NothingRow

NEAREST = "nearest training run"
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


def nothing_rows(
    full: dict[ParameterPoint, Samples],
    trained: Sequence[ParameterPoint],
    sampled: Callable[[ParameterPoint], Samples],
    errors: Callable[[ParameterPoint, Samples], Errors],
) -> Iterator[NothingRow]:
    """Yield the errors without a model at the points of full runs.

    `sampled` gives a training run, `errors` those of samples taken for the full run at a point.
    Without another training run than that of the point there is no nearest one.
    """
    near = {point: nearest(point, trained) for point in full}
    if all(other is not None for other in near.values()):
        runs = {other: sampled(other) for other in near.values() if other is not None}
        each = [errors(point, runs[other]) for point, other in near.items() if other is not None]
        yield NothingRow(NEAREST, mean_errors(each))
    each = [errors(point, unchanged(samples)) for point, samples in full.items()]
    yield NothingRow(UNCHANGED, mean_errors(each))
