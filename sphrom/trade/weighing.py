"""Models of a trade weighed: the rows of its tables, what a model gains, and the one to take.

Alternatives without a model are training runs, as they are or interpolated, and a flow that stays
as it starts. They take no time once the training runs are there. A model that is no better than one
of them, or slower and no better than a full run, is never recommended.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any

import numpy as np

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import percent
from sphrom.compare.costs import break_even
from sphrom.errors import CaseError
from sphrom.metrics.histories import ERRORS, NO_ERRORS, QUANTITIES, Errors, mean_errors
from sphrom.metrics.measures import UNITS
from sphrom.metrics.samples import Samples
from sphrom.plots.tables import columns, format_figure
from sphrom.reduction.correction import spline_weights
from sphrom.setup.assembly import scaled_parameters
from sphrom.text import counted

SCATTER = 0.1
"""Seconds that differ by less, relatively, are alike: repeats of a short run differ by so much."""
SECONDS = {"unit": "s"}
ESTIMATE = "measured_estimate"
OSCILLATION = ("frequency", "amplitude")
"""What models are judged by where a trade's measurement is of an oscillation."""
MEASURED = (
    *(f"measured_{q}_relative_l2{p}" for q in (*UNITS, *OSCILLATION) for p in ("", "_peak")),
    ESTIMATE,
)
"""Errors of the measurement that a case's trade is judged by, by quantity, and a model's own
estimate."""
ERROR_COLUMNS = columns((*ERRORS, *MEASURED), "%")
NO_MEASURED: Errors = dict.fromkeys(MEASURED)
UNSTABLE: Errors = {**NO_ERRORS, **NO_MEASURED}
"""The errors of an unstable run."""
FRONTS = {
    "velocity": "velocity_front",
    "pressure": "pressure_front",
    **dict.fromkeys(UNITS.keys() - {"velocity", "pressure"}, "measured_front"),
    **{name: f"{name}_front" for name in OSCILLATION},
}
"""Columns that tell whether no other model is both faster and better, by quantity."""
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
    errors: Errors = field(metadata=ERROR_COLUMNS)


@dataclass(frozen=True, kw_only=True)
class ModelRow:
    """One model over all values: means of mean errors, and the largest of peaks."""

    model: str
    family: str
    """The models of a family differ in size and time step alone."""
    keys: str | None = None
    """What a case lists under `rom` to have it; None where it can't, as with other steps."""
    kind: str
    """`full`, or the `evaluation` of a reduced model."""
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
    break_even_runs: int | None = None
    """Runs after which the full model would have taken longer; None if never, or unknown."""
    beaten_by: str | None = None
    """An alternative that is no slower and nowhere worse: a full run, or none at all."""
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
    """Errors without a model, over all values: means of mean errors, and the largest of peaks."""

    name: str
    errors: Errors = field(metadata=ERROR_COLUMNS)


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
        if trade.measure in case.scene.oscillations:
            return cls(trade.probes, trade.measure, OSCILLATION)
        # A torque may be zero but for noise.
        judged = (q for q in case.scene.measure[trade.measure].quantities if q != "torque")
        return cls(trade.probes, trade.measure, tuple(judged))

    def of(self, errors: Errors, quantity: str, *, peak: bool = False) -> float | None:
        """Return the error of a quantity [%], overall or at the worst instant."""
        name = f"{quantity}_{self.probes}" if self.measured is None else f"measured_{quantity}"
        return errors[f"{name}_relative_l2{'_peak' if peak else ''}"]

    def nowhere_worse(self, errors: Errors, other: Errors) -> bool:
        """Whether all errors are at most others; not where either has none."""
        pairs = [(self.of(errors, q), self.of(other, q)) for q in self.quantities]
        return all(a is not None and b is not None and a <= b for a, b in pairs)

    @property
    def words(self) -> str:
        """How a person reads it."""
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

    def nearest(point: ParameterPoint) -> Samples:
        ways = scaled_parameters(case, others[point]) - scaled_parameters(case, [point])
        return run_at(others[point][int(np.linalg.norm(ways, axis=1).argmin())])

    def interpolated(point: ParameterPoint) -> Samples:
        known = others[point]
        weights = spline_weights(
            scaled_parameters(case, known), scaled_parameters(case, [point])[0]
        )
        runs = [run_at(each) for each in known]

        def mixed(values: list[np.ndarray]) -> np.ndarray:
            return np.tensordot(weights, values, 1)

        return Samples(
            runs[0].time,
            mixed([run.velocity for run in runs]),
            mixed([run.pressure for run in runs]),
            {name: mixed([run.measured[name] for run in runs]) for name in runs[0].measured},
        )

    if all(others.values()):
        yield mean(NEAREST, nearest)
    if all(len(known) > 1 for known in others.values()):
        yield mean(INTERPOLATED, interpolated)
    yield mean(UNCHANGED, lambda point: full[point].at(np.zeros(len(full[point].time), np.int64)))


def weighed(
    rows: Sequence[ModelRow], without: Sequence[Alternative], measure: Measure
) -> list[ModelRow]:
    """Return rows with their gains, the Pareto fronts they are on, and what beats them.

    The case's own full run, the first row, which the others are compared with, takes no part in
    fronts and is beaten by none. Those that beat a model take no time, or are stable full runs.
    """
    own, *others = rows
    rivals = [(each.name, 0.0, each.errors) for each in without]
    for row in rows:
        if row.kind == "full" and row.online_seconds is not None:
            rivals.append((row.model, row.online_seconds, row.errors))
    fronts = dict.fromkeys(FRONTS.values(), [False] * len(others))
    for quantity in measure.quantities:
        costs = [(row.online_seconds, measure.of(row.errors, quantity)) for row in others]
        fronts[FRONTS[quantity]] = pareto_front(
            [None if s is None or e is None else (s, e) for s, e in costs]
        )

    def gains(row: ModelRow) -> ModelRow:
        if (seconds := row.online_seconds) is None:
            return row
        pays = break_even(row.offline_seconds, own.online_seconds, seconds)
        slower = (r for r in rivals if row is not own and r[0] != row.model and r[1] <= seconds)
        better = (name for name, _, e in slower if measure.nowhere_worse(e, row.errors))
        return replace(
            row,
            speed_up=None if own.online_seconds is None else own.online_seconds / seconds,
            break_even_runs=None if row.kind == "full" else pays,
            beaten_by=next(better, None),
        )

    on = [{name: front[k] for name, front in fronts.items()} for k in range(len(others))]
    placed = [replace(gains(row), fronts=each) for row, each in zip(others, on, strict=True)]
    return [gains(own), *placed]


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


@dataclass(frozen=True)
class Tolerance:
    """The errors that a user allows [%]."""

    velocity: float
    pressure: float

    @classmethod
    def of_text(cls, text: str) -> Tolerance:
        """Read `1%`, or one for velocity and one for pressure, `0.5%,3%`.

        Raises CaseError for anything else.
        """
        values = [percent(part, "--tolerance") for part in text.split(",")]
        if len(values) > 2:
            raise CaseError(f"--tolerance: is one percentage, or two: 0.5%,3%; got {text!r}")
        return cls(values[0], values[-1])

    def of(self, quantity: str) -> float:
        """Return what is allowed of a quantity [%]: other than pressure as of velocity."""
        return self.pressure if quantity == "pressure" else self.velocity

    def used(self, errors: Errors, measure: Measure) -> float:
        """Return the largest of the errors that count over what is allowed; infinite for none."""
        found = [(measure.of(errors, q), self.of(q)) for q in measure.quantities]
        return max(math.inf if error is None else error / allowed for error, allowed in found)


def recommend(
    rows: Sequence[ModelRow], without: Sequence[Alternative], tolerance: Tolerance, measure: Measure
) -> tuple[dict[str, Any], str]:
    """Return which model to take within a tolerance, and the same in words.

    The case's own full run is the first row. It is the cheapest `model` that is worth its seconds,
    of those as cheap the one that pays first, then the most accurate one; None where there is
    none. Beside it stand the cheapest `full_run`, for few runs, and how many
    runs make the model cheaper than that; None where these are unknown. `without_a_model` is the
    alternative without any run that is within the tolerance.
    """
    used = {row.model: tolerance.used(row.errors, measure) for row in rows}
    fit = [row for row in rows if used[row.model] <= 1.0]
    chosen = _cheapest([row for row in fit if row is not rows[0]], used)
    full = _cheapest([row for row in fit if row.kind == "full"], used)
    enough = [each.name for each in without if tolerance.used(each.errors, measure) <= 1.0]
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
        text += f"no model is better than {beaten[0].beaten_by}, which is no slower"
    else:
        faster = [row for row in rows[1:] if row.beaten_by is None]
        text += "there is only the case's own full run; what is faster is farther off, least in "
        text += " and in ".join(_best(faster, q, measure) for q in measure.quantities)
    if enough:
        text += f"; without any model, {enough[0]} is within it too"
    return advice, text


def _cheapest(rows: Sequence[ModelRow], used: Mapping[str, float]) -> ModelRow | None:
    """Return the model that pays first of the fastest ones that no alternative beats, if any."""
    known = [(s, r) for r in rows if r.beaten_by is None and (s := r.online_seconds) is not None]
    most = (1.0 + SCATTER) * min((seconds for seconds, _ in known), default=0.0)
    alike = (row for seconds, row in known if seconds <= most)
    return min(alike, key=lambda row: (row.break_even_runs or 0, used[row.model]), default=None)


def _best(rows: Sequence[ModelRow], quantity: str, measure: Measure) -> str:
    found = [(e, row.model) for row in rows if (e := measure.of(row.errors, quantity)) is not None]
    error, model = min(found, default=(None, "no run"))
    return f"{quantity.replace('_', ' ')} {model}, by {format_figure(error)} %"


def _described(chosen: ModelRow, advice: Mapping[str, Any], measure: Measure) -> str:
    errors = ", ".join(
        f"{q} {format_figure(measure.of(chosen.errors, q))} %" for q in measure.quantities
    )
    pace = chosen.speed_up and f"{format_figure(chosen.speed_up)} times faster than the full run"
    text = f"{chosen.model}: {errors}, {format_figure(chosen.online_seconds)} s a run, "
    text += pace or "and the time of the full run is unknown"
    if chosen.kind != "full" and advice["pays_from_run"] is not None:
        text += (
            "; counting the cost of making it, it pays from "
            f"{counted(advice['pays_from_run'], 'run')} on; for fewer take {advice['full_run']}"
        )
    if chosen.keys is not None:
        text += f"; a case has it by `- {chosen.keys}` under `rom`"
    return text
