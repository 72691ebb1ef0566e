"""The times that studies need, estimated before they begin for the time left that is shown.

As in `sphrom.setup.cost`, these are seconds of one core, shared by the processes of a study.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from sphrom.case.models import Case
from sphrom.progress import StageTime
from sphrom.setup.context import StageContext
from sphrom.setup.cost import (
    EACH_POINT,
    FAST_RUN,
    PICTURE,
    full_seconds,
    operator_seconds,
    run_seconds,
    runs_that_fit,
    runs_time,
    sampling_seconds,
    stage_times,
    uncounted_time,
)

WEIGHING = 0.15
"""Time to run, time and compare a reduced model at one point [s]."""
ESTIMATING = 5.0
"""Time of a run with its error estimate, over that of the run."""
SNAPSHOT = 0.01
"""Time to import one snapshot [s]."""


def times_of_study(
    context: StageContext, stage: str, asked: Mapping[str, Any]
) -> dict[str, StageTime]:
    """Return the approximate times of the parts of a study, or of the whole study by its name.

    `asked` are the options of its command.
    """
    case = context.case
    if stage == "trade":
        return _trade(context)
    if stage == "train":
        return _train(context, asked.get("budget"))
    if stage == "sweep":
        time = _sweep(context, asked.get("shard"))
    elif stage == "figures":
        seconds = PICTURE * len(case.compare.figures)
        time = StageTime(seconds, {"figures": seconds})
    elif stage == "report":
        seconds = PICTURE * EACH_POINT * len(case.plan.points)
        time = StageTime(seconds, {"pictures": seconds})
    elif stage == "import":
        seconds = SNAPSHOT * case.plan.steps.n_snapshots
        time = StageTime(seconds * len(case.plan.points), {"import": seconds})
    else:
        seconds = _extremes(context, asked.get("quick", False))
        time = StageTime(seconds, {stage: seconds})
    return {stage: time}


def _sweep(context: StageContext, shard: tuple[int, int] | None) -> StageTime:
    from sphrom.case.studies import sweep_model, sweep_name, sweep_points
    from sphrom.sweep.batches import number_of_workers

    case = context.case
    n_runs = math.ceil(len(sweep_points(case)) / (1 if shard is None else shard[1]))
    seconds = n_runs * run_seconds(case, sweep_model(case))
    return runs_time(f"sweep {sweep_name(case)}", seconds, number_of_workers(context, n_runs))


def _trade(context: StageContext) -> dict[str, StageTime]:
    from sphrom.trade import candidates

    case = context.case
    points = context.chosen(candidates.trade_points(case))
    basis = candidates.first_model(case).basis
    weighed = WEIGHING * len(points) * len(candidates.candidates(case, points, basis))
    return {
        candidates.OPERATORS: uncounted_time(operator_seconds(case)),
        **{
            label: _sampled_runs(context, variant, len(points))
            for label, variant in candidates.variants(case).items()
        },
        candidates.REDUCED: StageTime(weighed, {candidates.REDUCED: weighed}),
        candidates.PICTURE: uncounted_time(PICTURE),
    }


def _sampled_runs(context: StageContext, variant: Case, n_points: int) -> StageTime:
    from sphrom.trade.candidates import SAMPLE

    seconds = full_seconds(variant, 1)
    workers = max(1, min(context.workers or 1, n_points))
    runs = runs_time("full runs", n_points * seconds, workers, {"full run": seconds})
    sampling = sampling_seconds(variant)
    sampled = {**runs.items, SAMPLE: sampling}
    return replace(runs, seconds=runs.seconds + n_points * sampling, items=sampled)


def _train(context: StageContext, budget: int | None) -> dict[str, StageTime]:
    """Return the times of a training that uses all of its budget."""
    from sphrom.case.studies import Region, fast_section
    from sphrom.train.surrogate import FIRST, part

    case = context.case
    region = Region(case)
    model = fast_section(case, case.training.model)
    n_starts = len(region.starts(()))
    last = max(n_starts, budget or case.training.budget)
    workers = min(context.workers or runs_that_fit(case, "fom"), n_starts)
    full = full_seconds(case, 1)
    first = runs_time("full runs", n_starts * full, workers, {"full run": full})
    known = stage_times(context)
    mapped = known["map"].items["map"]
    made = sum(known[stage].seconds for stage in ("pod", "fit-psi", "operators"))
    estimated = ESTIMATING * FAST_RUN * len(region.candidates())
    items = {
        **first.items,
        "map": mapped,
        "" if model is None else f"error of {model.name}": estimated,
    }
    parts = {FIRST: replace(first, seconds=first.seconds + n_starts * mapped, items=items)}
    for number in range(n_starts, last + 1):
        seconds = made + estimated + (full + mapped) * (number < last)
        parts[part(number)] = StageTime(seconds, items, made, is_limit=True)
    return parts


def _extremes(context: StageContext, quick: bool) -> float:
    """Return the time of the maps; most of it is that of full runs at other values."""
    from sphrom.trade.extremes import FACTORS, QUICK

    factors = QUICK if quick else FACTORS
    n_runs = len(context.case.plan.parameter_names) * 2 * sum(map(len, factors.values()))
    return n_runs * full_seconds(context.case, 1)
