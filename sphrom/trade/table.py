"""The table of a trade: rows, the Pareto front, break-even numbers, and a recommendation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

from sphrom.compare.error_rows import NO_ERRORS, Errors
from sphrom.errors import CaseError

PERCENT, SECONDS = {"unit": "%"}, {"unit": "s"}
QUANTITIES = ("velocity", "pressure")


@dataclass(frozen=True)
class Estimates:
    """What a reduced run estimates its errors to be, and what they are in the same norm.

    Root mean squares over the grid and time, relative to the full run's; see
    `sphrom.compare.effectivity`. None where errors are not estimated.
    """

    velocity_estimate: float | None = field(default=None, metadata=PERCENT)
    velocity_rms_error: float | None = field(default=None, metadata=PERCENT)
    pressure_estimate: float | None = field(default=None, metadata=PERCENT)
    pressure_rms_error: float | None = field(default=None, metadata=PERCENT)


NO_ESTIMATES = Estimates()


@dataclass(frozen=True)
class Run:
    """What a run was, and what it took."""

    model: str
    parameters: str
    role: str
    """`trained` where a reduced model's basis learnt from the value, `predicted` between such
    values, else `extrapolated`."""
    status: str
    time_step: float = field(metadata=SECONDS)
    seconds: float | None = field(metadata=SECONDS)


@dataclass(frozen=True)
class RunRow(Estimates, Errors, Run):
    """One model at one parameter value; what it was comes first, its errors last."""


@dataclass(frozen=True)
class Model:
    """What a model is, and what it costs."""

    model: str
    family: str
    """What its name says beside its size and step: those of a family differ in these alone."""
    kind: str
    """`full`, or the `evaluation` of a reduced model."""
    inner_product: str | None
    basis: str | None
    projection: str | None
    calibrated: bool | None
    n_modes: int | None
    resolution: int
    time_step: float = field(metadata=SECONDS)
    """The smallest of its runs."""
    stable: bool
    offline_seconds: float | None = field(metadata=SECONDS)
    """From the full runs to the model, which must be spent once; None where nobody knows."""
    training_seconds: float | None = field(metadata=SECONDS)
    """The full runs that it learns from; None where nobody knows, as of imported ones."""
    online_seconds: float | None = field(metadata=SECONDS)
    """Of one run, without what is written and read; None if unstable, or where nobody knows."""
    speed_up: float | None
    """Over the full run at the case's own step."""
    speed_up_largest_step: float | None
    """Over the fastest stable full run at the case's resolution."""
    break_even_runs: int | None
    """Runs after which the full model would have taken longer; None if never, or unknown."""
    beaten_by: str | None
    """What is no slower and nowhere worse: a full run, or doing nothing."""
    velocity_front: bool
    """Whether no other model is both faster and better."""
    pressure_front: bool


@dataclass(frozen=True)
class ModelRow(Estimates, Errors, Model):
    """One model over all values: means of mean errors and estimates, and the largest of peaks."""


@dataclass(frozen=True)
class Measure:
    """Which of the errors models are judged by."""

    probes: str
    statistic: str

    def of(self, row: Errors, quantity: str) -> float | None:
        """Return the velocity or pressure error of a row [%]."""
        peak = "_peak" if self.statistic == "peak" else ""
        value = getattr(row, f"{quantity}_{self.probes}_relative_l2{peak}")
        return None if value is None else float(value)

    @property
    def words(self) -> str:
        """How a person reads it."""
        where = "on the line" if self.probes == "line" else "over the field"
        when = "at the worst instant" if self.statistic == "peak" else "and time"
        return f"relative L2 error {where} {when}"


def combined(rows: Sequence[RunRow]) -> Errors:
    """Return the errors of a model over its runs; none where one of them was unstable."""
    return NO_ERRORS if any(row.status != "complete" for row in rows) else mean_errors(rows)


def mean_errors(each: Sequence[Errors]) -> Errors:
    """Return means of errors that all are there, and the largest of peaks."""
    values: dict[str, float | None] = {}
    for part in fields(Errors):
        found = [getattr(errors, part.name) for errors in each]
        whole = max(found) if part.name.endswith("peak") else sum(found) / len(found)
        values[part.name] = float(whole)
    return Errors(**values)


def combined_estimates(rows: Sequence[RunRow]) -> Estimates:
    """Return a model's estimates over its runs; none where one of them has none."""
    values: dict[str, float | None] = {}
    for part in fields(Estimates):
        each = [getattr(row, part.name) for row in rows]
        values[part.name] = None if None in each else float(sum(each) / len(each))
    return Estimates(**values)


def pareto_front(costs: Sequence[tuple[float, float] | None]) -> list[bool]:
    """Return which points are dominated by no other, of costs that are the better the lower.

    A point dominates another when it is no worse in both and better in one. None is no point.
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
    """Return rows that say whether they are on the fronts of seconds against either error."""
    fronts = {
        quantity: pareto_front([_cost(row, measure.of(row, quantity)) for row in rows])
        for quantity in QUANTITIES
    }
    return [
        replace(row, velocity_front=velocity, pressure_front=pressure)
        for row, velocity, pressure in zip(rows, *fronts.values(), strict=True)
    ]


def _cost(row: ModelRow, error: float | None) -> tuple[float, float] | None:
    if error is None or row.online_seconds is None:
        return None
    return row.online_seconds, error


def break_even(once: float | None, full_seconds: float | None, online_seconds: float) -> int | None:
    """Return the least number of runs from which a model that costs `once` [s] is the cheaper.

    None when it never is, or a cost is unknown.
    """
    if once is None or full_seconds is None:
        return None
    gain = full_seconds - online_seconds
    if gain <= 0.0:
        return None
    return max(1, math.ceil(once / gain))


@dataclass(frozen=True)
class Tolerance:
    """The errors that a user allows [%]."""

    velocity: float
    pressure: float
    one_for_both: bool = False
    """Whether one was given, which stands for both."""

    @property
    def words(self) -> str:
        """How a person reads it."""
        if self.one_for_both:
            return f"{self.velocity:g} % of velocity and of pressure alike, as one tolerance says"
        return f"{self.velocity:g} % of velocity and {self.pressure:g} % of pressure"


def parse_tolerance(text: str) -> Tolerance:
    """Read `1%`, or one for velocity and one for pressure, `0.5%,3%`.

    Raises CaseError for anything else.
    """
    parts = [part.strip().removesuffix("%").strip() for part in text.split(",")]
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or not all(math.isfinite(v) and v > 0.0 for v in values):
        raise CaseError(
            "--tolerance: must be a percentage above zero, such as 1%, or one for velocity and one "
            f"for pressure, such as 0.5%,3%; got {text!r}"
        )
    return Tolerance(values[0], values[-1], one_for_both=len(values) == 1)


def within(row: Errors, tolerance: Tolerance, measure: Measure) -> bool:
    """Whether a row's errors are all within a tolerance; not where it has none."""
    velocity, pressure = (measure.of(row, quantity) for quantity in QUANTITIES)
    if velocity is None or pressure is None:
        return False
    return velocity <= tolerance.velocity and pressure <= tolerance.pressure


def cheapest(rows: Sequence[ModelRow], tolerance: Tolerance, measure: Measure) -> ModelRow | None:
    """Return the fastest model within a tolerance that nothing beats, if there is one."""
    fit = [
        (row.online_seconds, row)
        for row in rows
        if row.online_seconds is not None
        and row.beaten_by is None
        and within(row, tolerance, measure)
    ]
    return min(fit, key=lambda pair: pair[0])[1] if fit else None


def most_accurate(rows: Sequence[ModelRow], quantity: str, measure: Measure) -> ModelRow | None:
    """Return the stable model with the least error of a quantity, if any is stable."""
    found = [(error, row) for row in rows if (error := measure.of(row, quantity)) is not None]
    return min(found, key=lambda pair: pair[0])[1] if found else None
