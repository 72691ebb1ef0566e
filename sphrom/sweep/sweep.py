"""Stage `sweep`: one model at many parameter values, on all cores, a cluster or in shards.

Runs are kept on disk, in parts, and are not made again: a sweep that was stopped goes on where it
was, and one with more values runs those only. When all are made the parts become one artifact.
"""

from __future__ import annotations

import math
import uuid
from collections.abc import Iterator, Sequence
from dataclasses import replace

from sphrom.case.hints import slow_sweep, sweep_beyond_training
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import sweep_model, sweep_name, sweep_points
from sphrom.errors import CaseError
from sphrom.offline.fom import ensure_packed
from sphrom.setup.context import StageContext
from sphrom.setup.cost import full_seconds, require_room, runs_that_fit
from sphrom.store.workspace import Workspace
from sphrom.sweep import results as sweep_results
from sphrom.sweep.records import require_folder
from sphrom.sweep.runs import make_runs
from sphrom.sweep.workers import Failure, Task, check_options, start_workers
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
    _check_options(context, workers, scheduler, shard, collect)
    points = _points(context)
    workspace = Workspace(context)
    results = sweep_results.Results(workspace, points)
    failed: list[Failure] = []
    if not collect:
        if (warning := sweep_beyond_training(context.case)) is not None:
            context.report.warn(warning)
        if context.force:
            results.discard()
        chosen = points if shard is None else points[shard[0] - 1 :: shard[1]]
        missing = results.missing(chosen)
        if missing:
            failed = _do(workspace, missing, workers, scheduler)
            require_folder(workspace)
    if shard is not None and (left := results.missing(points)):
        sweep_results.report_shard(workspace, len(points), len(left), failed)
        return
    results.gather(failed)


def _check_options(
    context: StageContext,
    workers: int | None,
    scheduler: str | None,
    shard: tuple[int, int] | None,
    collect: bool,
) -> None:
    """Raise CaseError where options contradict one another."""
    check_options(workers, scheduler)
    if collect and (shard is not None or scheduler is not None):
        raise CaseError("--collect: runs nothing: it takes neither --shard nor --scheduler")
    if context.force and (shard is not None or collect):
        raise CaseError(
            "--force: starts a sweep anew, which shards can't do, as others may have begun; remove "
            f"sweep-{sweep_name(context.case)}.h5 and the folder beside it first"
        )


def _points(context: StageContext) -> tuple[ParameterPoint, ...]:
    """Return the points of the sweep. Raises CaseError where there are none."""
    points = sweep_points(context.case)
    if not points:
        trained = [point.reynolds for point in context.case.plan.train_points]
        example = f"low: {min(trained):g}, high: {2.0 * max(trained):g}, count: 100"
        raise CaseError(
            f"sweep.reynolds: there are no values to run at; give some, such as --set "
            f"'sweep.reynolds={{{example}}}'"
        )
    return points


def _do(
    workspace: Workspace,
    points: Sequence[ParameterPoint],
    number: int | None,
    scheduler: str | None,
) -> list[Failure]:
    """Run the model at points, and return the failures."""
    _prepare(workspace, points)
    _tell_full_runs(workspace, len(points))
    case, model, report = workspace.case, sweep_model(workspace.case), workspace.context.report
    # Runs from operators are so short that a task has many.
    in_batches = model is not None and model.from_operators
    n_tasks = math.ceil(len(points) / (SMALLEST_BATCH if in_batches else 1))
    number = min(number or runs_that_fit(case, "fom" if model is None else "rom"), n_tasks)
    with start_workers(number, scheduler, report) as found:
        threads = 1 if scheduler or found.number > 1 else workspace.threads
        size = 1
        if in_batches:
            share = math.ceil(len(points) / (BATCHES_EACH * found.number))
            size = min(max(share, SMALLEST_BATCH), LARGEST_BATCH)
        tasks = list(_tasks(workspace, points, size, threads))
        return found.run(f"sweep {sweep_name(case)}", tasks, make_runs)


def _tasks(
    workspace: Workspace, points: Sequence[ParameterPoint], size: int, threads: int
) -> Iterator[Task]:
    """Yield the runs in tasks of a size."""
    command = str(uuid.uuid4())
    for first in range(0, len(points), size):
        yield Task.of(workspace, points[first : first + size], threads, command)


def _prepare(workspace: Workspace, points: Sequence[ParameterPoint]) -> None:
    """Make the packed particles that runs share, and check that the runs have all they need."""
    case = workspace.case
    model = sweep_model(case)
    if model is None:
        new = tuple(point for point in points if point not in case.plan.points)
        require_room(case, workspace.out, new or points, "fom")
        # Packed particles are kept, though runs may be made again.
        ensure_packed(Workspace(replace(workspace.context, force=False)))
    for parent in workspace.sweep().parents.values():
        workspace.require(parent)


def _tell_full_runs(workspace: Workspace, number: int) -> None:
    """Tell how many full runs a sweep is about to make, and how long they take."""
    case, report = workspace.case, workspace.context.report
    if sweep_model(case) is not None:
        return
    if (advice := slow_sweep(case)) is not None:
        report.note(advice)
    seconds = duration(full_seconds(case, number))
    report.note(f"the sweep makes {counted(number, 'full run')}, about {seconds} on one core")
