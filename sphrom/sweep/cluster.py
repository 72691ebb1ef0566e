"""The tasks of a sweep on a Dask cluster, of which every worker sees the same folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

from sphrom.console import Reporter
from sphrom.errors import CaseError, ResourceError
from sphrom.sweep.tasks import Attempt, Done, SweepTask, failures, lost
from sphrom.sweep.workers import Processes, ThisProcess, Workers

PATIENCE = 15.0
"""Seconds that a scheduler is given to answer."""
INSTALL = "pip install 'sphrom[cluster]'"


class Cluster:
    """Runs tasks on a cluster, which repeats those of lost workers elsewhere."""

    def __init__(self, client: Any) -> None:
        self._client = client

    @property
    def number(self) -> int:
        """How many tasks run at once; workers that join later take tasks too."""
        return max(1, len(self._client.nthreads()))

    def run(self, tasks: Sequence[SweepTask], attempt: Attempt, done: Done) -> None:
        """Do all tasks."""
        from distributed import KilledWorker, as_completed

        futures = {self._client.submit(attempt, task, pure=False): task for task in tasks}
        try:
            for future in as_completed(futures, loop=self._client.loop):
                task = futures[future]
                if future.status == "finished":
                    done(task, future.result())
                    continue
                error = None if future.cancelled() else future.exception()
                if isinstance(error, KilledWorker):
                    done(task, lost(task, error.allowed_failures + 1))
                elif future.status == "error":
                    done(task, failures(task, f"{type(error).__name__}: {error}", 1))
                else:
                    reason = "the scheduler was lost"
                    done(task, failures(task, reason, ResourceError.exit_code))
        finally:
            self._client.cancel(list(futures))


@contextmanager
def connect(address: str, report: Reporter) -> Iterator[Cluster]:
    """Connect to the scheduler at an address, such as tcp://node:8786.

    Raises CaseError when no scheduler answers, or the library is not installed.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise CaseError(f"--scheduler: needs the library distributed: {INSTALL}") from error
    try:
        client = Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError, ImportError) as error:
        raise CaseError(
            f"--scheduler: no scheduler answers at {address}; start one with `dask scheduler`, "
            f"and workers with `dask worker {address} --nworkers auto --nthreads 1`"
        ) from error
    try:
        if not client.nthreads():
            report.warn(f"--scheduler: {address} has no workers yet: runs wait for some")
        yield Cluster(client)
    finally:
        client.close()


def workers_of(
    number: int, scheduler: str | None, report: Reporter
) -> AbstractContextManager[Workers]:
    """Return workers: of a cluster where a scheduler is given, else processes, or this one.

    Raises CaseError when no scheduler answers.
    """
    if scheduler is not None:
        return connect(scheduler, report)
    return nullcontext(Processes(number) if number > 1 else ThisProcess())
