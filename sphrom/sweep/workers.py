"""Workers that make runs at many points: processes of this machine, or those of a Dask cluster.

Both are executors of `concurrent.futures`. If a process runs out of memory, it is killed and the
tasks of all processes are lost; they are started again by fewer processes. A terminated process
first removes the file that it is writing, and a process ends with its parent.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import uuid
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    as_completed,
)
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from sphrom.case.loader import case_of_text
from sphrom.case.points import ParameterPoint
from sphrom.console import Reporter, SilentReporter
from sphrom.errors import CaseError, ResourceError, SphromError
from sphrom.kernels.code_cache import CodeCacheWarning
from sphrom.kernels.jit import code_cache
from sphrom.machine import one_blas_thread
from sphrom.setup.context import StageContext
from sphrom.signals import Terminated, interrupts_come_again, termination_interrupts
from sphrom.store.workspace import Workspace

FEWER = 4
"""Factor that reduces the number of processes after one was lost."""
CLEANING = 10.0
"""Time for a process to clean up before it is killed [s]."""
PATIENCE = 15.0
"""Time for a scheduler to answer [s]."""
LOST = ResourceError("its process was lost repeatedly, probably out of memory")
INSTALL = "pip install 'sphrom[cluster]'"
_ONE_AT_A_TIME = threading.Lock()
"""A lock, because compiled loops must not run in two threads, as tasks of Dask workers may."""


@dataclass(frozen=True)
class Task:
    """Some runs of a case, with all data that another process needs to make them."""

    case_text: str
    case_folder: str
    """Folder of the files that the case names."""
    out: str
    """Folder of the case's artifacts, the same on all machines."""
    points: tuple[ParameterPoint, ...]
    threads: int
    force: bool
    """Whether to make existing runs again."""
    command: str
    """Identity of the command, because a process reads shared data once per command."""

    def context(self, **settings: Any) -> StageContext:
        """Return the context of the task, with further settings."""
        case = case_of_text(self.case_text, self.case_folder)
        return StageContext(
            case,
            out=Path(self.out),
            force=self.force,
            threads=self.threads,
            report=SilentReporter(),
            bitwise=True,
            **settings,
        )


@dataclass(frozen=True)
class Failure:
    """The reason of a failure at a point, other than an unstable run."""

    point: ParameterPoint
    reason: str
    kind: type[SphromError]


Failures = tuple[Failure, ...]
Do = Callable[[Task], Failures]
"""A function that does a task and returns its failures; other processes import it by name."""


def attempt(do: Do, task: Task) -> Failures:
    """Do a task, and return its failures, including programming errors."""
    try:
        with _ONE_AT_A_TIME:
            return do(task)
    except MemoryError:
        return _failures(task, ResourceError("out of memory"))
    except Exception as error:
        return _failures(task, error)


def _failures(task: Task, error: Exception) -> Failures:
    if not isinstance(error, SphromError):
        error = SphromError(f"{type(error).__name__}: {error}")
    return tuple(Failure(point, str(error), type(error)) for point in task.points)


class Workers:
    """Does tasks in this process, in several processes of this machine, or on a Dask cluster."""

    def __init__(self, number: int, report: Reporter, client: Any = None) -> None:
        self._report, self._client = report, client
        self.number = number if client is None else max(1, len(client.nthreads()))
        """Number of parallel tasks; workers that join a cluster later add to it."""

    def run(
        self,
        name: str,
        workspace: Workspace,
        points: Sequence[ParameterPoint],
        do: Do,
        size: int = 1,
    ) -> list[Failure]:
        """Make runs of a case at points, in tasks of `size` runs, and return the failures."""
        alone = self.number == 1 and self._client is None
        if workspace.case.scene.has_functions and not alone:
            raise CaseError("--workers: other processes don't have the functions of a flow; set 1")
        task = Task(
            case_text=workspace.case.text,
            case_folder=str(workspace.case.folder),
            out=str(workspace.out.resolve()),
            points=(),
            threads=workspace.threads if alone else 1,
            force=workspace.context.force,
            command=str(uuid.uuid4()),
        )
        shares = (tuple(points[k : k + size]) for k in range(0, len(points), size))
        tasks = [replace(task, points=share) for share in shares]
        failed: list[Failure] = []
        # On any exception, the processes end immediately.
        with (
            self._report.progress(name, len(points)) as advance,
            closing(self.done(tasks, do)) as done,
        ):
            for task, failures in done:
                failed += failures
                advance(len(task.points))
        return failed

    def done(self, tasks: Sequence[Task], do: Do) -> Generator[tuple[Task, Failures], None, None]:
        """Yield completed tasks in any order, and restart those of lost processes."""
        if self.number == 1 and self._client is None:
            yield from ((task, attempt(do, task)) for task in tasks)
            return
        left = dict.fromkeys(tasks)
        number = self.number
        while left:
            with suppress(BrokenExecutor), self._executor(number) as executor:
                running = {executor.submit(_attempt_there, do, task): task for task in left}
                for future in as_completed(running):
                    task = running[future]
                    if (failures := _result(future, task)) is not None:
                        del left[task]
                        yield task, failures
            if left and number == 1:  # the first task has killed the only process
                task = next(iter(left))
                del left[task]
                yield task, _failures(task, LOST)
            number = self.number if number == 1 else max(1, number // FEWER)

    @contextmanager
    def _executor(self, number: int) -> Iterator[Executor]:
        if self._client is not None:
            executor = self._client.get_executor(pure=False)
            try:
                yield executor
            finally:
                executor.shutdown(wait=False)
            return
        code_cache()  # warns if processes can't share compiled code
        # Processes are spawned, because a process with threads can't be forked.
        context = get_context("spawn")
        theirs, ours = context.Pipe(duplex=False)
        pool = ProcessPoolExecutor(number, context, _begin, (theirs,))
        try:
            yield pool
        except BaseException:
            ours.close()  # this ends the processes during their tasks
            raise
        finally:
            pool.shutdown(cancel_futures=True)
            ours.close()


def _result(future: Future[Failures], task: Task) -> Failures | None:
    """Return the failures of an ended task; None if a process died, which ends all tasks."""
    try:
        return future.result()
    except BrokenExecutor:
        return None
    except CancelledError:
        return _failures(task, ResourceError("the scheduler was lost"))
    except Exception as error:
        killed = type(error).__name__ == "KilledWorker"  # raised after Dask has tried it again
        return _failures(task, LOST if killed else error)


def _begin(parent: Connection) -> None:
    """Make a new process end with its parent, or when the parent closes the connection."""
    # An interrupt from the keyboard ends the parent, which then ends this process.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for kind in (CodeCacheWarning, RuntimeWarning):  # the parent shows them
        warnings.simplefilter("ignore", kind)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Connection) -> None:
    with suppress(EOFError, OSError):
        parent.recv()
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(CLEANING)
    os.kill(os.getpid(), signal.SIGKILL)


def _attempt_there(do: Do, task: Task) -> Failures:
    """Do a task in a process of its own, which ends when it is terminated."""
    try:
        with one_blas_thread(), termination_interrupts(), interrupts_come_again():
            return attempt(do, task)
    except Terminated:
        os._exit(128 + signal.SIGTERM)


@contextmanager
def start_workers(number: int, scheduler: str | None, report: Reporter) -> Iterator[Workers]:
    """Provide workers on this machine, or on the Dask cluster with a scheduler's address.

    Raises CaseError without the library, or if no scheduler answers at tcp://node:8786 or the like.
    """
    if scheduler is None:
        yield Workers(number, report)
        return
    try:
        from distributed import Client

        client = Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except ImportError as error:
        raise CaseError(f"--scheduler: needs the library distributed: {INSTALL}") from error
    except (OSError, ValueError) as error:
        raise CaseError(
            f"--scheduler: no scheduler answers at {scheduler}; start one with `dask scheduler`, "
            f"and workers with `dask worker {scheduler} --nworkers auto --nthreads 1`"
        ) from error
    with client:
        if not client.nthreads():
            report.warn(f"--scheduler: {scheduler} has no workers yet; runs wait for workers")
        yield Workers(number, report, client)


def check_options(number: int | None, scheduler: str | None) -> None:
    """Raise CaseError if options contradict each other."""
    if number is not None and scheduler is not None:
        raise CaseError("--workers: can't be combined with --scheduler, which has its own workers")
