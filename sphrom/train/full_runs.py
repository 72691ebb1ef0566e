"""The full runs of a training, several at once, and their maps onto the reference points."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import replace

from sphrom.case.points import ParameterPoint
from sphrom.errors import UnstableError, error_of
from sphrom.offline import fom
from sphrom.offline import map as map_stage
from sphrom.setup.context import KnownArtifacts, StageContext
from sphrom.setup.cost import require_room, runs_that_fit
from sphrom.store.workspace import Workspace
from sphrom.sweep.workers import Failure, Task, start_workers


def make(
    context: StageContext,
    points: Sequence[ParameterPoint],
    workers: int | None,
    scheduler: str | None,
) -> dict[ParameterPoint, str]:
    """Make the full runs at points that are not there, map them, and say why some are unstable.

    The context's case has all points. Runs that were stopped go on from their checkpoints.

    Raises SphromError where a run fails for another reason than that it became unstable.
    """
    require_room(context.case, context.out, points, "fom")
    workspace = Workspace(replace(context, known=KnownArtifacts()))
    fom.ensure_packed(workspace)
    missing = [p for p in points if workspace.reason_to_make(workspace.full_run(p)) is not None]
    failed = _run(workspace, missing, workers, scheduler) if missing else []
    for failure in failed:
        if failure.exit_code != UnstableError.exit_code:
            raise error_of(failure.exit_code, f"{failure.point.label}: {failure.reason}")
    # Runs that became unstable are on disk too, as those of an earlier call are.
    workspace = Workspace(replace(context, known=KnownArtifacts()))
    problems = {failure.point: failure.reason for failure in failed}
    for point in points:
        if point not in problems:
            with workspace.open(workspace.full_run(point)) as run:
                if run.text("status") != "complete":
                    problems[point] = run.text("status_detail")
    stable = tuple(point for point in points if point not in problems)
    report = context.report.brief(progress=True)
    map_stage.run(replace(workspace.context, only=stable, report=report))
    return problems


def _run(
    workspace: Workspace,
    points: Sequence[ParameterPoint],
    workers: int | None,
    scheduler: str | None,
) -> list[Failure]:
    number = min(workers or runs_that_fit(workspace.case, "fom"), len(points))
    with start_workers(number, scheduler, workspace.context.report) as found:
        threads = 1 if scheduler or number > 1 else workspace.threads
        command = str(uuid.uuid4())
        tasks = [Task.of(workspace, [point], threads, command) for point in points]
        return found.run("full runs", tasks, make_run)


def make_run(task: Task) -> tuple[Failure, ...]:
    """Make the full run of a task."""
    fom.run(task.context(only=task.points, keep_valid=True, resume=True))
    return ()
