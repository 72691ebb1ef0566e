"""The resources of this process: memory, threads of linear algebra, processor time.

A container, a batch system or a service manager may limit the memory of a process by a control
group, and kills a process that exceeds the limit even if the machine has free memory.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

_ROOT = Path("/")
LEAST_TIMED = 5e-4
"""Least processor time of a measurement [s], because the clock is coarse."""
compiling = [0.0]
"""Processor time that this process has spent on compiling [s]."""


def computing_seconds() -> float:
    """Return the processor time of this process [s], without the time to compile kernels."""
    return time.process_time() - compiling[0]


def seconds_of(run: Callable[[], object]) -> float:
    """Return the processor time of a call [s], the mean over enough calls to be measurable."""
    count, taken = 0, 0.0
    while taken < LEAST_TIMED:
        count = max(1, 4 * count)
        started = time.process_time()
        for _ in range(count):
            run()
        taken = time.process_time() - started
    return taken / count


@contextmanager
def one_blas_thread(*, solves: bool = True) -> Iterator[None]:
    """Limit libraries of linear algebra to one thread within the block, as in all commands.

    With more threads the last bits of results differ. A block that `solves` may load scipy, which
    brings a library of its own; it is loaded first, so that it is limited too.
    """
    if solves:
        import scipy.linalg  # noqa: F401

    with _thread_pools(len(sys.modules)).limit(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _thread_pools(n_modules: int) -> Any:
    """Find the libraries with threads; the search takes milliseconds, so its result is cached."""
    return import_module("threadpoolctl").ThreadpoolController()


def physical_ram(root: Path = _ROOT) -> int:
    """Return the largest memory that this process may use [bytes]."""
    machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min((machine, *(limit for limit, _ in _group_limits(root))))


def available_ram(root: Path = _ROOT) -> int | None:
    """Return the memory that is free now, without swapping [bytes]; None if unknown."""
    lines = (line.split() for line in _lines(root / "proc/meminfo"))
    free = [int(line[1]) * 1024 for line in lines if line[:1] == ["MemAvailable:"]]
    free += [max(0, limit - used) for limit, used in _group_limits(root)]
    return min(free, default=None)


def _group_limits(root: Path) -> Iterator[tuple[int, int]]:
    """Yield the memory limit and the used memory of each control group of this process [bytes].

    The file cache doesn't count as used, because the system frees it on demand.
    """
    for line in _lines(root / "proc/self/cgroup"):
        controllers, path = line.split(":", 2)[1:]
        base, names, cache = root / "sys/fs/cgroup", ("memory.max", "memory.current"), ""
        if "memory" in controllers.split(","):  # version 1
            base, cache = base / "memory", "total_"
            names = "memory.limit_in_bytes", "memory.usage_in_bytes"
        elif controllers:
            continue
        inner = base / path.lstrip("/")
        # Within a container the path may be that of the host, where only the mount point exists.
        for folder in (inner, *inner.parents):
            limit, used = (_lines(folder / name) for name in names)
            if folder.is_relative_to(base) and limit and limit[0].isdigit():
                pairs = dict(line.split() for line in _lines(folder / "memory.stat"))
                files = sum(int(pairs.get(f"{cache}{k}active_file", 0)) for k in ("", "in"))
                yield int(limit[0]), max(0, int(used[0]) - files) if used else 0


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except OSError:
        return []
