"""Workers that do the tasks of a sweep: this process, or some processes of this machine.

A worker has one task at a time, so that only that task is lost when it dies: an executor of the
standard library would lose all that are submitted. A worker that is terminated first removes the
file that it is writing, and a worker without its parent ends.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import warnings
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Protocol

from sphrom.kernels.code_cache import CodeCacheWarning
from sphrom.kernels.jit import code_cache
from sphrom.machine import one_blas_thread
from sphrom.signals import Terminated, interrupts_come_again, termination_interrupts
from sphrom.sweep.tasks import Attempt, Done, Failure, SweepTask, lost

MOST_ATTEMPTS = 3
"""Times that a task is begun, if its processes die."""
PATIENCE = 10.0
"""Seconds that a process is given to clean up before it is killed."""


class Workers(Protocol):
    """Does tasks, each by a function."""

    @property
    def number(self) -> int:
        """How many tasks are done at once."""

    def run(self, tasks: Sequence[SweepTask], attempt: Attempt, done: Done) -> None:
        """Do all tasks, in any order."""


class ThisProcess:
    """Does one task after the other."""

    number = 1

    def run(self, tasks: Sequence[SweepTask], attempt: Attempt, done: Done) -> None:
        """Do all tasks."""
        for task in tasks:
            done(task, attempt(task))


@dataclass
class _Worker:
    """A process that does a task at a time."""

    process: BaseProcess
    connection: Connection
    task: SweepTask | None = None

    @classmethod
    def start(cls, attempt: Attempt) -> _Worker:
        """Start a process, afresh: a process with threads can't be forked."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, attempt), daemon=True)
        process.start()
        theirs.close()
        return cls(process, ours)

    def begin(self, task: SweepTask) -> None:
        """Begin a task; `result` tells whether the process has died."""
        self.task = task
        with contextlib.suppress(OSError):
            self.connection.send(task)

    def result(self) -> tuple[Failure, ...] | None:
        """Return the failures of the task, None where the process died."""
        try:
            found: tuple[Failure, ...] = self.connection.recv()
        except (EOFError, OSError):
            return None
        return found

    def stop(self) -> None:
        """End the process, which cleans up if it can."""
        self.connection.close()
        if self.process.is_alive():
            self.process.terminate()
        self.process.join(PATIENCE)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


class Processes:
    """Does tasks in some processes; one that dies is replaced, and its task begun again."""

    def __init__(self, number: int) -> None:
        self.number = number

    def run(self, tasks: Sequence[SweepTask], attempt: Attempt, done: Done) -> None:
        """Do all tasks."""
        code_cache()  # warns where processes can't share compiled code
        left, attempts = deque(tasks), Counter[SweepTask]()
        workers: list[_Worker] = []
        try:
            for _ in range(min(self.number, len(left))):
                workers.append(_Worker.start(attempt))
            while left or any(worker.task for worker in workers):
                for worker in workers:
                    if left and worker.task is None:
                        attempts[left[0]] += 1
                        worker.begin(left.popleft())
                for worker, task in self._ready(workers):
                    found = worker.result()
                    if found is not None:
                        worker.task = None
                        done(task, found)
                        continue
                    worker.stop()
                    workers[workers.index(worker)] = _Worker.start(attempt)
                    if attempts[task] < MOST_ATTEMPTS:
                        left.appendleft(task)
                    else:
                        done(task, lost(task, MOST_ATTEMPTS))
        finally:
            for worker in workers:
                worker.stop()

    def _ready(self, workers: Sequence[_Worker]) -> list[tuple[_Worker, SweepTask]]:
        """Wait until some processes have a result, or died."""
        busy = {id(w.connection): (w, w.task) for w in workers if w.task is not None}
        ready = wait([worker.connection for worker, _ in busy.values()])
        return [busy[id(found)] for found in ready]


def _serve(connection: Connection, attempt: Attempt) -> None:
    """Do tasks until the process that gives them closes the connection, or is gone."""
    # An interrupt from the keyboard ends the process that gives the tasks, and this one in turn.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for kind in (CodeCacheWarning, RuntimeWarning):  # that process shows it, or nobody
        warnings.simplefilter("ignore", kind)
    threading.Thread(target=_leave_with_parent, daemon=True).start()
    try:
        with one_blas_thread(), termination_interrupts(), interrupts_come_again():
            while True:
                connection.send(attempt(connection.recv()))
    except (EOFError, OSError):
        return
    except Terminated:
        raise SystemExit(128 + signal.SIGTERM) from None


def _leave_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)
