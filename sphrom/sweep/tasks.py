"""One task of a sweep: some of its runs, in whatever process, whose results become a part on disk.

A task is all that a process elsewhere needs: the case as text, the folder, and the points. It gives
back only what went wrong; what was found is in the part, which is there as a whole or not at all.
"""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from sphrom.case.loader import case_of_text
from sphrom.case.points import ParameterPoint
from sphrom.case.sweep_checks import FULL, sweep_model, sweep_name
from sphrom.errors import ArtifactError, ResourceError, SphromError
from sphrom.setup.context import StageContext
from sphrom.store.sweep import RunRecord, write_records
from sphrom.store.workspace import Target, Workspace
from sphrom.sweep.runs import SweptModel, places

_ONE_AT_A_TIME = threading.Lock()
"""Compiled loops must not run in two threads at once, as the tasks of some workers would."""


@dataclass(frozen=True)
class SweepTask:
    """Some runs of a sweep."""

    case_text: str
    out: str
    """The folder of the case's artifacts, the same wherever the task is run."""
    points: tuple[ParameterPoint, ...]
    threads: int
    force: bool
    """Whether runs that are there are made again."""
    command: str
    """Which call of the program it belongs to: what one call reads is read once in a process."""


@dataclass(frozen=True)
class Failure:
    """Why there is no result at a point, other than that the run became unstable."""

    point: ParameterPoint
    reason: str
    exit_code: int


def failures(task: SweepTask, reason: str, exit_code: int) -> tuple[Failure, ...]:
    """Return that nothing came of a task."""
    return tuple(Failure(point, reason, exit_code) for point in task.points)


def attempt(task: SweepTask) -> tuple[Failure, ...]:
    """Do a task, and return what went wrong, mistakes in the program included."""
    try:
        with _ONE_AT_A_TIME:
            return _run(task)
    except SphromError as error:
        return failures(task, str(error), error.exit_code)
    except MemoryError:
        return failures(task, "out of memory", ResourceError.exit_code)
    except Exception as error:
        return failures(task, f"{type(error).__name__}: {error}", SphromError.exit_code)


def _run(task: SweepTask) -> tuple[Failure, ...]:
    swept = _swept(task.case_text, task.out, task.threads, task.force, task.command)
    records: list[RunRecord] = []
    failed: list[Failure] = []
    for point in task.points:
        require_folder(swept.workspace)
        try:
            records.append(swept.model.run(point))
        except SphromError as error:
            failed.append(Failure(point, str(error), error.exit_code))
    if records:
        require_folder(swept.workspace)
        write_part(swept.workspace, records)
    return tuple(failed)


def require_folder(workspace: Workspace) -> None:
    """Raise ArtifactError when somebody has removed the folder of the artifacts meanwhile."""
    if not workspace.out.is_dir():
        raise ArtifactError(f"{workspace.out} was removed while the sweep ran")


@dataclass(frozen=True)
class _Swept:
    workspace: Workspace
    model: SweptModel


@lru_cache(maxsize=1)
def _swept(case_text: str, out: str, threads: int, force: bool, command: str) -> _Swept:
    case = case_of_text(case_text)
    # A run that was stopped goes on from its checkpoint, like the sweep as a whole.
    context = StageContext(
        case, Path(out), force, threads, _Silent(), resume=not force, bitwise=True
    )
    workspace = Workspace(context)
    return _Swept(workspace, SweptModel(workspace))


class _Silent:
    """Keeps what runs have to say to itself: many would speak at once, some of them elsewhere."""

    def info(self, text: str) -> None:
        """Keep it."""

    def warn(self, text: str) -> None:
        """Keep it."""

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Keep it."""

    @contextmanager
    def progress(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Keep it."""
        yield lambda done: None


def parts_folder(workspace: Workspace) -> Path:
    """Return the folder of the parts of a sweep."""
    return workspace.out / f"sweep-{sweep_name(workspace.case)}"


def part(workspace: Workspace, path: Path) -> Target:
    """Return a part of a sweep: made with the same and from the same as the whole."""
    return replace(workspace.sweep(), path=path)


def write_part(workspace: Workspace, records: Sequence[RunRecord]) -> None:
    """Write a part, called after its points."""
    text = "\n".join(record.point.label for record in records)
    name = f"part-{hashlib.sha256(text.encode()).hexdigest()[:16]}.h5"
    write_sweep(workspace, part(workspace, parts_folder(workspace) / name), records)


def write_sweep(workspace: Workspace, target: Target, records: Sequence[RunRecord]) -> None:
    """Write runs of a sweep, over what is there."""
    model = sweep_model(workspace.case)
    over = Workspace(replace(workspace.context, force=True))
    with over.create(target) as artifact:
        name = FULL if model is None else model.name
        write_records(artifact, name, records, places(workspace))
