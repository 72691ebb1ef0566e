"""The results of a sweep: parts on disk, gathered into an artifact and a table."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from sphrom.artifacts import read_record
from sphrom.artifacts.records.sweep import Statistics
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import sweep_name
from sphrom.console import Reporter
from sphrom.errors import ArtifactError, UnstableError, error_of
from sphrom.metrics import measures
from sphrom.metrics.measures import COMPONENTS, STATISTICS, UNITS
from sphrom.plots.tables import format_figure, rows_of_columns, write_csv
from sphrom.store.workspace import Target, Workspace
from sphrom.sweep import statistics
from sphrom.sweep.records import (
    COMPLETE,
    ERROR,
    FAILED,
    NOT_RUN,
    STATES,
    UNSTABLE,
    RunRecord,
    parts_folder,
    read_points,
    read_records,
    write_sweep,
)
from sphrom.sweep.workers import Failure

MOST_SHOWN = 10
"""Runs without a result that are shown one by one."""

FIGURES = {
    "time_step": ("time_step", "s"),
    "kinetic_energy": ("kinetic_energy", "J/m"),
    "largest_speed": ("largest_speed", "m/s"),
    "velocity_error_estimate": (f"{ERROR}velocity", "%"),
    "pressure_error_estimate": (f"{ERROR}pressure", "%"),
}
"""Figures of a run, with their datasets and units: energy at the end, the largest speed of all
points and snapshots, and root mean squares of estimated errors over those of the fields."""

Cells = dict[str, str | float | None]
"""The cells of a run's row in the table, by column; None without a result, or an estimate."""


def columns_of(case: Case, records: Sequence[RunRecord]) -> dict[str, str | None]:
    """Return the columns of the table of runs, with their units.

    `extrapolated` is `yes` where the estimates are for values outside of training, else `no`, and
    empty without estimates; `reason` tells why there is no result. What a case measures over time
    has statistics, and what it measures along lines none.
    """
    derivatives = next((record.derivative_names for record in records if record.values), ())
    names = {**dict.fromkeys(case.plan.parameter_names), "status": None}
    names |= {name: unit for name, (_, unit) in FIGURES.items()}
    names |= dict.fromkeys((*derivatives, "extrapolated", "reason"))
    return names | {
        f"{name}_{component}_{statistic}": UNITS[quantity]
        for name, section in case.scene.measure.items()
        for quantity in section.quantities
        for component in COMPONENTS.get(quantity, (quantity,))
        for statistic in STATISTICS
    }


class Results:
    """The runs of a sweep that are on disk."""

    def __init__(self, workspace: Workspace, points: Sequence[ParameterPoint]) -> None:
        self._workspace = workspace
        self._points = points
        self._whole = workspace.sweep()

    def discard(self) -> None:
        """Remove all runs."""
        for target in self._targets():
            target.path.unlink()

    def missing(self, points: Sequence[ParameterPoint]) -> list[ParameterPoint]:
        """Return the points without a run that is complete or unstable.

        Raises ArtifactError when runs that are there are of another case, or no longer asked for.
        """
        known: set[ParameterPoint] = set()
        with self._alone():
            for target in self._targets():
                with self._workspace.open(target) as artifact:
                    known.update(read_points(artifact))
                if target is self._whole and (extra := known.difference(self._points)):
                    raise ArtifactError(
                        f"{target.path} has runs that the case no longer asks for, such as "
                        f"{min(extra).label}; choose another sweep.name, or `--force` starts anew"
                    )
        return [point for point in points if point not in known]

    def gather(self, failed: Sequence[Failure] = ()) -> None:
        """Put all runs into the artifact and the table, and show them with their failures.

        Raises
        ------
        ArtifactError
            When no run has been made; when some have not, and the artifact holds the others.
        UnstableError
            When a run became unstable.
        SphromError
            When a run failed for another reason, of the kind of the first that did.
        """
        report, case, path = self._workspace.context.report, self._workspace.case, self._whole.path
        with self._alone():
            records, found = self._gathered(failed)
        names = columns_of(case, records)
        rows = [_cells(record, names) for record in records]
        write_csv(path.with_suffix(".csv"), rows_of_columns(names, rows))
        counts = Counter(STATES[record.status] for record in records)
        report.table(
            f"sweep {sweep_name(case)}: " + ", ".join(f"{n} runs {s}" for s, n in counts.items()),
            ("output", "least", "at", "mean", "greatest", "at"),
            list(_summary(records, rows, names)),
        )
        show_lost(report, [record for record in records if record.status != COMPLETE])
        report.info(f"all runs are in {path} and {path.stem}.csv")
        if found is not None:
            statistics.show(report, found)
        elif case.sweep.levels:
            report.warn("statistics: there are none, as too few runs have a result")
        if n_left := counts[STATES[NOT_RUN]]:
            raise ArtifactError(
                f"{n_left} of {len(records)} runs have not been made yet; the others were "
                "gathered, and their parts stay: collect again when all shards are done"
            )
        if n_unstable := counts[STATES[UNSTABLE]]:
            raise UnstableError(f"{n_unstable} of {len(records)} runs became unstable")
        if counts[STATES[FAILED]]:
            raise_failed(failed)

    def _gathered(self, failed: Sequence[Failure]) -> tuple[list[RunRecord], Statistics | None]:
        """Put all runs into the artifact, and return them with their statistics."""
        targets, case = list(self._targets()), self._workspace.case
        known = {
            failure.point: RunRecord(failure.point, FAILED, failure.reason) for failure in failed
        }
        for target in targets:
            with self._workspace.open(target) as artifact:
                ended = (COMPLETE, UNSTABLE)
                known |= {r.point: r for r in read_records(artifact) if r.status in ended}
        if known.keys().isdisjoint(self._points):
            raise ArtifactError(
                f"{self._whole.path}: none of its {len(self._points)} runs has been made; "
                f"`{self._whole.made_by}` makes them"
            )
        records = [known.get(point) or RunRecord(point, NOT_RUN) for point in self._points]
        complete = not any(record.status == NOT_RUN for record in records)
        if targets == [self._whole] and not failed and complete:
            found = self._stored_statistics()
            if case.sweep.levels == (() if found is None else tuple(found.levels.tolist())):
                name = self._whole.path.name
                self._workspace.context.report.info(f"{name}: there, and of this case: kept")
                return records, found
        found = statistics.statistics_of(case, records) if complete else None
        write_sweep(self._workspace, self._whole, records, found)
        statistics.publish(case, self._whole.path, records, found)
        if complete:  # otherwise others may be at it
            self._remove_parts(targets)
        return records, found

    def _stored_statistics(self) -> Statistics | None:
        with self._workspace.open(self._whole) as artifact:
            stored = "statistics/levels" in artifact
            return read_record(artifact, Statistics, "statistics") if stored else None

    def _targets(self) -> Iterator[Target]:
        """Yield the files on disk: the whole first."""
        if self._whole.path.exists():
            yield self._whole
        for path in sorted(parts_folder(self._workspace).glob("part-*.h5")):
            yield replace(self._whole, path=path)

    def _remove_parts(self, targets: Sequence[Target]) -> None:
        folder = parts_folder(self._workspace)
        for target in targets:
            if target.path != self._whole.path:
                target.path.unlink()
        # Leftovers of killed processes go; a folder that others write to stays.
        for leftover in (*folder.glob(".part-*.tmp"), *folder.glob(".part-*.lock")):
            leftover.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            folder.rmdir()

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """Wait until no other shard looks or gathers; go on where there are no locks."""
        descriptor = os.open(self._workspace.folder(), os.O_RDONLY)
        try:
            with contextlib.suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_EX)
            yield
        finally:
            os.close(descriptor)


def _cells(record: RunRecord, names: Iterable[str]) -> Cells:
    """Return the cells of a run's row, by the names of columns."""
    values = record.values
    cells: Cells = {**dict.fromkeys(names), **record.point.as_dict()}
    cells |= {"status": STATES[record.status], "reason": record.reason, "extrapolated": ""}
    cells |= {n: float(values[path]) for n, (path, _) in FIGURES.items() if path in values}
    if values:
        derivatives = values["derivatives"].tolist() if record.derivative_names else ()
        cells |= zip(record.derivative_names, derivatives, strict=True)
    if f"{ERROR}extrapolated" in values:
        cells["extrapolated"] = "yes" if values[f"{ERROR}extrapolated"] else "no"
    for path, series in values.items():
        if path.startswith("measure/"):
            _, name, quantity = path.split("/")
            for figure, value in measures.statistics({quantity: series}).items():
                cells[f"{name}_{figure}"] = value
    return cells


def _summary(
    records: Sequence[RunRecord], rows: Sequence[Cells], names: Mapping[str, str | None]
) -> Iterator[tuple[str, ...]]:
    """Yield a row for each figure: its extremes, where they are, and its mean."""
    for name, unit in names.items():
        if name == "time_step" or not (name in FIGURES or name.endswith("_mean")):
            continue
        found = [
            (value, record.point)
            for record, row in zip(records, rows, strict=True)
            if isinstance(value := row[name], float)
        ]
        if found:
            (least, at_least), (most, at_most) = min(found), max(found)
            mean = sum(value for value, _ in found) / len(found)
            cells = (least, at_least.label, mean, most, at_most.label)
            words = f"{name.replace('_', ' ')} [{unit}]"
            yield (words, *(format_figure(cell) for cell in cells))


def show_lost(report: Reporter, runs: Sequence[RunRecord | Failure]) -> None:
    """Show runs without a result, and why they have none."""
    for run in runs[:MOST_SHOWN]:
        state = "failed" if isinstance(run, Failure) else STATES[run.status]
        report.warn(": ".join(filter(None, (run.point.label, state, run.reason))))
    if len(runs) > MOST_SHOWN:
        report.warn(f"and {len(runs) - MOST_SHOWN} more without a result")


def raise_failed(failed: Sequence[Failure]) -> None:
    """Raise an error of the kind of the first failure, if there is one."""
    if failed:
        reason = f"{len(failed)} runs have no result; the same command tries them again"
        raise error_of(failed[0].exit_code, reason)
