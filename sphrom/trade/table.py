"""The rows of a trade's tables: models, their runs, and the alternatives without a model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from sphrom.case.models import Case
from sphrom.metrics.fronts import break_even, pareto_front
from sphrom.metrics.histories import ERRORS, NO_ERRORS, QUANTITIES, Errors, mean_errors
from sphrom.metrics.measures import UNITS
from sphrom.plots.tables import columns

SECONDS = {"unit": "s"}
ESTIMATES = {
    f"{quantity}_{name}": figure
    for quantity in QUANTITIES
    for name, figure in (
        ("estimate", f"{quantity}_estimate"),
        ("rms_error", f"{quantity}_error"),
    )
}
"""Estimated and true errors of reduced runs in one norm, by their names in `effectivity`.

Root mean squares over the grid and time, relative to the full run's.
"""
MEASURED = tuple(f"measured_{q}_relative_l2{peak}" for q in UNITS for peak in ("", "_peak"))
"""Errors of the measurement that a case's trade is judged by, by quantity."""
TRADE_ERRORS = (*ERRORS, *MEASURED)
NO_MEASURED: Errors = dict.fromkeys(MEASURED)
NO_ESTIMATES: Errors = dict.fromkeys(ESTIMATES)


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
    estimates: Errors = field(metadata=columns(ESTIMATES, "%"))
    """None where errors are not estimated."""


@dataclass(frozen=True, kw_only=True)
class ModelRow:
    """One model over all values: means of mean errors and estimates, and the largest of peaks."""

    model: str
    family: str
    """The models of a family differ in size and time step alone."""
    kind: str
    """`full`, or the `evaluation` of a reduced model."""
    inner_product: str | None = None
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
    estimates: Errors = field(
        default_factory=lambda: NO_ESTIMATES, metadata=columns(ESTIMATES, "%")
    )


@dataclass(frozen=True)
class NothingRow:
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


def run_row(
    model: str,
    parameters: str,
    role: str,
    time_step: float,
    seconds: float | None,
    errors: Errors | None,
    estimates: Errors = NO_ESTIMATES,
) -> RunRow:
    """Return the row of a run; `errors` are None where it became unstable."""
    return RunRow(
        model=model,
        parameters=parameters,
        role=role,
        status="unstable" if errors is None else "complete",
        time_step=time_step,
        seconds=seconds,
        errors={**NO_ERRORS, **NO_MEASURED} if errors is None else errors,
        estimates=estimates,
    )


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
        estimates=mean_errors([run.estimates for run in runs]),
        **described,
    )


def with_gains(rows: Sequence[ModelRow], own_seconds: float | None) -> list[ModelRow]:
    """Return rows with their gains over full runs; `own_seconds` of the case's, None if unknown.

    The largest stable step is that of the fastest full run at the case's resolution, which is that
    of the first row.
    """
    full = [row for row in rows if row.kind == "full" and row.resolution == rows[0].resolution]
    known = [row.online_seconds for row in full if row.online_seconds is not None]
    return [_with_gains(row, own_seconds, min(known, default=None)) for row in rows]


def _with_gains(row: ModelRow, own_seconds: float | None, fastest: float | None) -> ModelRow:
    seconds = row.online_seconds
    if seconds is None:
        return row
    runs = None
    if row.kind != "full":
        runs = break_even(row.offline_seconds, own_seconds, seconds)
    return replace(
        row,
        speed_up=None if own_seconds is None else own_seconds / seconds,
        speed_up_largest_step=None if fastest is None else fastest / seconds,
        break_even_runs=runs,
    )


def with_beaten(
    rows: Sequence[ModelRow], nothing: Sequence[NothingRow], measure: Measure
) -> list[ModelRow]:
    """Return rows that name the alternative that is no slower and nowhere worse, if there is one.

    Alternatives take no time, or are stable full runs. The case's own full run, the first row, is
    compared with none.
    """
    others = [(row.name, 0.0, row.errors) for row in nothing]
    others += [
        (row.model, row.online_seconds, row.errors)
        for row in rows
        if row.kind == "full" and row.stable and row.online_seconds is not None
    ]

    def beaten_by(row: ModelRow) -> str | None:
        for name, seconds, errors in others:
            slower = row.online_seconds is not None and seconds <= row.online_seconds
            if (
                name != row.model
                and slower
                and all(no_worse(errors, row.errors, q, measure) for q in measure.quantities)
            ):
                return name
        return None

    return [rows[0], *(replace(row, beaten_by=beaten_by(row)) for row in rows[1:])]


def no_worse(errors: Errors, other: Errors, quantity: str, measure: Measure) -> bool:
    """Whether errors of a quantity are at most others; not where either has none."""
    first, second = measure.of(errors, quantity), measure.of(other, quantity)
    return first is not None and second is not None and first <= second


def with_fronts(rows: Sequence[ModelRow], measure: Measure) -> list[ModelRow]:
    """Return rows marked where they are on the fronts of seconds against either error.

    The case's own full run, the first row, which the others are compared with, takes no part.
    """

    def front(quantity: str) -> list[bool]:
        pairs = [(row.online_seconds, measure.of(row.errors, quantity)) for row in rows[1:]]
        return pareto_front([None if s is None or e is None else (s, e) for s, e in pairs])

    names = [front_name(quantity) for quantity in measure.quantities]
    marked = [
        replace(row, **dict(zip(names, on_fronts, strict=True)))
        for row, *on_fronts in zip(rows[1:], *map(front, measure.quantities), strict=True)
    ]
    return [rows[0], *marked]


def front_name(quantity: str) -> str:
    """Return the field of a row that tells whether it is on the front of a quantity."""
    return f"{quantity}_front" if quantity in QUANTITIES else "measured_front"
