"""The comparison of models in a trade: rows of tables, gains, rivals, and the recommendation.

Alternatives without a model are training runs, the nearest one or interpolated ones, and a flow
that stays in its initial state. They take no time once the training runs exist. A model that is not
better than one of them, or than a full run that is as fast, is never recommended.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

from sphrom.arrays import Array
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import percent
from sphrom.compare.costs import break_even
from sphrom.errors import CaseError
from sphrom.metrics.histories import ERRORS, NO_ERRORS, QUANTITIES, Errors, mean_errors
from sphrom.metrics.measures import Samples
from sphrom.metrics.quantities import AXES, COEFFICIENT, MEASURABLE, component_names, is_vector
from sphrom.plots.tables import columns, format_figure
from sphrom.reduction.correction import spline_weights
from sphrom.setup.assembly import scaled_parameters
from sphrom.text import counted

SCATTER = 0.1
"""Relative difference below which seconds are equal, because repeated short runs differ so much."""
SECONDS = {"unit": "s"}
ESTIMATE = "measured_estimate"
OSCILLATION = ("frequency", "amplitude")
"""The quantities that rank models when the trade's measurement is an oscillation."""
PARTS = tuple(part for q in MEASURABLE if is_vector(q) for part in component_names(q, len(AXES)))
MEASURED = (
    *(
        f"measured_{q}_relative_l2{p}"
        for q in (*MEASURABLE, *PARTS, *OSCILLATION)
        for p in ("", "_peak")
    ),
    ESTIMATE,
)
"""Errors of the trade's measurement by quantity and component, and a model's own estimate."""
ERROR_COLUMNS = columns((*ERRORS, *MEASURED), "%")
NO_MEASURED: Errors = dict.fromkeys(MEASURED)
UNSTABLE: Errors = {**NO_ERRORS, **NO_MEASURED}
"""The errors of an unstable run."""
FRONTS = {
    "velocity": "velocity_front",
    "pressure": "pressure_front",
    **dict.fromkeys(MEASURABLE.keys() - {"velocity", "pressure"}, "measured_front"),
    **{name: f"{name}_front" for name in OSCILLATION},
}
"""Columns for membership of the Pareto front, by quantity."""
NEAREST = "nearest training run"
INTERPOLATED = "training runs, interpolated"
UNCHANGED = "the start, unchanged"


@dataclass(frozen=True, kw_only=True)
class RunRow:
    """One model at one parameter value."""

    model: str
    parameters: str
    role: str
    """`trained` at training values of its basis, `predicted` between them, else `extrapolated`."""
    status: str
    time_step: float = field(metadata=SECONDS)
    seconds: float | None = field(metadata=SECONDS)
    errors: Errors = field(metadata=ERROR_COLUMNS)


@dataclass(frozen=True, kw_only=True)
class ModelRow:
    """One model over all points: means of mean errors, and the largest of peak errors."""

    model: str
    family: str
    """The models of a family differ only in size and time step."""
    keys: str | None = None
    """The entry for `rom` in a case; None if there can be none, as with other steps."""
    kind: str
    """`full`, or `operators` for a reduced model."""
    n_modes: int | None = None
    resolution: int
    time_step: float = field(metadata=SECONDS)
    """The smallest time step of its runs."""
    stable: bool = True
    offline_seconds: float | None = field(default=0.0, metadata=SECONDS)
    """Time from the full runs to the model, spent once; None if unknown."""
    training_seconds: float | None = field(default=0.0, metadata=SECONDS)
    """Time of its training runs; None if unknown, as for imported ones."""
    online_seconds: float | None = field(metadata=SECONDS)
    """Time of one run, without reading and writing; None if unstable or unknown."""
    speed_up: float | None = None
    """Speed-up over the case's own full run."""
    break_even_runs: int | None = None
    """Number of runs from which it is cheaper than full runs; None if never or unknown."""
    beaten_by: str | None = None
    """An alternative that is as fast and as accurate: a full run, or one without a model."""
    fronts: Mapping[str, bool] = field(
        default_factory=lambda: dict.fromkeys(FRONTS.values(), False),
        metadata=columns(FRONTS.values()),
    )
    errors: Errors = field(metadata=ERROR_COLUMNS)

    @classmethod
    def of(cls, runs: Sequence[RunRow], **described: Any) -> ModelRow:
        """Return the row of a model from its runs, without gains."""
        seconds = [run.seconds for run in runs if run.seconds is not None]
        stable = len(seconds) == len(runs)
        return cls(
            model=runs[0].model,
            time_step=min(run.time_step for run in runs),
            stable=stable,
            online_seconds=sum(seconds) / len(seconds) if stable else None,
            errors=mean_errors([run.errors for run in runs]),
            **described,
        )


@dataclass(frozen=True)
class Alternative:
    """Errors without a model, over all points: means of mean errors, and the largest of peaks."""

    name: str
    errors: Errors = field(metadata=ERROR_COLUMNS)


@dataclass(frozen=True)
class Measure:
    """The errors that rank models."""

    probes: str
    measured: str | None = None
    """Name of a measurement whose error counts instead of those of the fields."""
    quantities: tuple[str, ...] = QUANTITIES
    """The quantities whose errors count."""
    n_dim: int = 2

    @classmethod
    def of_case(cls, case: Case) -> Measure:
        """Return the measure of the section `trade` of a case."""
        trade = case.trade
        if trade.measure is None:
            return cls(trade.probes)
        if trade.measure in case.plan.oscillations:
            return cls(trade.probes, trade.measure, OSCILLATION)
        # A torque may be zero except for noise, and a coefficient has the errors of its force.
        left_out = ("torque", COEFFICIENT)
        compared = (q for q in case.scene.measure[trade.measure].quantities if q not in left_out)
        n_dim = case.scene.domain.n_dim
        return cls(trade.probes, trade.measure, tuple(compared), n_dim)

    @property
    def parts(self) -> tuple[str, ...]:
        """The components of measured vectors, which a tolerance includes, too."""
        if self.measured is None:
            return ()
        vectors = filter(is_vector, self.quantities)
        return tuple(part for q in vectors for part in component_names(q, self.n_dim))

    def of(self, errors: Errors, quantity: str, *, peak: bool = False) -> float | None:
        """Return the error of a quantity [%], overall or at the worst time."""
        name = f"{quantity}_{self.probes}" if self.measured is None else f"measured_{quantity}"
        return errors[f"{name}_relative_l2{'_peak' if peak else ''}"]

    def nowhere_worse(self, errors: Errors, other: Errors) -> bool:
        """Return whether all errors are known and at most those of `other`."""
        pairs = [(self.of(errors, q), self.of(other, q)) for q in self.quantities]
        return all(a is not None and b is not None and a <= b for a, b in pairs)

    @property
    def words(self) -> str:
        """The name of the error in tables."""
        if self.quantities == OSCILLATION:
            return f"relative error of the oscillation {self.measured}"
        if self.measured is not None:
            return f"relative L2 error of {self.measured} over time"
        return f"relative L2 error over the {self.probes} and time"


def alternatives(
    case: Case,
    full: Mapping[ParameterPoint, Samples],
    sampled: Callable[[ParameterPoint], Samples],
    errors: Callable[[ParameterPoint, Samples], Errors],
) -> Iterator[Alternative]:
    """Yield the errors of alternatives without a model at the points of full runs.

    The nearest training run needs a training run at another point, and interpolation needs two.

    Parameters
    ----------
    sampled : returns the training run at a point.
    errors : returns the errors of samples that replace the full run at a point.
    """
    run_at = cache(sampled)
    trained = {p: [other for other in case.plan.train_points if other != p] for p in full}

    def nearest(point: ParameterPoint) -> Samples:
        offsets = scaled_parameters(case, trained[point]) - scaled_parameters(case, [point])
        return run_at(trained[point][int(np.linalg.norm(offsets, axis=1).argmin())])

    def interpolated(point: ParameterPoint) -> Samples:
        *places, place = scaled_parameters(case, [*trained[point], point])
        weights = spline_weights(np.array(places), place)
        return combined(weights, [run_at(other) for other in trained[point]])

    def unchanged(point: ParameterPoint) -> Samples:
        return full[point].at(np.zeros(len(full[point].time), np.int64))

    replacements = {
        NEAREST: (nearest, 1),
        INTERPOLATED: (interpolated, 2),
        UNCHANGED: (unchanged, 0),
    }
    for name, (replaced, least) in replacements.items():
        if all(len(points) >= least for points in trained.values()):
            yield Alternative(name, mean_errors([errors(p, replaced(p)) for p in full]))


def combined(weights: Array, runs: Sequence[Samples]) -> Samples:
    """Return the linear combination of runs with weights (n_runs,), at the times of the first."""
    return Samples(
        runs[0].time,
        np.tensordot(weights, [run.velocity for run in runs], 1),
        np.tensordot(weights, [run.pressure for run in runs], 1),
        {q: np.tensordot(weights, [r.measured[q] for r in runs], 1) for q in runs[0].measured},
    )


def weighed(
    rows: Sequence[ModelRow], without: Sequence[Alternative], measure: Measure
) -> list[ModelRow]:
    """Return rows with their gains, their Pareto fronts, and an alternative that beats them.

    The first row is the case's own full run, the reference of the others; it is on no front, and
    nothing beats it. Alternatives are those without a model, and stable full runs.
    """
    reference, *models = rows
    rivals = [(alternative.name, 0.0, alternative.errors) for alternative in without]
    for row in rows:
        if row.kind == "full" and row.online_seconds is not None:
            rivals.append((row.model, row.online_seconds, row.errors))

    def gains(row: ModelRow) -> ModelRow:
        if (seconds := row.online_seconds) is None:
            return row
        pays = break_even(row.offline_seconds, reference.online_seconds, seconds)
        as_fast = [r for r in rivals if r[0] != row.model and r[1] <= seconds]
        better = (name for name, _, errors in as_fast if measure.nowhere_worse(errors, row.errors))
        return replace(
            row,
            speed_up=reference.online_seconds and reference.online_seconds / seconds,
            break_even_runs=None if row.kind == "full" else pays,
            beaten_by=None if row is reference else next(better, None),
        )

    found = [gains(row) for row in models]
    for quantity in measure.quantities:
        costs = [(row.online_seconds, measure.of(row.errors, quantity)) for row in models]
        front = pareto_front([None if s is None or e is None else (s, e) for s, e in costs])
        name = FRONTS[quantity]
        found = [
            replace(row, fronts={**row.fronts, name: on_front})
            for row, on_front in zip(found, front, strict=True)
        ]
    return [gains(reference), *found]


def pareto_front(costs: Sequence[tuple[float, float] | None]) -> list[bool]:
    """Return whether each point is on the Pareto front of two costs, which are minimised.

    A point dominates another if it is no worse in both costs and better in one. A point with
    unknown costs, None, does not dominate others and is not on the front.
    """
    return [
        cost is not None
        and not any(
            other is not None and other != cost and other[0] <= cost[0] and other[1] <= cost[1]
            for other in costs
        )
        for cost in costs
    ]


@dataclass(frozen=True)
class Tolerance:
    """The largest errors that a user accepts [%]."""

    velocity: float
    pressure: float

    @classmethod
    def of_text(cls, text: str) -> Tolerance:
        """Parse one percentage, `1%`, or one for velocity and one for pressure, `0.5%,3%`.

        Raises CaseError for other texts.
        """
        values = [percent(part, "--tolerance") for part in text.split(",")]
        if len(values) > 2:
            raise CaseError(f"--tolerance: must be one percentage, or two: 0.5%,3%; got {text!r}")
        return cls(values[0], values[-1])

    def of(self, quantity: str) -> float:
        """Return the tolerance of a quantity [%]; all except pressure have that of velocity."""
        return self.pressure if quantity == "pressure" else self.velocity

    def used(self, errors: Errors, measure: Measure) -> float:
        """Return the largest ratio of an error to its tolerance; infinite if one is unknown.

        Components with only noise have no errors, and do not count.
        """
        pairs = [(measure.of(errors, q), self.of(q)) for q in measure.quantities]
        pairs += [
            (e, self.of(q)) for q in measure.parts if (e := measure.of(errors, q)) is not None
        ]
        return max(math.inf if error is None else error / allowed for error, allowed in pairs)


def recommend(
    rows: Sequence[ModelRow], without: Sequence[Alternative], tolerance: Tolerance, measure: Measure
) -> tuple[dict[str, Any], str]:
    """Return the recommended model within a tolerance, and the same as a sentence.

    The first row is the case's own full run. The recommended `model` is the fastest one that no
    alternative beats; of equally fast ones, it is the first to pay off, then the most accurate. The
    recommendation also has the fastest `full_run`, for few runs, the number of runs from which on
    the model is cheaper, and an alternative `without_a_model` within the tolerance. Each is None if
    there is none, or if it is unknown.
    """
    used = {row.model: tolerance.used(row.errors, measure) for row in rows}
    fit = [row for row in rows if used[row.model] <= 1.0]
    chosen = _cheapest([row for row in fit if row is not rows[0]], used)
    full = _cheapest([row for row in fit if row.kind == "full"], used)
    enough = [rival.name for rival in without if tolerance.used(rival.errors, measure) <= 1.0]
    pays = None
    if chosen is not None and full is not None and chosen.online_seconds is not None:
        pays = break_even(chosen.offline_seconds, full.online_seconds, chosen.online_seconds)
    advice = {
        "velocity_tolerance": tolerance.velocity,
        "pressure_tolerance": tolerance.pressure,
        "judged_by": measure.words,
        "model": None if chosen is None else chosen.model,
        "full_run": None if full is None else full.model,
        "pays_from_run": pays,
        "without_a_model": enough[0] if enough else None,
    }
    allowed = " and ".join(
        f"{tolerance.of(q):g} % of {q.replace('_', ' ')}" for q in measure.quantities
    )
    text = f"within {allowed} ({measure.words}), "
    if chosen is not None:
        text += f"the cheapest is {_described(chosen, advice, measure)}"
    elif beaten := [row for row in fit if row.beaten_by not in (None, rows[0].model)]:
        text += f"no model is better than {beaten[0].beaten_by}, which is as fast"
    else:
        faster = [row for row in rows[1:] if row.beaten_by is None]
        least = [_best(faster, q, measure) for q in measure.quantities]
        text += "only the case's own full run is within it; "
        if any(least):
            text += (
                f"the smallest error of a faster run is in {' and in '.join(filter(None, least))}"
            )
        else:
            text += "every other run is unstable, or no more accurate than one that is as fast"
    if enough:
        text += f"; without a model, {enough[0]} is within the tolerance, too"
    return advice, text


def _cheapest(rows: Sequence[ModelRow], used: Mapping[str, float]) -> ModelRow | None:
    """Of the fastest models that no alternative beats, return the first to pay off, or None."""
    timed = [(s, r) for r in rows if r.beaten_by is None and (s := r.online_seconds) is not None]
    most = (1.0 + SCATTER) * min((seconds for seconds, _ in timed), default=0.0)
    alike = (row for seconds, row in timed if seconds <= most)
    return min(alike, key=lambda row: (row.break_even_runs or 0, used[row.model]), default=None)


def _best(rows: Sequence[ModelRow], quantity: str, measure: Measure) -> str:
    """Return the least error of a quantity in words; nothing if all are unknown."""
    pairs = [(e, row.model) for row in rows if (e := measure.of(row.errors, quantity)) is not None]
    if not pairs:
        return ""
    error, model = min(pairs)
    return f"{quantity.replace('_', ' ')} that of {model}, {format_figure(error)} %"


def _described(chosen: ModelRow, advice: Mapping[str, Any], measure: Measure) -> str:
    errors = ", ".join(
        f"{q} {format_figure(error)} %"
        for q in (*measure.quantities, *measure.parts)
        if (error := measure.of(chosen.errors, q)) is not None
    )
    pace = chosen.speed_up and f"{format_figure(chosen.speed_up)} times faster than the full run"
    text = f"{chosen.model}: {errors}, {format_figure(chosen.online_seconds)} s a run, "
    text += pace or "and the time of the full run is unknown"
    if chosen.kind != "full" and advice["pays_from_run"] is not None:
        text += (
            "; including the cost of making it, it pays off from "
            f"{counted(advice['pays_from_run'], 'run')} on; for fewer, take {advice['full_run']}"
        )
    if chosen.keys is not None:
        text += f"; add it to a case by `- {chosen.keys}` under `rom`"
    return text
