"""Rows of models in the table of a trade, made from their runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace

from sphrom.compare.error_rows import Errors
from sphrom.trade.candidates import Candidate
from sphrom.trade.full import Variant
from sphrom.trade.runs import Outcome
from sphrom.trade.table import ModelRow, RunRow, break_even, combined, combined_estimates


def full_row(
    variant: Variant, label: str, errors: Errors, seconds: float | None, *, stable: bool = True
) -> ModelRow:
    """Return the row of the full model, without gains; no seconds where nobody knows."""
    return ModelRow(
        model=label,
        family="full",
        kind="full",
        inner_product=None,
        basis=None,
        projection=None,
        calibrated=None,
        n_modes=None,
        resolution=variant.case.discretization.resolution,
        time_step=variant.time_step,
        stable=stable,
        offline_seconds=0.0,
        training_seconds=0.0,
        online_seconds=seconds,
        speed_up=None,
        speed_up_largest_step=None,
        break_even_runs=None,
        beaten_by=None,
        velocity_front=False,
        pressure_front=False,
        **asdict(errors),
    )


def reduced_row(
    candidate: Candidate,
    rows: Sequence[RunRow],
    outcomes: Sequence[Outcome],
    once: tuple[float | None, float | None],
    resolution: int,
) -> ModelRow:
    """Return the row of a reduced model over its runs, without gains.

    `once` is what it costs before its first run, and what of it training takes [s].
    """
    seconds = [outcome.seconds for outcome in outcomes if outcome.seconds is not None]
    stable = len(seconds) == len(outcomes)
    method = candidate.method
    return ModelRow(
        model=candidate.label,
        family=candidate.family,
        kind=method.evaluation,
        inner_product=method.inner_product,
        basis=method.basis,
        projection=method.projection,
        calibrated=method.calibrated,
        n_modes=candidate.n_modes,
        resolution=resolution,
        time_step=min(outcome.time_step for outcome in outcomes),
        stable=stable,
        offline_seconds=once[0],
        training_seconds=once[1],
        online_seconds=sum(seconds) / len(seconds) if stable else None,
        speed_up=None,
        speed_up_largest_step=None,
        break_even_runs=None,
        beaten_by=None,
        velocity_front=False,
        pressure_front=False,
        **asdict(combined(rows)),
        **asdict(combined_estimates(rows)),
    )


def with_gains(
    found: ModelRow, own_seconds: float | None, fastest_seconds: float | None
) -> ModelRow:
    """Return a row with what a model gains over the full model.

    That takes `own_seconds` as the case has it, and at its largest stable step `fastest_seconds`;
    None where nobody knows.
    """
    seconds = found.online_seconds
    if seconds is None:
        return found
    gained = replace(
        found,
        speed_up=None if own_seconds is None else own_seconds / seconds,
        speed_up_largest_step=None if fastest_seconds is None else fastest_seconds / seconds,
    )
    if found.kind == "full":
        return gained
    runs = break_even(found.offline_seconds, own_seconds, seconds)
    return replace(gained, break_even_runs=runs)
