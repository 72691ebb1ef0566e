"""One task of a sweep: some of its runs, and the runs that failed.

A task holds all that a process elsewhere needs: the case as text, the folder, and the points.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass

from sphrom.case.points import ParameterPoint
from sphrom.errors import ResourceError, SphromError

_ONE_AT_A_TIME = threading.Lock()
"""Compiled loops must not run in two threads at once, as the tasks of some workers would."""


@dataclass(frozen=True)
class SweepTask:
    """Some runs of a sweep."""

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


@dataclass(frozen=True)
class Failure:
    """Why there is no result at a point, other than that the run became unstable."""

    point: ParameterPoint
    reason: str
    exit_code: int


Attempt = Callable[[SweepTask], tuple[Failure, ...]]
"""Does a task, and returns its failures."""
Done = Callable[[SweepTask, tuple[Failure, ...]], None]
"""Is called after every task, with its failures."""


def failures(task: SweepTask, reason: str, exit_code: int) -> tuple[Failure, ...]:
    """Return that all runs of a task failed."""
    return tuple(Failure(point, reason, exit_code) for point in task.points)


def attempted(task: SweepTask, do: Attempt) -> tuple[Failure, ...]:
    """Do a task, and return its failures, mistakes in the program included."""
    try:
        with _ONE_AT_A_TIME:
            return do(task)
    except SphromError as error:
        return failures(task, str(error), error.exit_code)
    except MemoryError:
        return failures(task, "out of memory", ResourceError.exit_code)
    except Exception as error:
        return failures(task, f"{type(error).__name__}: {error}", SphromError.exit_code)


def lost(task: SweepTask, times: int) -> tuple[Failure, ...]:
    """Return that the processes that began a task died."""
    reason = f"its process was lost {times} times, as when memory runs out"
    return failures(task, reason, ResourceError.exit_code)
