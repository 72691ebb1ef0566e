"""Stage `sweep`: run one model at many parameter values, on all cores, on a cluster, or in shards.

Finished runs are kept on disk in parts. A stopped sweep continues from them, and a sweep with more
values runs only the new ones. When all runs are done, the parts are merged into one artifact.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from sphrom.artifacts import locked, read_record
from sphrom.artifacts.records.sweep import Statistics
from sphrom.case.hints import slow_sweep, sweep_beyond_training
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import changed, sweep_model, sweep_name, sweep_points
from sphrom.console import Reporter
from sphrom.errors import ArtifactError, CaseError, UnstableError
from sphrom.metrics import measures
from sphrom.metrics.draws import fewest_runs
from sphrom.metrics.measures import DRY, STATISTICS
from sphrom.metrics.quantities import unit_of
from sphrom.metrics.series import ESTIMATED, OSCILLATION, REGIMES
from sphrom.models.fom import ensure_packed
from sphrom.plots.tables import format_figure, rows_of_columns, write_csv
from sphrom.setup.context import StageContext
from sphrom.setup.cost import full_seconds, require_room
from sphrom.store.tasks import Failure, Task, files_of
from sphrom.store.workers import start_workers
from sphrom.store.workspace import Target, Workspace
from sphrom.sweep import statistics
from sphrom.sweep.batches import (
    COMPLETE,
    ERROR,
    FAILED,
    LARGEST_BATCH,
    MEASURED_ERRORS,
    NOT_RUN,
    OSCILLATION_ERRORS,
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
FIGURES = {
    "time_step": "s",
    "kinetic_energy": "J/m",
    "largest_speed": "m/s",
    "error_estimate_velocity": "%",
    "error_estimate_pressure": "%",
}
"""Figures of a run with their units, named as in `sphrom.open`: final energy, largest speed of all
points and snapshots, root mean squares of estimated errors over those of the fields."""

SHOWN = ("_mean", "_frequency", "_amplitude")
"""Suffixes of the names of measured figures that are shown."""
BEYOND = {None: "", 0: "no", 1: "yes"}
"""Table entries that say whether a run is outside of the trained range; None means unknown."""
Cells = dict[str, str | float | None]
"""The row of a run in the table, by column; None without a result or an estimate."""


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


def columns_of(case: Case, records: Sequence[RunRecord]) -> dict[str, str | None]:
    """Return the columns of the table of runs, with their units.

    `error_estimate_extrapolated` is `yes` for values outside of the trained range, else `no`, and
    empty without an estimate. `reason` is that of a failure, or of a doubt about a complete run.
    Measurements over time have columns for their statistics from their `from_time` on, and for
    estimated errors, which are empty for components with only noise; measurements along lines have
    none. Oscillations have a column for the reason why there is no frequency.
    """
    derivatives = next((record.derivative_names for record in records if record.values), ())
    names = {**dict.fromkeys(case.plan.parameter_names), "status": None}
    if any(REGIME in record.values for record in records):
        names[REGIME] = None
    names |= FIGURES
    names["kinetic_energy"] = unit_of("kinetic_energy", case.scene.domain.n_dim)
    if any(MEASURED_ERRORS[0] in record.values for record in records):
        names |= {f"error_estimate_{name}": "%" for name in case.scene.columns}
    names |= dict.fromkeys((*derivatives, "error_estimate_extrapolated", "reason"))
    for name, column in case.scene.columns.items():
        names |= {f"{name}_{statistic}": column.units for statistic in STATISTICS}
    for name, measure in case.plan.oscillations.items():
        names |= {f"{name}_{figure}": measure.units_of(figure) for figure in OSCILLATION}
        if any(OSCILLATION_ERRORS in record.values for record in records):
            names |= {f"error_estimate_{name}_{f}": measure.units_of(f) for f in ESTIMATED}
        names[f"{name}_reason"] = None
    return names


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
        names = columns_of(case, records)
        rows = _rows(case, records, names)
        write_csv(path.with_suffix(".csv"), rows_of_columns(names, rows))
        counts = Counter(STATES[record.status] for record in records)
        report.table(
            f"sweep {sweep_name(case)}: " + ", ".join(f"{n} runs {s}" for s, n in counts.items()),
            ("output", "least", "at", "mean", "greatest", "at"),
            list(_summary(records, rows, names)),
        )
        if regimes := [r.values[REGIME] for r in records if REGIME in r.values]:
            report.info(f"regimes: {statistics.regimes_in_words(regimes)}")
        show_lost(report, [record for record in records if record.status != COMPLETE])
        if (doubts := doubts_in_words(records)) is not None:
            report.warn(doubts)
        if times := case.plan.times_in_words:
            report.info(times)
        for problem in _missing(case, rows, records):
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


def _rows(case: Case, records: Sequence[RunRecord], names: Iterable[str]) -> list[Cells]:
    """Return the rows of runs, by column."""
    rows = [_row(case, record, names) for record in records]
    complete = [(row, r.values) for row, r in zip(rows, records, strict=True) if r.values]
    first = complete[0][1] if complete else {}
    for path in first:
        if not path.startswith("measure/"):
            continue
        _, name, quantity = path.split("/")
        series = np.stack([values[path] for _, values in complete])
        counted = case.plan.counted(name, first["time"])
        for figure, column in measures.statistics({quantity: series}, counted).items():
            for (row, _), value in zip(complete, column.tolist(), strict=True):
                row[f"{name}_{figure}"] = value
    for (row, values), (name, measure) in product(complete, case.plan.oscillations.items()):
        figures = statistics.oscillation_of(measure, values)
        row |= {f"{name}_{figure}": value for figure, value in figures.items()}
        missing = measures.why_missing(row.get(REGIME))
        row[f"{name}_reason"] = "" if "frequency" in figures else missing
    return rows


def _row(case: Case, record: RunRecord, names: Iterable[str]) -> Cells:
    """Return the row of a run without its measurements."""
    values = record.values
    row: Cells = {**dict.fromkeys(names), **record.point.as_dict()}
    row |= {"status": STATES[record.status], "reason": record.reason}
    row["error_estimate_extrapolated"] = BEYOND[values.get(f"{ERROR}extrapolated")]
    for name in FIGURES:
        if (value := values.get(name.replace("error_estimate_", ERROR))) is not None:
            row[name] = float(value)
    if REGIME in values:
        row[REGIME] = REGIMES[values[REGIME]]
    row |= zip(record.derivative_names, values.get("derivatives", ()), strict=True)
    if MEASURED_ERRORS[0] in values:
        pairs = np.stack([values[path] for path in MEASURED_ERRORS], axis=1).tolist()
        for column, (error, change) in zip(case.scene.columns, pairs, strict=True):
            row[f"error_estimate_{column}"] = 100.0 * error / change if change > 0.0 else None
    regime = REGIMES[values[REGIME]] if REGIME in values else None
    found = values.get(OSCILLATION_ERRORS, ())
    for name, errors in zip(case.plan.oscillations, found, strict=False):
        figures = measures.in_regime(regime, dict(zip(ESTIMATED, errors.tolist(), strict=True)))
        row |= {f"error_estimate_{name}_{figure}": error for figure, error in figures.items()}
    return row


def _missing(case: Case, rows: Sequence[Cells], records: Sequence[RunRecord]) -> Iterator[str]:
    """Yield warnings about figures that complete runs do not have."""
    complete = [row for row in rows if row["status"] == STATES[COMPLETE]]
    for name in case.plan.oscillations:
        for reason, number in Counter(row[f"{name}_reason"] for row in complete).items():
            if reason:
                yield (
                    f"{name}: {number} of {len(complete)} runs have no frequency and no amplitude, "
                    f"and statistics leave them out: {reason}"
                )
    for name in case.scene.measured_fields if case.plan.with_weight else ():
        path = f"measure/{name}/pressure"
        if dry := sum(bool((r.values.get(path, np.ones(1)) == 0.0).any()) for r in records):
            yield (
                f"{name}: {DRY} in {dry} of {len(complete)} runs; its statistics include these "
                "zeros"
            )
    if none := [n for n in case.scene.columns if complete and complete[0][f"{n}_mean"] is None]:
        yield f"runs end before the from_time of {', '.join(none)}"


def _summary(
    records: Sequence[RunRecord], rows: Sequence[Cells], names: Mapping[str, str | None]
) -> Iterator[tuple[str, ...]]:
    """Yield a row per figure: its extremes with their points, and its mean."""
    points = [record.point for record in records]
    n_complete = sum(record.status == COMPLETE for record in records)
    for name, unit in names.items():
        shown = name in FIGURES or name.endswith(SHOWN) or name.startswith("error_estimate_")
        if name == "time_step" or not shown:
            continue
        cells = zip([row[name] for row in rows], points, strict=True)
        if pairs := [(value, point) for value, point in cells if isinstance(value, float)]:
            n_runs = f" of {len(pairs)} runs" if len(pairs) < n_complete else ""
            mean = sum(value for value, _ in pairs) / len(pairs)
            least, most = (
                (format_figure(value), ", ".join(f"{n} {v:.6g}" for n, v in at.as_dict().items()))
                for value, at in (min(pairs), max(pairs))
            )
            yield (f"{name.replace('_', ' ')} [{unit}]{n_runs}", *least, format_figure(mean), *most)


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
