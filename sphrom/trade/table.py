"""The rows of a trade's tables: models, their runs, and the alternatives without a model.

Alternatives are training runs, as they are or interpolated, and a flow that stays as it starts.
They take no time once the training runs are there. A model that is no better than one of them, or
slower and no better than a full run, is never recommended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint, nearest_point
from sphrom.compare.costs import break_even
from sphrom.metrics.histories import ERRORS, NO_ERRORS, QUANTITIES, Errors, mean_errors
from sphrom.metrics.measures import UNITS
from sphrom.metrics.samples import Samples
from sphrom.plots.tables import columns
from sphrom.reduction.correction import spline_weights
from sphrom.setup.assembly import places_of

SECONDS = {"unit": "s"}
MEASURED = tuple(f"measured_{q}_relative_l2{peak}" for q in UNITS for peak in ("", "_peak"))
"""Errors of the measurement that a case's trade is judged by, by quantity."""
TRADE_ERRORS = (*ERRORS, *MEASURED)
NO_MEASURED: Errors = dict.fromkeys(MEASURED)
UNSTABLE: Errors = {**NO_ERRORS, **NO_MEASURED}
"""The errors of an unstable run."""
NEAREST = "nearest training run"
INTERPOLATED = "training runs, interpolated"
UNCHANGED = "the start, unchanged"


@dataclass(frozen=True, kw_only=True)
class RunRow:
    """One model at one parameter value."""

    model: str
    parameters: str
    role: str
    """`trained` where a reduced model's basis learnt from the value, `predicted` between such
    values, else `extrapolated`."""
    status: str
    time_step: float = field(metadata=SECONDS)
    seconds: float | None = field(metadata=SECONDS)
    errors: Errors = field(metadata=columns(TRADE_ERRORS, "%"))


@dataclass(frozen=True, kw_only=True)
class ModelRow:
    """One model over all values: means of mean errors, and the largest of peaks."""

    model: str
    family: str
    """The models of a family differ in size and time step alone."""
    kind: str
    """`full`, or the `evaluation` of a reduced model."""
    basis: str | None = None
    projection: str | None = None
    calibrated: bool | None = None
    n_modes: int | None = None
    resolution: int
    time_step: float = field(metadata=SECONDS)
    """The smallest of its runs."""
    stable: bool = True
    offline_seconds: float | None = field(default=0.0, metadata=SECONDS)
    """From the full runs to the model, which must be spent once; None where nobody knows."""
    training_seconds: float | None = field(default=0.0, metadata=SECONDS)
    """The full runs that it learns from; None where nobody knows, as of imported ones."""
    online_seconds: float | None = field(metadata=SECONDS)
    """Of one run, without reading and writing; None if unstable, or where nobody knows."""
    speed_up: float | None = None
    """Over the full run at the case's own step."""
    speed_up_largest_step: float | None = None
    """Over the fastest stable full run at the case's resolution."""
    break_even_runs: int | None = None
    """Runs after which the full model would have taken longer; None if never, or unknown."""
    beaten_by: str | None = None
    """An alternative that is no slower and nowhere worse: a full run, or none at all."""
    velocity_front: bool = False
    """Whether no other model is both faster and better."""
    pressure_front: bool = False
    measured_front: bool = False
    """The same of the force or the flow rate that models are judged by."""
    errors: Errors = field(metadata=columns(TRADE_ERRORS, "%"))


@dataclass(frozen=True)
class Alternative:
    """Errors without a model, over all values: means of mean errors, and the largest of peaks."""

    name: str
    errors: Errors = field(metadata=columns(TRADE_ERRORS, "%"))


@dataclass(frozen=True)
class Measure:
    """Which of the errors models are judged by."""

    probes: str
    measured: str | None = None
    """The name of a measurement, where its error counts and not the fields'."""
    quantities: tuple[str, ...] = QUANTITIES
    """The fields whose errors count: velocity, pressure or both."""

    @classmethod
    def of_case(cls, case: Case) -> Measure:
        """Return what the section `trade` of a case judges by."""
        trade = case.trade
        if trade.measure is None:
            return cls(trade.probes)
        section = case.scene.measure[trade.measure]
        # A torque may be zero but for noise.
        judged = tuple(q for q in section.quantities if q != "torque") or QUANTITIES
        return cls(trade.probes, trade.measure, judged)

    def of(self, errors: Errors, quantity: str, *, peak: bool = False) -> float | None:
        """Return the error of a quantity [%], overall or at the worst instant."""
        name = f"{quantity}_{self.probes}" if self.measured is None else f"measured_{quantity}"
        return errors[f"{name}_relative_l2{'_peak' if peak else ''}"]

    def all_of(self, errors: Errors) -> tuple[float, ...] | None:
        """Return the errors of all quantities [%], None where there are none."""
        found = [self.of(errors, quantity) for quantity in self.quantities]
        known = tuple(error for error in found if error is not None)
        return known if len(known) == len(found) else None

    def no_worse(self, errors: Errors, other: Errors, quantity: str) -> bool:
        """Whether errors of a quantity are at most others; not where either has none."""
        first, second = self.of(errors, quantity), self.of(other, quantity)
        return first is not None and second is not None and first <= second

    @property
    def where(self) -> str:
        """The probes, or the measurement, in words."""
        if self.measured is not None:
            return f"of {self.measured}"
        return "on the line" if self.probes == "line" else "over the field"

    @property
    def words(self) -> str:
        """How a person reads it."""
        over = "and time" if self.measured is None else "over time"
        return f"relative L2 error {self.where} {over}"


def model_row(runs: Sequence[RunRow], **described: Any) -> ModelRow:
    """Return the row of a model from its runs, without gains."""
    seconds = [run.seconds for run in runs if run.seconds is not None]
    stable = len(seconds) == len(runs)
    return ModelRow(
        model=runs[0].model,
        time_step=min(run.time_step for run in runs),
        stable=stable,
        online_seconds=sum(seconds) / len(seconds) if stable else None,
        errors=mean_errors([run.errors for run in runs]),
        **described,
    )


def alternatives(
    case: Case,
    full: Mapping[ParameterPoint, Samples],
    sampled: Callable[[ParameterPoint], Samples],
    errors: Callable[[ParameterPoint, Samples], Errors],
) -> Iterator[Alternative]:
    """Yield the errors without a model at the points of full runs.

    Without another training run than that of the point there is no nearest one, and without two
    there is nothing to interpolate.

    Parameters
    ----------
    sampled : gives the training run at a point.
    errors : gives those of samples that are taken for the full run at a point.
    """
    run_at = cache(sampled)
    others = {point: [each for each in case.plan.train_points if each != point] for point in full}

    def mean(name: str, taken: Callable[[ParameterPoint], Samples]) -> Alternative:
        return Alternative(name, mean_errors([errors(point, taken(point)) for point in full]))

    def interpolated(point: ParameterPoint) -> Samples:
        known = others[point]
        weights = spline_weights(places_of(case, known), places_of(case, [point])[0])
        runs = [run_at(each) for each in known]
        velocity = np.tensordot(weights, [run.velocity for run in runs], 1)
        pressure = np.tensordot(weights, [run.pressure for run in runs], 1)
        return Samples(runs[0].time, velocity, pressure)

    if all(others.values()):
        yield mean(NEAREST, lambda point: run_at(nearest(point, others[point])))
    if all(len(known) > 1 for known in others.values()):
        yield mean(INTERPOLATED, interpolated)
    yield mean(UNCHANGED, lambda point: full[point].at(np.zeros(len(full[point].time), np.int64)))


def nearest(point: ParameterPoint, known: Sequence[ParameterPoint]) -> ParameterPoint:
    """Return the nearest of some points: by the ratio of Reynolds numbers, if that is all.

    With several parameters each counts over its largest value.
    """
    if point.others:
        return nearest_point(point, known)
    return min(known, key=lambda other: abs(np.log(other.reynolds / point.reynolds)))


def with_gains(rows: Sequence[ModelRow], own_seconds: float | None) -> list[ModelRow]:
    """Return rows with their gains over full runs; `own_seconds` of the case's, None if unknown.

    The largest stable step is that of the fastest full run at the case's resolution, which is that
    of the first row.
    """
    full = [row for row in rows if row.kind == "full" and row.resolution == rows[0].resolution]
    known = [row.online_seconds for row in full if row.online_seconds is not None]
    fastest = min(known, default=None)

    def gains(row: ModelRow) -> ModelRow:
        if (seconds := row.online_seconds) is None:
            return row
        pays = break_even(row.offline_seconds, own_seconds, seconds)
        return replace(
            row,
            speed_up=None if own_seconds is None else own_seconds / seconds,
            speed_up_largest_step=None if fastest is None else fastest / seconds,
            break_even_runs=None if row.kind == "full" else pays,
        )

    return list(map(gains, rows))


def with_beaten(
    rows: Sequence[ModelRow], without: Sequence[Alternative], measure: Measure
) -> list[ModelRow]:
    """Return rows that name the alternative that is no slower and nowhere worse, if there is one.

    Alternatives take no time, or are stable full runs. The case's own full run, the first row, is
    compared with none.
    """
    others = [(each.name, 0.0, each.errors) for each in without]
    for row in rows:
        if row.kind == "full" and row.stable and row.online_seconds is not None:
            others.append((row.model, row.online_seconds, row.errors))

    def beaten_by(row: ModelRow) -> str | None:
        for name, seconds, errors in others:
            if (
                name != row.model
                and row.online_seconds is not None
                and seconds <= row.online_seconds
                and all(measure.no_worse(errors, row.errors, q) for q in measure.quantities)
            ):
                return name
        return None

    return [rows[0], *(replace(row, beaten_by=beaten_by(row)) for row in rows[1:])]


def pareto_front(costs: Sequence[tuple[float, float] | None]) -> list[bool]:
    """Return which points no other dominates, given two costs of each, to be minimised.

    A point dominates another when it is no worse in both and better in one. None is a point whose
    costs are unknown: it neither dominates nor is on the front.
    """
    return [
        cost is not None
        and not any(
            other is not None and other != cost and other[0] <= cost[0] and other[1] <= cost[1]
            for other in costs
        )
        for cost in costs
    ]


def with_fronts(rows: Sequence[ModelRow], measure: Measure) -> list[ModelRow]:
    """Return rows marked where they are on the fronts of seconds against either error.

    The case's own full run, the first row, which the others are compared with, takes no part.
    """
    own, *others = rows
    for quantity in measure.quantities:
        pairs = [(row.online_seconds, measure.of(row.errors, quantity)) for row in others]
        front = pareto_front([None if s is None or e is None else (s, e) for s, e in pairs])
        for k, on_front in enumerate(front):
            marked: dict[str, Any] = {front_name(quantity): on_front}
            others[k] = replace(others[k], **marked)
    return [own, *others]


def front_name(quantity: str) -> str:
    """Return the field of a row that tells whether it is on the front of a quantity."""
    return f"{quantity}_front" if quantity in QUANTITIES else "measured_front"
