"""What a user has without a model: a training run, or a flow that never changes.

Both take no time once the training runs are there. A model that is no better than one of them, or
slower and no better than a full run, is never recommended.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sphrom.case.points import ParameterPoint
from sphrom.compare.error_rows import Errors
from sphrom.store.sampling import Samples
from sphrom.trade.table import QUANTITIES, Measure, ModelRow, mean_errors

NEAREST = "nearest training run"
UNCHANGED = "the start, unchanged"


@dataclass(frozen=True)
class Without:
    """How a flow is had without a model."""

    name: str


@dataclass(frozen=True)
class NothingRow(Errors, Without):
    """Its errors over all values: means of mean errors, and the largest of peaks."""


@dataclass(frozen=True)
class Alternative:
    """What a model must beat."""

    name: str
    seconds: float
    """Of a run [s]."""
    errors: Errors


def nearest(point: ParameterPoint, trained: Iterable[ParameterPoint]) -> ParameterPoint | None:
    """Return the trained value nearest to a point, by their ratio; None where it has no other."""
    others = [other for other in trained if other != point]
    return min(others, key=lambda o: abs(math.log(o.reynolds / point.reynolds)), default=None)


def unchanged(samples: Samples) -> Samples:
    """Return a flow that stays at its first snapshot."""
    first = np.zeros(len(samples.time), dtype=int)
    return Samples(samples.time, samples.velocity[first], samples.pressure[first])


def nothing_rows(
    full: dict[ParameterPoint, Samples],
    trained: Sequence[ParameterPoint],
    sampled: Callable[[ParameterPoint], Samples],
    errors: Callable[[ParameterPoint, Samples], Errors],
) -> Iterator[NothingRow]:
    """Yield the errors of doing nothing at the points of full runs.

    `sampled` gives a training run, `errors` those of samples taken for the full run at a point.
    Without another training run than that of the point there is no nearest one.
    """
    near = {point: nearest(point, trained) for point in full}
    if all(other is not None for other in near.values()):
        runs = {other: sampled(other) for other in near.values() if other is not None}
        each = [errors(point, runs[other]) for point, other in near.items() if other is not None]
        yield NothingRow(NEAREST, **vars(mean_errors(each)))
    each = [errors(point, unchanged(samples)) for point, samples in full.items()]
    yield NothingRow(UNCHANGED, **vars(mean_errors(each)))


def alternatives(full: Sequence[ModelRow], nothing: Sequence[NothingRow]) -> list[Alternative]:
    """Return what models must beat: full runs whose seconds are known, and doing nothing."""
    runs = [
        Alternative(row.model, row.online_seconds, row)
        for row in full
        if row.stable and row.online_seconds is not None
    ]
    return [*(Alternative(row.name, 0.0, row) for row in nothing), *runs]


def with_beaten(
    rows: Sequence[ModelRow], others: Sequence[Alternative], measure: Measure
) -> list[ModelRow]:
    """Return rows that say which alternative is no slower and nowhere worse, if one is."""
    return [
        replace(row, beaten_by=next((o.name for o in others if _beats(o, row, measure)), None))
        for row in rows
    ]


def _beats(other: Alternative, row: ModelRow, measure: Measure) -> bool:
    if other.name == row.model or row.online_seconds is None or other.seconds > row.online_seconds:
        return False
    return all(no_worse(other.errors, row, quantity, measure) for quantity in QUANTITIES)


def no_worse(errors: Errors, row: Errors, quantity: str, measure: Measure) -> bool:
    """Whether errors of a quantity are at most those of a row; not where either has none."""
    first, second = measure.of(errors, quantity), measure.of(row, quantity)
    return first is not None and second is not None and first <= second
