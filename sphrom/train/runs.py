"""The full runs of a training, several at once, and their maps onto the reference points."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from sphrom.case.loader import case_of_text
from sphrom.case.points import ParameterPoint
from sphrom.console import Reporter, SilentReporter
from sphrom.errors import CaseError, UnstableError, error_of
from sphrom.offline import fom
from sphrom.offline import map as map_stage
from sphrom.setup.check import require_room
from sphrom.setup.context import KnownArtifacts, StageContext
from sphrom.setup.cost import runs_that_fit
from sphrom.store.workspace import Workspace
from sphrom.sweep.cluster import connect, workers_of
from sphrom.sweep.tasks import Failure, SweepTask, attempted


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
    broken = [failure for failure in failed if failure.exit_code != UnstableError.exit_code]
    for failure in broken:
        raise error_of(failure.exit_code, f"{failure.point.label}: {failure.reason}")
    # Runs that became unstable are on disk too, as those of an earlier call are.
    workspace = Workspace(replace(context, known=KnownArtifacts()))
    problems = {failure.point: failure.reason for failure in failed}
    for point in points:
        if point not in problems and (reason := _instability(workspace, point)) is not None:
            problems[point] = reason
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
    failed: list[Failure] = []
    report = workspace.context.report
    number = min(workers or runs_that_fit(workspace.case, "fom"), len(points))
    with (
        workers_of(number, scheduler, report) as found,
        report.progress("full runs", len(points)) as advance,
    ):

        def done(task: SweepTask, problems: tuple[Failure, ...]) -> None:
            failed.extend(problems)
            advance(len(task.points))

        threads = 1 if scheduler or number > 1 else workspace.threads
        command = str(uuid.uuid4())
        found.run(
            [
                SweepTask(
                    case_text=workspace.case_text,
                    case_folder=str(workspace.case.folder),
                    out=str(workspace.out.resolve()),
                    points=(point,),
                    threads=threads,
                    force=workspace.context.force,
                    command=command,
                )
                for point in points
            ],
            attempt,
            done,
        )
    return failed


def attempt(task: SweepTask) -> tuple[Failure, ...]:
    """Make the full run of a task, and return why there is none."""
    return attempted(task, _make)


def _make(task: SweepTask) -> tuple[Failure, ...]:
    context = StageContext(
        case_of_text(task.case_text, task.case_folder),
        Path(task.out),
        task.force,
        task.threads,
        SilentReporter(),
        only=task.points,
        keep_valid=True,
        resume=True,
        bitwise=True,
    )
    fom.run(context)
    return ()


def _instability(workspace: Workspace, point: ParameterPoint) -> str | None:
    """Return why a full run that is there became unstable, None where it didn't."""
    with workspace.open(workspace.full_run(point)) as run:
        return None if run.text("status") == "complete" else run.text("status_detail")


def at_once(workers: int | None, scheduler: str | None, report: Reporter) -> int:
    """Return how many full runs are chosen at once: one where nothing is asked for."""
    if scheduler is None:
        return workers or 1
    with connect(scheduler, report) as cluster:
        return cluster.number


def check_options(workers: int | None, scheduler: str | None) -> None:
    """Raise CaseError where options contradict one another."""
    if workers is not None and scheduler is not None:
        raise CaseError("--workers: is not for --scheduler, which has workers of its own")
