"""What a sweep has found so far, in parts on disk, and what it becomes: an artifact and a table."""

from __future__ import annotations

import contextlib
import fcntl
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from sphrom.case.points import ParameterPoint
from sphrom.case.sweep_checks import sweep_name
from sphrom.errors import ArtifactError, CaseError, ResourceError, SphromError, UnstableError
from sphrom.plots.tables import format_figure, write_csv
from sphrom.store.sweep import (
    COMPLETE,
    FAILED,
    NOT_RUN,
    STATES,
    UNSTABLE,
    RunRecord,
    read_points,
    read_records,
)
from sphrom.store.workspace import Target, Workspace
from sphrom.sweep.tasks import Failure, part, parts_folder, write_sweep
from sphrom.text import exact

MOST_SHOWN = 10
"""Runs without a result that are shown one by one."""
_CLASSES = {error.exit_code: error for error in (CaseError, ArtifactError, ResourceError)}


@dataclass(frozen=True)
class SweepRow:
    """One run of a sweep."""

    reynolds: float
    status: str
    time_step: float | None = field(metadata={"unit": "s"})
    kinetic_energy: float | None = field(metadata={"unit": "J/m"})
    """At the end."""
    largest_speed: float | None = field(metadata={"unit": "m/s"})
    """Of all points and snapshots."""
    velocity_error_estimate: float | None = field(metadata={"unit": "%"})
    """Root mean square over the run, over the velocity's."""
    pressure_error_estimate: float | None = field(metadata={"unit": "%"})
    extrapolated: str
    """`yes` where the estimates are for values outside of training, else `no`; empty without."""
    reason: str
    """Why there is no result."""


class Results:
    """The runs of a sweep that are on disk."""

    def __init__(self, workspace: Workspace, points: Sequence[ParameterPoint]) -> None:
        self._workspace = workspace
        self._points = points
        self._whole = workspace.sweep()

    def discard(self) -> None:
        """Forget everything."""
        for target in self._targets():
            target.path.unlink()

    def missing(self, points: Sequence[ParameterPoint]) -> list[ParameterPoint]:
        """Return those points at which there is no run yet that ended by itself.

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
        """Put all runs into the artifact and the table, show them, and say what went wrong.

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
            records = self._gathered(failed)
        self._show(records)
        _raise_problems(records, failed)

    def _gathered(self, failed: Sequence[Failure]) -> list[RunRecord]:
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
        rows = [_row(record) for record in records]
        if targets == [self._whole] and not failed and complete:
            self._workspace.context.report.info(
                f"{self._whole.path.name}: there, and of this case: kept"
            )
        else:
            write_sweep(self._workspace, self._whole, records)
        write_csv(self._whole.path.with_suffix(".csv"), rows)
        if complete:  # otherwise others may be at it
            self._remove_parts(targets)
        return records

    def _targets(self) -> Iterator[Target]:
        """Yield what is on disk: the whole first."""
        if self._whole.path.exists():
            yield self._whole
        for path in sorted(parts_folder(self._workspace).glob("part-*.h5")):
            yield part(self._workspace, path)

    def _remove_parts(self, targets: Sequence[Target]) -> None:
        folder = parts_folder(self._workspace)
        for target in targets:
            if target.path != self._whole.path:
                target.path.unlink()
        # What processes that were killed have left; a folder that others write to stays.
        for leftover in (*folder.glob(".part-*.tmp"), *folder.glob(".part-*.lock")):
            leftover.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            folder.rmdir()

    @contextlib.contextmanager
    def _alone(self) -> Iterator[None]:
        """Wait until no other shard looks or gathers; where there are no locks, do without."""
        descriptor = os.open(self._workspace.folder(), os.O_RDONLY)
        try:
            with contextlib.suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_EX)
            yield
        finally:
            os.close(descriptor)

    def _show(self, records: Sequence[RunRecord]) -> None:
        report, name = self._workspace.context.report, sweep_name(self._workspace.case)
        counts = Counter(STATES[record.status] for record in records)
        report.table(
            f"sweep {name}: " + ", ".join(f"{n} runs {word}" for word, n in counts.items()),
            ("figure", "least", "at", "mean", "greatest", "at"),
            list(_summary([_row(record) for record in records])),
        )
        without = [record for record in records if record.status != COMPLETE]
        for record in without[:MOST_SHOWN]:
            why = f": {record.reason}" if record.reason else ""
            report.warn(f"{record.point.label}: {STATES[record.status]}{why}")
        if len(without) > MOST_SHOWN:
            report.warn(f"and {len(without) - MOST_SHOWN} more, see the table")
        report.info(f"all runs are in {self._whole.path} and {self._whole.path.stem}.csv")


def _row(record: RunRecord) -> SweepRow:
    found = record.result
    errors = None if found is None else found.errors
    return SweepRow(
        reynolds=record.point.reynolds,
        status=STATES[record.status],
        time_step=None if found is None else found.time_step,
        kinetic_energy=None if found is None else found.kinetic_energy,
        largest_speed=None if found is None else found.largest_speed,
        velocity_error_estimate=None if errors is None else errors.velocity,
        pressure_error_estimate=None if errors is None else errors.pressure,
        extrapolated="" if errors is None else ("yes" if errors.extrapolated else "no"),
        reason=record.reason,
    )


def _summary(rows: Sequence[SweepRow]) -> Iterator[tuple[str, ...]]:
    """Yield a row for each figure: its extremes, where they are, and its mean."""
    for name, words in (
        ("kinetic_energy", "kinetic energy at the end [J/m]"),
        ("largest_speed", "largest speed [m/s]"),
        ("velocity_error_estimate", "estimated error of velocity [%]"),
        ("pressure_error_estimate", "estimated error of pressure [%]"),
    ):
        found = [(getattr(row, name), row.reynolds) for row in rows]
        found = [pair for pair in found if pair[0] is not None]
        if found:
            least, most = min(found), max(found)
            mean = sum(value for value, _ in found) / len(found)
            figures = (least[0], f"Re {exact(least[1])}", mean, most[0], f"Re {exact(most[1])}")
            yield (words, *(format_figure(figure) for figure in figures))


def _raise_problems(records: Sequence[RunRecord], failed: Sequence[Failure]) -> None:
    left = sum(record.status == NOT_RUN for record in records)
    if left:
        raise ArtifactError(
            f"{left} of {len(records)} runs have not been made yet; what is there was gathered, "
            "and its parts stay: collect again when all shards are done"
        )
    unstable = sum(record.status == UNSTABLE for record in records)
    if unstable:
        raise UnstableError(f"{unstable} of {len(records)} runs became unstable")
    missing = sum(record.status == FAILED for record in records)
    if missing:
        code = failed[0].exit_code if failed else ArtifactError.exit_code
        raise _CLASSES.get(code, SphromError)(
            f"{missing} of {len(records)} runs have no result; the same command tries them again"
        )


def tell_share(workspace: Workspace, n_runs: int, n_left: int, failed: Sequence[Failure]) -> None:
    """Say how far a sweep in shards has come. Raises SphromError where runs of this one failed."""
    report = workspace.context.report
    for failure in failed[:MOST_SHOWN]:
        report.warn(f"{failure.point.label}: {failure.reason}")
    if failed:
        raise _CLASSES.get(failed[0].exit_code, SphromError)(
            f"{len(failed)} runs of this shard have no result; the same command tries them again"
        )
    report.info(
        f"{n_runs - n_left} of {n_runs} runs are done; the last shard gathers them, or "
        "`sphrom sweep CASE --collect`"
    )
