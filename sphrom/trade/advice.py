"""The model to take within a tolerance, and the models that gain nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from sphrom.compare.costs import break_even
from sphrom.errors import CaseError
from sphrom.metrics.histories import Errors
from sphrom.plots.tables import format_figure
from sphrom.text import counted
from sphrom.trade.table import Alternative, Measure, ModelRow

MOST_NAMES = 6
"""Models that one line names."""


@dataclass(frozen=True)
class Tolerance:
    """The errors that a user allows [%]."""

    velocity: float
    pressure: float
    one_for_both: bool = False
    """Whether the user gave one for both."""

    def of(self, quantity: str) -> float:
        """Return what is allowed of a quantity [%]: other than pressure as of velocity."""
        return self.pressure if quantity == "pressure" else self.velocity

    def words(self, quantities: Sequence[str]) -> str:
        """Return how a person reads it, of the quantities that count."""
        if len(quantities) == 1:
            return f"{self.velocity:g} % of {quantities[0].replace('_', ' ')}"
        if self.one_for_both:
            return f"{self.velocity:g} % of velocity and of pressure alike, as one tolerance says"
        return f"{self.velocity:g} % of velocity and {self.pressure:g} % of pressure"

    def allows(self, errors: Errors, measure: Measure) -> bool:
        """Whether the errors that count are within; not where there are none."""
        found = measure.all_of(errors)
        return found is not None and all(
            error <= self.of(quantity)
            for error, quantity in zip(found, measure.quantities, strict=True)
        )


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


@dataclass(frozen=True)
class Recommendation:
    """The cheapest model within a tolerance; None where there is none worth its seconds."""

    velocity_tolerance: float
    pressure_tolerance: float
    one_tolerance_for_both: bool
    judged_by: str
    model: str | None
    full_run: str | None
    """The cheapest full run within the tolerance, for few runs; None where that is unknown."""
    pays_from_run: int | None
    """How many runs make the model cheaper than that; None where that is unknown."""
    without_a_model: str | None
    """The alternative without any run that is within the tolerance, where there is one."""


def recommend(
    rows: Sequence[ModelRow],
    without: Sequence[Alternative],
    tolerance: Tolerance,
    measure: Measure,
) -> Recommendation:
    """Return which model to take within a tolerance; the case's own full run is the first row."""
    own, *others = rows
    chosen = cheapest(others, tolerance, measure)
    full = cheapest([own, *(row for row in others if row.kind == own.kind)], tolerance, measure)
    enough = [row.name for row in without if tolerance.allows(row.errors, measure)]
    pays = None
    if chosen is not None and full is not None and chosen.online_seconds is not None:
        pays = break_even(chosen.offline_seconds, full.online_seconds, chosen.online_seconds)
    return Recommendation(
        velocity_tolerance=tolerance.velocity,
        pressure_tolerance=tolerance.pressure,
        one_tolerance_for_both=tolerance.one_for_both,
        judged_by=measure.words,
        model=None if chosen is None else chosen.model,
        full_run=None if full is None else full.model,
        pays_from_run=pays,
        without_a_model=enough[0] if enough else None,
    )


def cheapest(rows: Sequence[ModelRow], tolerance: Tolerance, measure: Measure) -> ModelRow | None:
    """Return the fastest model within a tolerance that no alternative beats, if there is one."""
    fit = [
        (row.online_seconds, row)
        for row in rows
        if row.online_seconds is not None
        and row.beaten_by is None
        and tolerance.allows(row.errors, measure)
    ]
    return min(fit, key=lambda pair: pair[0], default=(None, None))[1]


def most_accurate(rows: Sequence[ModelRow], quantity: str, measure: Measure) -> ModelRow | None:
    """Return the stable model with the least error of a quantity, if any is stable."""
    found = [(e, row) for row in rows if (e := measure.of(row.errors, quantity)) is not None]
    return min(found, key=lambda pair: pair[0], default=(None, None))[1]


def words(
    advice: Recommendation, rows: Sequence[ModelRow], tolerance: Tolerance, measure: Measure
) -> str:
    """Return which model to take, or how near models come to the tolerance."""
    asked = f"within {tolerance.words(measure.quantities)} ({measure.words})"
    chosen = next((row for row in rows if row.model == advice.model), None)
    fit = (r for r in rows[1:] if r.beaten_by and tolerance.allows(r.errors, measure))
    if chosen is not None:
        text = f"{asked}, the cheapest is {_described(chosen, advice, measure)}"
    elif (beaten_row := next(fit, None)) is not None:
        text = (
            f"no model is {asked} and better than doing nothing: {beaten_row.beaten_by} is no "
            f"slower than {beaten_row.model}, and nowhere worse"
        )
    else:
        text = f"no model is {asked} but the case's own full run"
        best = [
            f"{quantity} {format_figure(measure.of(row.errors, quantity))} % by {row.model}"
            for quantity in measure.quantities
            if (row := most_accurate(rows[1:], quantity, measure)) is not None
        ]
        text += f"; the best are {' and '.join(best)}" if best else ""
    if advice.without_a_model is not None:
        text += f"; without any model, {advice.without_a_model} is within it too"
    return text


def _described(chosen: ModelRow, advice: Recommendation, measure: Measure) -> str:
    """Return a model with its errors, its gain and the run from which it pays."""
    errors = ", ".join(
        f"{q} {format_figure(measure.of(chosen.errors, q))} %" for q in measure.quantities
    )
    text = f"{chosen.model}: {errors}, {format_figure(chosen.online_seconds)} s a run, "
    if chosen.speed_up is None:
        text += "and the time of the full run is unknown"
    else:
        text += f"{format_figure(chosen.speed_up)} times faster than the full run"
    if chosen.kind != "full" and advice.full_run is not None and advice.pays_from_run is not None:
        pays = counted(advice.pays_from_run, "run")
        text += (
            f"; counting the cost of making it, it pays from {pays} on; for fewer take "
            f"{advice.full_run}"
        )
    return text


def beaten(
    rows: Sequence[ModelRow], without: Sequence[Alternative], measure: Measure
) -> Iterator[str]:
    """Yield which models gain nothing: in both fields, or in one compared with doing nothing."""
    beaten_by: dict[str, list[str]] = {}
    for row in rows:
        if row.beaten_by is not None:
            beaten_by.setdefault(row.beaten_by, []).append(row.model)
    for name, models in beaten_by.items():
        yield f"{name} is no slower and nowhere worse than {_listed(models)}: don't take these"
    for other in without:
        for quantity in measure.quantities:
            worse = [
                row.model
                for row in rows[1:]
                if row.beaten_by is None and measure.no_worse(other.errors, row.errors, quantity)
            ]
            if worse:
                error = format_figure(measure.of(other.errors, quantity))
                yield f"in {quantity} {other.name} ({error} %) is no worse than {_listed(worse)}"


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return "; ".join(names[:MOST_NAMES]) + more
