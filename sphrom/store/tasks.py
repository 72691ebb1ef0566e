"""Tasks: runs of a case that other processes make, of this machine or of another one.

A worker that sees the folder of the artifacts works there. Any other worker gets the files that a
task needs, works in a folder of its own, and sends back the artifacts that it has made. Such a
folder is named by the task and its files, and stays only if a run was stopped there: if the same
task comes back, the run continues from its checkpoint.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from sphrom.case.loader import case_of_text
from sphrom.case.models import FILE, Case
from sphrom.case.points import ParameterPoint
from sphrom.console import Level, Reporter
from sphrom.errors import ResourceError, SphromError
from sphrom.setup.context import StageContext
from sphrom.store.artifact_folder import Target, make_folder
from sphrom.store.checkpoints import left
from sphrom.store.workspace import Workspace
from sphrom.whole_files import write_whole

CASE = "case"
"""Folder of the files that the case names, within a worker's own folder."""
_ONE_AT_A_TIME = threading.Lock()
"""A lock, because compiled loops must not run in two threads, as tasks of Dask workers may."""


@dataclass(frozen=True)
class Task:
    """Some runs of a case, with all data that another process needs to make them."""

    case_text: str
    case_folder: str
    """Folder of the files that the case names."""
    out: str
    """Folder of the case's artifacts."""
    points: tuple[ParameterPoint, ...]
    threads: int | None
    """Number of threads; None for the worker's share of its machine."""
    force: bool
    """Whether to make existing runs again."""
    command: str
    """Identity of the command, because a process reads shared data once per command."""
    token: str = ""
    """A hidden file in the folder of the artifacts, by which workers of a cluster know it.

    It is empty for processes of this machine, which see the folder in any case.
    """
    model: str = ""
    """The reduced model of the runs; empty for the full model, and for sweeps."""
    options: tuple[tuple[str, Any], ...] = ()
    """Further options of the context, by name."""

    @property
    def is_shared(self) -> bool:
        """Whether this process sees the folder of the artifacts."""
        return not self.token or os.path.exists(self.token)

    def context(self, report: Reporter | None = None) -> StageContext:
        """Return the context of the task; without a reporter it reports nothing."""
        case = case_of_text(self.case_text, self.case_folder)
        threads = _share_of_cores() if self.threads is None else self.threads
        report = report or Recorder()
        out = Path(self.out)
        return StageContext(case, out, self.force, threads, report, **dict(self.options))


@dataclass(frozen=True)
class Failure:
    """The reason of a failure at a point, other than an unstable run."""

    point: ParameterPoint
    reason: str
    kind: type[SphromError]
    model: str = ""

    @property
    def text(self) -> str:
        """The run and the reason, in words."""
        run = f"{self.model}, {self.point.label}" if self.model else self.point.label
        return f"{run}: {self.reason}"


@dataclass(frozen=True)
class Line:
    """A line that a task reports; a warning has no level."""

    text: str
    level: Level | None = None

    def show(self, report: Reporter) -> None:
        """Report the line as the task would have done in this process."""
        if self.level is None:
            report.warn(self.text)
        elif self.level is Level.DETAIL:
            report.info(self.text)
        else:
            report.note(self.text)


Told = tuple[Failure | Line, ...]
Do = Callable[[Task], Told]
"""A function that does a task and returns its failures and lines.

Other processes import it by name.
"""
Files = Mapping[str, bytes]
"""The contents of files, by names relative to a folder."""


@dataclass(frozen=True)
class Answer:
    """The answer of a worker to a task."""

    told: Told = ()
    files: Files = field(default_factory=dict)
    """The artifacts that it has made in a folder of its own."""
    lacks_files: bool = False
    """Whether the worker did nothing because it does not see the folder of the artifacts."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Recorder(Reporter):
    """A reporter that keeps lines, which the command shows later."""

    lines: list[Line] = field(default_factory=list)
    _level: Level = Level.DETAIL
    _has_progress: bool = False

    def warn(self, text: str) -> None:
        """Keep a warning."""
        self.lines.append(Line(text))

    def _tell(self, text: str, level: Level) -> None:
        self.lines.append(Line(text, level))


def recorded(task: Task, make: Callable[[Workspace], object]) -> Told:
    """Make something in the workspace of a task, and return the lines that it reports."""
    report = Recorder()
    make(Workspace(task.context(report)))
    return tuple(report.lines)


def attempt(do: Do, task: Task) -> Told:
    """Do a task, and return its failures, including programming errors."""
    try:
        with _ONE_AT_A_TIME:
            return do(task)
    except MemoryError:
        return failures(task, ResourceError("out of memory"))
    except Exception as error:
        return failures(task, error)


def failures(task: Task, error: Exception) -> tuple[Failure, ...]:
    """Return the failures of a task at all its points."""
    if not isinstance(error, SphromError):
        error = SphromError(f"{type(error).__name__}: {error}")
    return tuple(Failure(point, str(error), type(error), task.model) for point in task.points)


def files_of_case(case: Case) -> Iterator[str]:
    """Yield the tables that a case names below its folder."""

    def named(value: Any) -> Iterator[str]:
        if isinstance(value, dict):
            if isinstance(value.get(FILE), str) and value.get("sha256"):
                yield value[FILE]
            value = list(value.values())
        for each in value if isinstance(value, list) else ():
            yield from named(each)

    names = named(case.model_dump(mode="json"))
    return (n for n in names if not Path(n).is_absolute() and ".." not in Path(n).parts)


def files_of(workspace: Workspace, target: Target) -> Iterator[Path]:
    """Yield the existing files with which an artifact is made elsewhere, or continued.

    They are the artifact, its checkpoint, its inputs, or the inputs of missing ones, and the
    starting positions.
    """
    paths = {target.path, workspace.packing().path, *left(target)}
    for parent in target.parents.values():
        if parent.path.exists():
            paths.add(parent.path)
        else:
            paths.update(files_of(workspace, parent))
    yield from (path for path in paths if path.is_file() and not path.name.startswith("."))


def do_elsewhere(do: Do, task: Task, files: Files) -> Answer:
    """Do a task in a folder of this worker's own, with the files that it needs."""
    named = replace(task, case_folder=CASE, command="", token="", options=())
    digest = hashlib.sha256(repr((do.__qualname__, named)).encode())
    for name, content in files.items():
        digest.update(name.encode() + hashlib.sha256(content).digest())
    folder = make_folder(_scratch() / f"sphrom-{digest.hexdigest()[:24]}")
    for name, content in files.items():
        path = folder / name
        make_folder(path.parent)
        write_whole(path, content)
    sent = {folder / name for name in files}
    before = {path: written for path, written in _artifacts(folder).items() if path in sent}
    told = attempt(do, replace(task, out=str(folder), case_folder=str(folder / CASE)))
    made = {
        str(path.relative_to(folder)): path.read_bytes()
        for path, written in _artifacts(folder).items()
        if before.get(path) != written
    }
    if not list(folder.glob("*.checkpoint")):
        shutil.rmtree(folder, ignore_errors=True)
    there = str(folder)
    told = tuple(
        replace(each, text=each.text.replace(there, task.out)) if isinstance(each, Line) else each
        for each in told
    )
    return Answer(told, made)


def _artifacts(folder: Path) -> dict[Path, int]:
    """Return the times at which the artifacts in a folder were written [ns]."""
    paths = (path for path in folder.rglob("*.h5") if not path.name.startswith("."))
    return {path: path.stat().st_mtime_ns for path in paths}


def _scratch() -> Path:
    """Return the folder for temporary files, beside those of a Dask worker."""
    from distributed import get_worker

    return Path(get_worker().local_directory).parent


def _share_of_cores() -> int:
    """Return the number of cores of this machine over that of the Dask workers on it."""
    from distributed import get_client, get_worker

    def machine(address: str) -> str | None:
        return urlsplit(address).hostname

    here = machine(get_worker().address)
    number = sum(machine(address) == here for address in get_client().nthreads())
    return max(1, len(os.sched_getaffinity(0)) // max(1, number))
