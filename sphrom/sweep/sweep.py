"""Stage `sweep`: one model at many parameter values, on all cores, a cluster or in shards.

Runs are kept on disk, in parts, and are not made again: a sweep that was stopped goes on where it
was, and one with more values runs those only. When all are made the parts become one artifact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from sphrom.case.hints import slow_sweep, sweep_beyond_training
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import sweep_model, sweep_name, sweep_points
from sphrom.errors import CaseError
from sphrom.offline.fom import ensure_packed
from sphrom.setup.context import StageContext
from sphrom.setup.cost import full_seconds, require_room, runs_that_fit
from sphrom.store.workspace import Workspace
from sphrom.sweep.records import require_folder
from sphrom.sweep.results import Results, raise_failed, show_lost
from sphrom.sweep.runs import make_runs
from sphrom.sweep.workers import Failure, check_options, start_workers
from sphrom.text import counted, duration

LARGEST_BATCH, SMALLEST_BATCH = 1000, 50
"""Runs on the reference points in one task: fewer are over before another process has started."""
BATCHES_EACH = 4
"""Tasks of each worker, about, so that all end at about the same time."""


def run(
    context: StageContext,
    workers: int | None = None,
    scheduler: str | None = None,
    shard: tuple[int, int] | None = None,
    collect: bool = False,
) -> None:
    """Run the model of a case's sweep at all its values, and gather the results in one artifact.

    Parameters
    ----------
    workers : processes on this machine; None is one a core, as far as memory goes.
    scheduler : address of a Dask scheduler, whose workers do the runs instead.
    shard : (i, n): do the i-th of n shares of the runs only, i from 1.
    collect : make no runs, gather the existing ones.

    Raises
    ------
    CaseError
        When there are no values, or options contradict one another.
    ArtifactError
        When an artifact of the model is missing, or runs that are there are of another case.
    UnstableError
        After all runs, when one became unstable; the table says which.
    """
    check_options(workers, scheduler)
    if context.force + (shard is not None) + collect > 1 or (collect and scheduler is not None):
        raise CaseError(
            "--force, --shard, --collect: are not for one another, and --collect runs nothing on a "
            f"scheduler; to start shards anew, remove sweep-{sweep_name(context.case)}.h5 and the "
            "folder beside it first"
        )
    points = sweep_points(context.case)
    if not points:
        raise CaseError(
            "sweep.reynolds: there are no values to run at; give some, such as --set "
            "'sweep.reynolds={low: 100, high: 200, count: 100}'"
        )
    workspace = Workspace(context)
    results = Results(workspace, points)
    failed: list[Failure] = []
    if not collect:
        if (warning := sweep_beyond_training(context.case)) is not None:
            context.report.warn(warning)
        if context.force:
            results.discard()
        chosen = points if shard is None else points[shard[0] - 1 :: shard[1]]
        if missing := results.missing(chosen):
            failed = _make(workspace, missing, workers, scheduler)
            require_folder(workspace)
    if shard is not None and (left := results.missing(points)):
        context.report.info(
            f"{len(points) - len(left)} of {len(points)} runs are done; the last shard gathers "
            "them, or `sphrom sweep CASE --collect`"
        )
        show_lost(context.report, failed)
        raise_failed(failed)
        return
    results.gather(failed)


def _make(
    workspace: Workspace,
    points: Sequence[ParameterPoint],
    number: int | None,
    scheduler: str | None,
) -> list[Failure]:
    """Run the model at points, and return the failures."""
    case, report, model = workspace.case, workspace.context.report, sweep_model(workspace.case)
    if model is None:
        new = tuple(point for point in points if point not in case.plan.points)
        require_room(case, workspace.out, new or points, "fom")
        # Packed particles are kept, though runs may be made again.
        ensure_packed(Workspace(replace(workspace.context, force=False)))
    for parent in workspace.sweep().parents.values():
        workspace.require(parent)
    if model is None:
        if (advice := slow_sweep(case)) is not None:
            report.note(advice)
        seconds = duration(full_seconds(case, len(points)))
        runs = counted(len(points), "full run")
        report.note(f"the sweep makes {runs}, about {seconds} on one core")
    # Runs from operators are so short that a task has many.
    in_batches = model is not None and model.from_operators
    n_tasks = math.ceil(len(points) / (SMALLEST_BATCH if in_batches else 1))
    number = min(number or runs_that_fit(case, "fom" if model is None else "rom"), n_tasks)
    with start_workers(number, scheduler, report) as workers:
        size = 1
        if in_batches:
            share = math.ceil(len(points) / (BATCHES_EACH * workers.number))
            size = min(max(share, SMALLEST_BATCH), LARGEST_BATCH)
        return workers.run(f"sweep {sweep_name(case)}", workspace, points, make_runs, size)
