"""Which model to take, and where doing nothing is as good: what `trade` says in words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from sphrom.compare.error_rows import Errors
from sphrom.plots.tables import format_figure
from sphrom.trade.nothing import NothingRow, no_worse
from sphrom.trade.table import (
    QUANTITIES,
    Measure,
    ModelRow,
    Tolerance,
    break_even,
    cheapest,
    most_accurate,
    within,
)

MOST_NAMES = 6
"""Models that one line names."""


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
    """What is within the tolerance without any run, where something is."""


def recommend(
    rows: Sequence[ModelRow],
    nothing: Sequence[NothingRow],
    tolerance: Tolerance,
    measure: Measure,
) -> Recommendation:
    """Return which model to take within a tolerance; the case's own full run is the first row."""
    own, *others = rows
    chosen = cheapest(others, tolerance, measure)
    full = cheapest([own, *(row for row in others if row.kind == own.kind)], tolerance, measure)
    enough = [row.name for row in nothing if within(row, tolerance, measure)]
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


def words(
    advice: Recommendation, rows: Sequence[ModelRow], tolerance: Tolerance, measure: Measure
) -> str:
    """Say which model to take, or how near models come to the tolerance."""
    asked = f"within {tolerance.words} ({measure.words})"
    chosen = next((row for row in rows if row.model == advice.model), None)
    if chosen is None:
        said = f"no model is {asked} but the case's own full run" + _nearest(rows, measure)
        beaten = [row for row in rows[1:] if row.beaten_by and within(row, tolerance, measure)]
        if beaten:
            first = beaten[0]
            said = (
                f"no model is {asked} and better than doing nothing: {first.beaten_by} is no "
                f"slower than {first.model}, and nowhere worse"
            )
    else:
        said = (
            f"{asked}, the cheapest is {chosen.model}: {_errors(chosen, measure)}, "
            f"{format_figure(chosen.online_seconds)} s a run, "
            f"{_gain(chosen)}{_pays(chosen, advice)}"
        )
    if advice.without_a_model is not None:
        said += f"; without any model, {advice.without_a_model} is within it too"
    return said


def _nearest(rows: Sequence[ModelRow], measure: Measure) -> str:
    best = []
    for quantity in QUANTITIES:
        row = most_accurate(rows[1:], quantity, measure)
        if row is not None:
            best.append(f"{quantity} {format_figure(measure.of(row, quantity))} % by {row.model}")
    return f"; the best are {' and '.join(best)}" if best else ""


def _errors(row: Errors, measure: Measure) -> str:
    return ", ".join(f"{q} {format_figure(measure.of(row, q))} %" for q in QUANTITIES)


def _gain(chosen: ModelRow) -> str:
    if chosen.speed_up is None:
        return "and what the full run takes is unknown"
    return f"{format_figure(chosen.speed_up)} times faster than the full run"


def _pays(chosen: ModelRow, advice: Recommendation) -> str:
    """Say from which run on a reduced model pays, all that it was made from counted."""
    if chosen.kind == "full" or advice.full_run is None or advice.pays_from_run is None:
        return ""
    return (
        f"; with what it is made from it pays from {runs(advice.pays_from_run)} on, for fewer take "
        f"{advice.full_run}"
    )


def runs(number: int) -> str:
    """Return a number of runs in words."""
    return "1 run" if number == 1 else f"{number} runs"


def beaten(
    rows: Sequence[ModelRow], nothing: Sequence[NothingRow], measure: Measure
) -> Iterator[str]:
    """Yield which models nothing is gained by: beaten in all, or in one field by doing nothing."""
    beaten_by: dict[str, list[str]] = {}
    for row in rows:
        if row.beaten_by is not None:
            beaten_by.setdefault(row.beaten_by, []).append(row.model)
    for name, models in beaten_by.items():
        yield f"{name} is no slower and nowhere worse than {_listed(models)}: don't take these"
    for other in nothing:
        for quantity in QUANTITIES:
            worse = [
                row.model
                for row in rows[1:]
                if row.beaten_by is None and no_worse(other, row, quantity, measure)
            ]
            if worse:
                error = format_figure(measure.of(other, quantity))
                yield f"in {quantity} {other.name} ({error} %) is no worse than {_listed(worse)}"


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - MOST_NAMES} more" if len(names) > MOST_NAMES else ""
    return "; ".join(names[:MOST_NAMES]) + more
