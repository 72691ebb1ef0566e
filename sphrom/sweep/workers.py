"""Workers that make the runs at many points: processes of this machine, or a Dask cluster's.

Both are executors of `concurrent.futures`. A process whose memory runs out is killed, and takes the
tasks with it that the others do: these are begun again. One that is terminated first removes the
file that it is writing, and one without its parent ends.
"""

from __future__ import annotations

import os
import signal
import threading
import time
import warnings
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
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

MOST_ATTEMPTS = 3
"""Times that a task is begun, if its processes die; the last time it is the only one."""
CLEANING = 10.0
"""Seconds that a process is given to clean up before it is killed."""
PATIENCE = 15.0
"""Seconds that a scheduler is given to answer."""
INSTALL = "pip install 'sphrom[cluster]'"
_ONE_AT_A_TIME = threading.Lock()
"""Compiled loops must not run in two threads at once, as the tasks of some workers would."""


@dataclass(frozen=True)
class Task:
    """Some runs of a case, with all that a process elsewhere needs to make them."""

    case_text: str
    case_folder: str
    """Of the files that the case names."""
    out: str
    """The folder of the case's artifacts, the same wherever the task is run."""
    points: tuple[ParameterPoint, ...]
    threads: int
    force: bool
    """Whether runs that are there are made again."""
    command: str
    """The call of the program that it belongs to: a process reads shared data once a call."""

    @classmethod
    def of(
        cls, workspace: Workspace, points: Sequence[ParameterPoint], threads: int, command: str
    ) -> Task:
        """Return the task to make runs of a workspace's case."""
        folder, out = str(workspace.case.folder), str(workspace.out.resolve())
        about = tuple(points), threads, workspace.context.force, command
        return cls(workspace.case_text, folder, out, *about)

    def context(self, **given: Any) -> StageContext:
        """Return the context in which it is done, with other settings that are given."""
        case = case_of_text(self.case_text, self.case_folder)
        about = Path(self.out), self.force, self.threads, SilentReporter()
        return StageContext(case, *about, bitwise=True, **given)


@dataclass(frozen=True)
class Failure:
    """Why there is no result at a point, other than that the run became unstable."""

    point: ParameterPoint
    reason: str
    exit_code: int


Failures = tuple[Failure, ...]
Do = Callable[[Task], Failures]
"""Does a task, and returns its failures; a function of a module, which other processes load."""


def attempt(do: Do, task: Task) -> Failures:
    """Do a task, and return its failures, mistakes in the program included."""
    try:
        with _ONE_AT_A_TIME:
            return do(task)
    except SphromError as error:
        return _failures(task, str(error), error.exit_code)
    except MemoryError:
        return _failures(task, "out of memory", ResourceError.exit_code)
    except Exception as error:
        return _failures(task, f"{type(error).__name__}: {error}", SphromError.exit_code)


def _failures(task: Task, reason: str, exit_code: int) -> Failures:
    return tuple(Failure(point, reason, exit_code) for point in task.points)


def _lost(task: Task, times: int) -> Failures:
    reason = f"its process was lost {times} times, as when memory runs out"
    return _failures(task, reason, ResourceError.exit_code)


class Workers:
    """Does tasks in this process, in some processes of this machine, or on a Dask cluster."""

    def __init__(self, number: int, report: Reporter, client: Any = None) -> None:
        self._report, self._client = report, client
        self.number = number if client is None else max(1, len(client.nthreads()))
        """How many tasks run at once; workers that join a cluster later take tasks too."""

    def run(self, name: str, tasks: Sequence[Task], do: Do) -> list[Failure]:
        """Do all tasks, in any order, and return the runs that failed."""
        failed: list[Failure] = []
        n_runs = sum(len(task.points) for task in tasks)
        # Whatever happens here, processes end at once.
        with self._report.progress(name, n_runs) as advance, closing(self._done(tasks, do)) as done:
            for task, failures in done:
                failed += failures
                advance(len(task.points))
        return failed

    def _done(self, tasks: Sequence[Task], do: Do) -> Generator[tuple[Task, Failures], None, None]:
        """Yield tasks as they are done; begin those of lost processes again."""
        if self.number == 1 and self._client is None:
            yield from ((task, attempt(do, task)) for task in tasks)
            return
        left, begun = deque(tasks), Counter[Task]()
        while left:
            running: dict[Future[Failures], Task] = {}
            with suppress(BrokenExecutor), self._executor() as executor:
                while left or running:
                    again = any(begun[t] == MOST_ATTEMPTS for t in running.values()) or (
                        bool(left) and begun[left[0]] == MOST_ATTEMPTS - 1
                    )
                    most = 1 if again else self.number if self._client is None else len(tasks)
                    while left and len(running) < most:
                        running[executor.submit(_attempt_there, do, left[0])] = left[0]
                        begun[left.popleft()] += 1
                    for future in wait(running, return_when=FIRST_COMPLETED).done:
                        found = _result(future, running[future])
                        yield running.pop(future), found
            for future, task in reversed(running.items()):
                if future.exception() is None:
                    yield task, future.result()
                elif begun[task] < MOST_ATTEMPTS:
                    left.appendleft(task)
                else:
                    yield task, _lost(task, MOST_ATTEMPTS)

    @contextmanager
    def _executor(self) -> Iterator[Executor]:
        if self._client is not None:
            executor = self._client.get_executor(pure=False)
            try:
                yield executor
            finally:
                executor.shutdown(wait=False)
            return
        code_cache()  # warns where processes can't share compiled code
        # Afresh: a process with threads can't be forked.
        context = get_context("spawn")
        theirs, ours = context.Pipe(duplex=False)
        pool = ProcessPoolExecutor(self.number, context, _begin, (theirs,))
        try:
            yield pool
        except BaseException:
            ours.close()  # which ends the processes in the middle of their tasks
            raise
        finally:
            pool.shutdown(cancel_futures=True)
            ours.close()


def _result(future: Future[Failures], task: Task) -> Failures:
    """Return the failures of a task that has ended. Raises BrokenExecutor if its process died."""
    try:
        return future.result()
    except BrokenExecutor:
        raise
    except CancelledError:
        return _failures(task, "the scheduler was lost", ResourceError.exit_code)
    except Exception as error:
        if type(error).__name__ == "KilledWorker":  # of Dask, which has begun it again
            return _lost(task, error.allowed_failures + 1)  # type: ignore[attr-defined]
        return _failures(task, f"{type(error).__name__}: {error}", SphromError.exit_code)


def _begin(parent: Connection) -> None:
    """Set a new process up to end with its parent, or when that closes the connection."""
    # An interrupt from the keyboard ends the process that gives the tasks, and this one in turn.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for kind in (CodeCacheWarning, RuntimeWarning):  # that process shows it, or nobody
        warnings.simplefilter("ignore", kind)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()


def _end_with(parent: Connection) -> None:
    with suppress(EOFError, OSError):
        parent.recv()
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(CLEANING)
    os.kill(os.getpid(), signal.SIGKILL)


def _attempt_there(do: Do, task: Task) -> Failures:
    """Do a task in a process of its own, and end the process when it is terminated."""
    try:
        with one_blas_thread(), termination_interrupts(), interrupts_come_again():
            return attempt(do, task)
    except Terminated:
        os._exit(128 + signal.SIGTERM)


@contextmanager
def start_workers(number: int, scheduler: str | None, report: Reporter) -> Iterator[Workers]:
    """Have workers: those of a Dask cluster where the address of its scheduler is given.

    Raises CaseError when no scheduler answers at an address, such as tcp://node:8786, or the
    library is not installed.
    """
    if scheduler is None:
        yield Workers(number, report)
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise CaseError(f"--scheduler: needs the library distributed: {INSTALL}") from error
    try:
        client = Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, ImportError) as error:
        raise CaseError(
            f"--scheduler: no scheduler answers at {scheduler}; start one with `dask scheduler`, "
            f"and workers with `dask worker {scheduler} --nworkers auto --nthreads 1`"
        ) from error
    try:
        if not client.nthreads():
            report.warn(f"--scheduler: {scheduler} has no workers yet: runs wait for some")
        yield Workers(number, report, client)
    finally:
        client.close()


def check_options(number: int | None, scheduler: str | None) -> None:
    """Raise CaseError where options contradict one another."""
    if number is not None and scheduler is not None:
        raise CaseError("--workers: is not for --scheduler, which has workers of its own")
