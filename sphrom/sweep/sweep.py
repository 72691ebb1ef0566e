"""Stage `sweep`: run one model at many parameter values, on all cores, on a cluster, or in shards.

Finished runs are kept on disk in parts. A stopped sweep continues from them, and a sweep with more
values runs only the new ones. When all runs are done, the parts are merged into one artifact.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from sphrom.artifacts import locked, read_record
from sphrom.artifacts.records.sweep import Statistics
from sphrom.case.hints import slow_sweep, sweep_beyond_training
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import changed, sweep_model, sweep_name, sweep_points
from sphrom.console import Reporter
from sphrom.errors import ArtifactError, CaseError, UnstableError
from sphrom.metrics.draws import fewest_runs
from sphrom.models.fom import ensure_packed
from sphrom.plots.tables import rows_of_columns, write_csv
from sphrom.setup.context import StageContext
from sphrom.setup.cost import full_seconds, require_room
from sphrom.store.tasks import Failure, Task, files_of
from sphrom.store.workers import start_workers
from sphrom.store.workspace import Target, Workspace
from sphrom.sweep import curves, statistics, table
from sphrom.sweep.batches import (
    COMPLETE,
    FAILED,
    LARGEST_BATCH,
    NOT_RUN,
    REGIME,
    SMALLEST_BATCH,
    STATES,
    UNSTABLE,
    RunRecord,
    doubts_in_words,
    make_runs,
    number_of_workers,
    parts_folder,
    read_points,
    read_records,
    require_folder,
    runs_alone,
    write_sweep,
)
from sphrom.text import counted, duration

BATCHES_EACH = 4
"""Approximate number of tasks per worker, so that all end at a similar time."""
MOST_SHOWN = 10
"""Largest number of failed runs that are shown one by one."""


def run(
    context: StageContext,
    shard: tuple[int, int] | None = None,
    collect: bool = False,
) -> None:
    """Run the model of a case's sweep at all its values, and gather the results in one artifact.

    By default there is one process per core, if memory allows.

    Parameters
    ----------
    shard : (i, n) to do only the i-th of n shares of the runs, with i from 1.
    collect : whether to make no runs and only gather the existing ones.

    Raises CaseError without values or when options contradict each other, ArtifactError when an
    artifact of the model is missing or runs belong to another case, UnstableError after all runs,
    if one became unstable; the table shows which.
    """
    if context.force + (shard is not None) + bool(collect) > 1 or (
        collect and context.scheduler is not None
    ):
        raise CaseError(
            "--force, --shard, --collect: can't be combined, nor --collect and --scheduler; to "
            f"restart shards, first remove sweep-{sweep_name(context.case)}.h5 and the folder "
            "beside it"
        )
    points = sweep_points(context.case)
    if not points:
        raise CaseError(
            "sweep.reynolds: has no values; give some, such as --set "
            "'sweep.reynolds={low: 100, high: 200, count: 100}'"
        )
    workspace = Workspace(context)
    results = Results(workspace, points)
    failed: list[Failure] = []
    if not collect:
        for warning in sweep_beyond_training(context.case):
            context.report.warn(warning)
        if context.force:
            results.discard()
        chosen = points if shard is None else points[shard[0] - 1 :: shard[1]]
        if missing := results.missing(chosen):
            failed = _make(workspace, missing)
            require_folder(workspace)
    if shard is not None and (left := results.missing(points)):
        context.report.info(
            f"{len(points) - len(left)} of {len(points)} runs are done; the last shard gathers "
            f"them, and so does `sphrom sweep {context.words} --collect`"
        )
        show_lost(context.report, failed)
        raise_failed(failed)
        return
    results.gather(failed)


def _make(workspace: Workspace, points: Sequence[ParameterPoint]) -> list[Failure]:
    """Run the model at points, and return the failures."""
    case = workspace.case
    context = workspace.context
    report = context.report
    model = sweep_model(case)
    if model is None:
        new = tuple(point for point in points if point not in case.plan.points)
        require_room(case, workspace.out, new or points, "fom")
        # Packed particles are kept, even if runs are made again.
        ensure_packed(Workspace(replace(context, force=False)))
        if (advice := slow_sweep(case)) is not None:
            report.note(advice)
        seconds = duration(full_seconds(case, len(points)))
        runs = counted(len(points), "full run")
        report.note(f"the sweep makes {runs}, which take about {seconds} on one core")
    for parent in workspace.sweep().parents.values():
        workspace.require(parent)
    number = number_of_workers(context, len(points))
    # The case of a task has no values, because each process would parse a long list again.
    bare = replace(context, case=changed(case, sweep=case.sweep.of_any_values))
    with start_workers(number, context.scheduler, report) as workers:
        size = 1
        if runs_alone(case):
            share = math.ceil(len(points) / (BATCHES_EACH * workers.number))
            size = min(max(share, SMALLEST_BATCH), LARGEST_BATCH)
        shares = ((points[k : k + size], "") for k in range(0, len(points), size))
        needs = partial(_needs, workspace)
        name = f"sweep {sweep_name(case)}"
        return workers.run(name, Workspace(bare), shares, make_runs, needs)


def _needs(workspace: Workspace, task: Task) -> Iterable[Path]:
    """Return the files with which another machine makes the runs of a task."""
    model = sweep_model(workspace.case)
    if runs_alone(workspace.case):
        return (parent.path for parent in workspace.sweep().parents.values())
    (point,) = task.points
    target = workspace.full_run(point) if model is None else workspace.reduced_run(model, point)
    return files_of(workspace, target)


class Results:
    """The runs of a sweep on disk."""

    def __init__(self, workspace: Workspace, points: Sequence[ParameterPoint]) -> None:
        self._workspace = workspace
        self._points = points
        self._known = {p.rounded: p for p in points} | {p: p for p in points}
        self._whole = workspace.sweep()

    def discard(self) -> None:
        """Remove all runs of the sweep."""
        for target in self._targets():
            target.path.unlink()

    def missing(self, points: Sequence[ParameterPoint]) -> list[ParameterPoint]:
        """Return the points without a complete or unstable run.

        Raises ArtifactError when existing runs belong to another case, or to removed values.
        """
        done: set[ParameterPoint] = set()
        with self._alone():
            for target in self._targets():
                with self._workspace.open(target) as artifact:
                    done.update(map(self._own, read_points(artifact)))
                if target is self._whole and (extra := done.difference(self._points)):
                    raise ArtifactError(
                        f"{target.path} has runs at values that the case no longer has, such as "
                        f"{min(extra).label}; choose another sweep.name, or restart with `--force`"
                    )
        return [point for point in points if point not in done]

    def gather(self, failed: Sequence[Failure] = ()) -> None:
        """Write all runs into the artifact and the table, and show them with their failures.

        Raises ArtifactError when runs are missing, while the artifact has the others, if any;
        UnstableError when a run became unstable; SphromError when a run failed for another reason,
        of the kind of the first failure.
        """
        report = self._workspace.context.report
        case = self._workspace.case
        path = self._whole.path
        with self._alone():
            records, summary = self._gathered(failed)
        names = table.columns_of(case, records)
        rows = table.rows_of(case, records, names)
        write_csv(path.with_suffix(".csv"), rows_of_columns(names, rows))
        curves.publish(case, path, records, rows)
        counts = Counter(STATES[record.status] for record in records)
        report.table(
            f"sweep {sweep_name(case)}: " + ", ".join(f"{n} runs {s}" for s, n in counts.items()),
            ("output", "least", "at", "mean", "greatest", "at"),
            list(table.summary(records, rows, names)),
        )
        if regimes := [r.values[REGIME] for r in records if REGIME in r.values]:
            report.info(f"regimes: {statistics.regimes_in_words(regimes)}")
        show_lost(report, [record for record in records if record.status != COMPLETE])
        if (doubts := doubts_in_words(records)) is not None:
            report.warn(doubts)
        if times := case.plan.times_in_words:
            report.info(times)
        for problem in table.missing_figures(case, rows, records):
            report.warn(problem)
        report.info(f"all runs are in {path} and {path.stem}.csv")
        if summary is not None:
            statistics.show(report, summary)
            if lost := len(records) - counts[STATES[COMPLETE]]:
                report.warn(f"statistics leave out {lost} of {len(records)} runs without a result")
        elif case.sweep.levels:
            report.warn("statistics: none, because too few runs have a result")
        elif case.sweep.sample is not None:
            least = fewest_runs(case.sweep.quantiles)
            report.note(f"statistics: none, because they need sample.count: {least} or more")
        if n_left := counts[STATES[NOT_RUN]]:
            raise ArtifactError(
                f"{n_left} of {len(records)} runs have not been made yet; the others were "
                "gathered, and their parts are kept: collect again when all shards are done"
            )
        if n_unstable := counts[STATES[UNSTABLE]]:
            raise UnstableError(f"{n_unstable} of {len(records)} runs became unstable")
        raise_failed(failed)

    def _gathered(self, failed: Sequence[Failure]) -> tuple[list[RunRecord], Statistics | None]:
        """Write all runs into the artifact, and return them with their statistics."""
        targets = list(self._targets())
        case = self._workspace.case
        done = {f.point: RunRecord(f.point, FAILED, f.reason) for f in failed}
        for target in targets:
            with self._workspace.open(target) as artifact:
                ended = (COMPLETE, UNSTABLE)
                runs = (replace(r, point=self._own(r.point)) for r in read_records(artifact))
                done |= {run.point: run for run in runs if run.status in ended}
        if done.keys().isdisjoint(self._points):
            raise ArtifactError(
                f"{self._whole.path}: none of its {len(self._points)} runs has been made; "
                f"`{self._whole.made_by}` makes them"
            )
        records = [done.get(point) or RunRecord(point, NOT_RUN) for point in self._points]
        complete = not any(record.status == NOT_RUN for record in records)
        if targets == [self._whole] and not failed and complete:
            with self._workspace.open(self._whole) as artifact:
                stored = "statistics/levels" in artifact
                summary = read_record(artifact, Statistics, "statistics") if stored else None
            if case.sweep.levels == (() if summary is None else tuple(summary.levels.tolist())):
                name = self._whole.path.name
                self._workspace.context.report.info(f"{name}: up to date, kept")
                return records, summary
        summary = statistics.statistics_of(self._workspace, records) if complete else None
        write_sweep(self._workspace, self._whole, records, summary)
        statistics.publish(case, self._whole.path, records, summary)
        if complete:  # otherwise other shards may still need the parts
            folder = parts_folder(self._workspace)
            for path in (*folder.glob("part-*.h5"), *folder.glob(".part-*.tmp")):
                path.unlink(missing_ok=True)
            with suppress(OSError):  # other shards may still write to it
                folder.rmdir()
        return records, summary

    def _own(self, point: ParameterPoint) -> ParameterPoint:
        """Return the case's value of a point, of which a file may have other last digits."""
        return self._known.get(point) or self._known.get(point.rounded, point)

    def _targets(self) -> Iterator[Target]:
        """Yield the files on disk, with the whole sweep before parts."""
        if self._whole.path.exists():
            yield self._whole
        for path in sorted(parts_folder(self._workspace).glob("part-*.h5")):
            yield replace(self._whole, path=path)

    def _alone(self) -> AbstractContextManager[object]:
        """Wait until no other shard reads or gathers runs."""
        return locked(self._workspace.folder() / parts_folder(self._workspace).name, wait=True)


def show_lost(report: Reporter, runs: Sequence[RunRecord | Failure]) -> None:
    """Show the runs without a result, with the reasons."""
    for run in runs[:MOST_SHOWN]:
        state = "failed" if isinstance(run, Failure) else STATES[run.status]
        report.warn(": ".join(filter(None, (run.point.label, state, run.reason))))
    if len(runs) > MOST_SHOWN:
        report.warn(f"and {len(runs) - MOST_SHOWN} more without a result")


def raise_failed(failed: Sequence[Failure]) -> None:
    """Raise an error of the kind of the first failure, if there is one."""
    if failed:
        raise failed[0].kind(
            f"{len(failed)} runs have no result; the same command tries them again"
        )
