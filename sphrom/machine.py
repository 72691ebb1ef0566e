"""What this process has of the machine: memory, threads of linear algebra, processor time.

Its memory is the machine's, or less where a control group limits it. A container, a batch system or
a service manager sets such limits; beyond them the process is killed, whatever the machine still
has.
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
"""Least processor time [s] of a measurement: the clock is too coarse for less."""
compiling = [0.0]
"""Processor time that this process has spent on compiling [s]."""


def computing_seconds() -> float:
    """Return the processor time of this process [s], that of compiling kernels left out."""
    return time.process_time() - compiling[0]


def seconds_of(run: Callable[[], object]) -> float:
    """Return the processor time of a call [s], the mean over as many as can be timed."""
    count, taken = 0, 0.0
    while taken < LEAST_TIMED:
        count, started = max(1, 4 * count), time.process_time()
        for _ in range(count):
            run()
        taken = time.process_time() - started
    return taken / count


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Within the block, libraries of linear algebra compute on one thread, as the commands do.

    With more of them the last bits of results differ.
    """
    import scipy.linalg  # noqa: F401 - it brings a library of its own, and loads it late

    with _thread_pools(len(sys.modules)).limit(limits=1, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _thread_pools(n_modules: int) -> Any:
    """Find libraries with threads, again once there are more modules: that takes milliseconds."""
    return import_module("threadpoolctl").ThreadpoolController()


def physical_ram(root: Path = _ROOT) -> int:
    """Return the most memory that this process may ever have [bytes]."""
    machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min((machine, *(limit for limit, _ in _group_limits(root))))


def available_ram(root: Path = _ROOT) -> int | None:
    """Return the memory available now without swapping [bytes], None where unknown."""
    lines = (line.split() for line in _lines(root / "proc/meminfo"))
    free = [int(line[1]) * 1024 for line in lines if line[:1] == ["MemAvailable:"]]
    free += [max(0, limit - used) for limit, used in _group_limits(root)]
    return min(free, default=None)


def _group_limits(root: Path) -> Iterator[tuple[int, int]]:
    """Yield the limits of the control groups that this process is in, and the use of each [bytes].

    The file cache isn't counted as used: it gives way.
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
        # Within a container the path may be the host's, and only the mount itself be there.
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
