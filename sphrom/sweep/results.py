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
    "time_step": "s",
    "kinetic_energy": "J/m",
    "largest_speed": "m/s",
    "velocity_error_estimate": "%",
    "pressure_error_estimate": "%",
}
"""Figures of a run, with their units: energy at the end, the largest speed of all points and
snapshots, and root mean squares of estimated errors over those of the fields."""
NAMES = {"reynolds": "Re"}
"""Parameters with a usual symbol."""
SUMMARY = {
    "kinetic_energy": "kinetic energy at the end [J/m]",
    "largest_speed": "largest speed [m/s]",
    "velocity_error_estimate": "estimated error of velocity [%]",
    "pressure_error_estimate": "estimated error of pressure [%]",
}
"""The figures that are summarised."""


Cells = dict[str, str | float | None]
"""The cells of a run's row in the table, by column; None without a result, or an estimate."""


def columns_of(case: Case, records: Sequence[RunRecord]) -> dict[str, str | None]:
    """Return the columns of the table of runs, with their units.

    `extrapolated` is `yes` where the estimates are for values outside of training, else `no`, and
    empty without estimates; `reason` tells why there is no result. What a case measures over time
    has statistics, and what it measures along lines none.
    """
    derivatives = next((record.derivative_names for record in records if record.values), ())
    names = {**dict.fromkeys(case.plan.parameter_names), "status": None, **FIGURES}
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
        self._statistics: Statistics | None = None

    def discard(self) -> None:
        """Remove all runs."""
        for target in self._targets():
            target.path.unlink()

    def missing(self, points: Sequence[ParameterPoint]) -> list[ParameterPoint]:
        """Return the points without a run that is complete or unstable.

        Raises ArtifactError when runs that are there are of another case, or no longer asked for.
        """
        with self._alone():
            known = self._known()
        return [point for point in points if point not in known]

    def _known(self) -> set[ParameterPoint]:
        known: set[ParameterPoint] = set()
        for target in self._targets():
            with self._workspace.open(target) as artifact:
                found = read_points(artifact)
            known.update(found)
            if target is self._whole and not known.issubset(self._points):
                extra = min(known.difference(self._points))
                raise ArtifactError(
                    f"{target.path} has runs that the case no longer asks for, such as "
                    f"{extra.label}; choose another sweep.name, or `--force` starts anew"
                )
        return known

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
        with self._alone():
            records, rows = self._gathered(failed)
        self._show(records, rows)
        report = self._workspace.context.report
        if self._statistics is not None:
            statistics.show(report, self._statistics)
        elif self._workspace.case.sweep.levels:
            report.warn("statistics: there are none, as too few runs have a result")
        _raise_problems(records, failed)

    def _gathered(self, failed: Sequence[Failure]) -> tuple[list[RunRecord], list[Cells]]:
        targets = list(self._targets())
        known: dict[ParameterPoint, RunRecord] = {}
        for target in targets:
            with self._workspace.open(target) as artifact:
                ended = (COMPLETE, UNSTABLE)
                known |= {r.point: r for r in read_records(artifact) if r.status in ended}
        for failure in failed:
            known.setdefault(failure.point, RunRecord(failure.point, FAILED, reason=failure.reason))
        if known.keys().isdisjoint(self._points):
            raise ArtifactError(
                f"{self._whole.path}: none of its {len(self._points)} runs has been made; "
                f"`{self._whole.made_by}` makes them"
            )
        records = [known.get(point) or RunRecord(point, NOT_RUN) for point in self._points]
        complete = not any(record.status == NOT_RUN for record in records)
        kept = targets == [self._whole] and not failed and complete
        if kept and self._has_statistics():
            self._workspace.context.report.info(
                f"{self._whole.path.name}: there, and of this case: kept"
            )
        else:
            case, self._statistics = self._workspace.case, None
            if complete:
                self._statistics = statistics.statistics_of(case, records)
            write_sweep(self._workspace, self._whole, records, self._statistics)
            statistics.publish(case, self._whole.path, records, self._statistics)
        names = columns_of(self._workspace.case, records)
        rows = [_cells(record, names) for record in records]
        write_csv(self._whole.path.with_suffix(".csv"), rows_of_columns(names, rows))
        if complete:  # otherwise others may be at it
            self._remove_parts(targets)
        return records, rows

    def _has_statistics(self) -> bool:
        """Whether the artifact holds the statistics that the case asks for; they are read."""
        with self._workspace.open(self._whole) as artifact:
            if "statistics/levels" in artifact:
                self._statistics = read_record(artifact, Statistics, "statistics")
        return statistics.as_asked(self._workspace.case, self._statistics)

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

    def _show(self, records: Sequence[RunRecord], rows: Sequence[Cells]) -> None:
        report, name = self._workspace.context.report, sweep_name(self._workspace.case)
        counts = Counter(STATES[record.status] for record in records)
        report.table(
            f"sweep {name}: " + ", ".join(f"{n} runs {word}" for word, n in counts.items()),
            ("output", "least", "at", "mean", "greatest", "at"),
            list(_summary(records, rows, columns_of(self._workspace.case, records))),
        )
        without = [record for record in records if record.status != COMPLETE]
        for record in without[:MOST_SHOWN]:
            why = f": {record.reason}" if record.reason else ""
            report.warn(f"{record.point.label}: {STATES[record.status]}{why}")
        if len(without) > MOST_SHOWN:
            report.warn(f"and {len(without) - MOST_SHOWN} more, see the table")
        report.info(f"all runs are in {self._whole.path} and {self._whole.path.stem}.csv")


def _cells(record: RunRecord, names: Iterable[str]) -> Cells:
    """Return the cells of a run's row, by the names of columns."""
    values, found = record.values, dict.fromkeys(names)
    cells: Cells = {**found, **record.point.as_dict()}
    cells |= {"status": STATES[record.status], "reason": record.reason, "extrapolated": ""}
    for name in FIGURES:
        quantity, estimated, _ = name.partition("_error_estimate")
        stored = f"{ERROR}{quantity}" if estimated else name
        if stored in values:
            cells[name] = float(values[stored])
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
    means = {n: f"{n} [{u}]".replace("_", " ") for n, u in names.items() if n.endswith("_mean")}
    for name, words in {**SUMMARY, **means}.items():
        found = [
            (value, tuple(record.point.as_dict().items()))
            for record, row in zip(records, rows, strict=True)
            if isinstance(value := row[name], float)
        ]
        if found:
            least, most = min(found), max(found)
            mean = sum(value for value, _ in found) / len(found)
            cells = (least[0], _place(least[1]), mean, most[0], _place(most[1]))
            yield (words, *(format_figure(cell) for cell in cells))


def _place(values: Sequence[tuple[str, float]]) -> str:
    """Return where a figure is found, such as `Re 100, lid 0.8`."""
    return ", ".join(f"{NAMES.get(name, name)} {value:.6g}" for name, value in values)


def _raise_problems(records: Sequence[RunRecord], failed: Sequence[Failure]) -> None:
    counts, total = Counter(record.status for record in records), len(records)
    if counts[NOT_RUN]:
        raise ArtifactError(
            f"{counts[NOT_RUN]} of {total} runs have not been made yet; the others were "
            "gathered, and their parts stay: collect again when all shards are done"
        )
    if counts[UNSTABLE]:
        raise UnstableError(f"{counts[UNSTABLE]} of {total} runs became unstable")
    if counts[FAILED]:
        _raise_failed(failed, f"{counts[FAILED]} of {total} runs")


def _raise_failed(failed: Sequence[Failure], runs: str) -> None:
    """Raise an error of the kind of the first failure."""
    code = failed[0].exit_code if failed else ArtifactError.exit_code
    raise error_of(code, f"{runs} have no result; the same command tries them again")


def report_shard(workspace: Workspace, n_runs: int, n_left: int, failed: Sequence[Failure]) -> None:
    """Tell how far a sweep in shards is. Raises SphromError where runs of this one failed."""
    report = workspace.context.report
    for failure in failed[:MOST_SHOWN]:
        report.warn(f"{failure.point.label}: {failure.reason}")
    if failed:
        _raise_failed(failed, f"{len(failed)} runs of this shard")
    report.info(
        f"{n_runs - n_left} of {n_runs} runs are done; the last shard gathers them, or "
        "`sphrom sweep CASE --collect`"
    )
