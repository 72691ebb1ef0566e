"""Estimated times of studies, from which their progress and the time left follow.

As in `sphrom.setup.cost`, these are times on one core, divided among the processes of a study.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from sphrom.progress import StageTime
from sphrom.setup.context import StageContext
from sphrom.setup.cost import (
    EACH_POINT,
    FAST_RUN,
    PICTURE,
    full_seconds,
    run_seconds,
    runs_that_fit,
    runs_time,
    stage_times,
    uncounted_time,
)

WEIGHING = 0.15
"""Duration of a run, its timing and its comparison, for one reduced model and point [s]."""
ESTIMATING = 5.0
"""Time of a run with its error estimate, relative to that of the run."""
SNAPSHOT = 0.01
"""Time to import one snapshot [s]."""
QUICK, ALL = 15, 60
"""Approximate numbers of full runs for the maps of extremes."""


def times_of_study(
    context: StageContext, stage: str, asked: Mapping[str, Any]
) -> dict[str, StageTime]:
    """Return the approximate times of the parts of a study, or of the whole study by its name.

    `asked` are the options of its command.
    """
    case = context.case
    n_points = len(case.plan.points)
    if stage == "trade":
        return _trade(context)
    if stage == "train":
        return _train(context, asked.get("budget"))
    if stage == "sweep":
        return {stage: _sweep(context, asked.get("shard"))}
    item, n_times, seconds = {
        "figures": ("figures", 1, PICTURE * len(case.compare.figures)),
        "report": ("pictures", 1, PICTURE * EACH_POINT * n_points),
        "import": ("import", n_points, SNAPSHOT * case.plan.steps.n_snapshots),
        "extremes": (stage, 1, full_seconds(case, QUICK if asked.get("quick") else ALL)),
    }[stage]
    return {stage: StageTime(n_times * seconds, {item: seconds})}


def _sweep(context: StageContext, shard: tuple[int, int] | None) -> StageTime:
    from sphrom.case.studies import sweep_model, sweep_name, sweep_points
    from sphrom.sweep.batches import number_of_workers

    case = context.case
    n_runs = math.ceil(len(sweep_points(case)) / (1 if shard is None else shard[1]))
    seconds = n_runs * run_seconds(case, sweep_model(case))
    workers = max(1, number_of_workers(context, n_runs))
    return runs_time(f"sweep {sweep_name(case)}", seconds, workers)


def _trade(context: StageContext) -> dict[str, StageTime]:
    from sphrom.trade.candidates import (
        OPERATORS,
        PICTURE_OF_ALL,
        REDUCED,
        candidates,
        first_model,
        trade_points,
        variants,
    )

    case = context.case
    points = context.chosen(trade_points(case))
    n_models = len(candidates(case, points, first_model(case).basis))
    weighed = WEIGHING * len(points) * n_models
    parts = {OPERATORS: stage_times(context)[OPERATORS]}
    for label, variant in variants(case).items():
        parts[label] = stage_times(replace(context, case=variant, only=points))["fom"]
    parts[REDUCED] = StageTime(weighed, {REDUCED: weighed})
    return parts | {PICTURE_OF_ALL: uncounted_time(PICTURE)}


def _train(context: StageContext, budget: int | None) -> dict[str, StageTime]:
    """Return the times of a training that uses all of its budget."""
    from sphrom.case.studies import Region, fast_section, trained_at
    from sphrom.train.surrogate import FIRST, part

    case = context.case
    region = Region(case)
    starts = region.starts(())
    model = fast_section(case, case.training.model)
    last = max(len(starts), budget or case.training.budget)
    workers = context.workers or runs_that_fit(case, "fom")
    first = replace(context, case=trained_at(case, starts), only=None, workers=workers)
    known = stage_times(first)
    estimated = ESTIMATING * FAST_RUN * len(region.candidates())
    name = "" if model is None else f"error of {model.name}"
    full, mapped = known["fom"], known["map"]
    items = {**full.items, **mapped.items, name: estimated}
    parts = {FIRST: replace(full, seconds=full.seconds + mapped.seconds, items=items)}
    made = sum(known[stage].seconds for stage in ("pod", "fit-psi", "operators"))
    one_more = items["full run"] + items["map"]
    for number in range(len(starts), last + 1):
        seconds = made + estimated + one_more * (number < last)
        parts[part(number)] = StageTime(seconds, items, made, is_limit=True)
    return parts
