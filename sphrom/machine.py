"""What this process can have of the machine: memory, and threads of linear algebra.

Its memory is the machine's, or less where a control group limits it. A container, a batch system or
a service manager sets such limits; beyond them the process is killed, whatever the machine still
has.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

_ROOT = Path("/")


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Within the block, libraries of linear algebra compute on one thread, as the commands do.

    With more of them the last bits of results differ.
    """
    import scipy.linalg  # noqa: F401 - it brings a library of its own, and loads it late
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield


@dataclass(frozen=True)
class _ControlGroup:
    """One folder of limits, and what its files are called in its version of control groups."""

    folder: Path
    limit_file: str
    usage_file: str
    cache_prefix: str

    def limit(self) -> int | None:
        """Return the limit [bytes], None where there is none."""
        return _number(self.folder / self.limit_file)

    def used(self) -> int:
        """Return the memory in use [bytes], without the file cache, which gives way."""
        used = _number(self.folder / self.usage_file) or 0
        keys = {f"{self.cache_prefix}{kind}_file" for kind in ("active", "inactive")}
        pairs = (line.split() for line in _lines(self.folder / "memory.stat"))
        return max(0, used - sum(int(pair[1]) for pair in pairs if pair[0] in keys))


def physical_ram(root: Path = _ROOT) -> int:
    """Return the most memory that this process may ever have [bytes]."""
    machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    limits = (group.limit() for group in _control_groups(root))
    return min([machine, *(limit for limit in limits if limit is not None)])


def available_ram(root: Path = _ROOT) -> int | None:
    """Return the memory that can be had now without swapping [bytes], None where unknown."""
    lines = (line.split() for line in _lines(root / "proc/meminfo"))
    free = [int(line[1]) * 1024 for line in lines if line[:1] == ["MemAvailable:"]]
    for group in _control_groups(root):
        limit = group.limit()
        if limit is not None:
            free.append(max(0, limit - group.used()))
    return min(free, default=None)


def _control_groups(root: Path) -> Iterator[_ControlGroup]:
    """Yield the control groups that this process is in: each is within the limits of the next."""
    mount = root / "sys/fs/cgroup"
    for line in _lines(root / "proc/self/cgroup"):
        controllers, path = line.split(":", 2)[1:]
        if controllers == "":  # version 2: one hierarchy for everything
            version = mount, "memory.max", "memory.current", ""
        elif "memory" in controllers.split(","):
            version = mount / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_"
        else:
            continue
        base, *names = version
        inner = base / path.lstrip("/")
        # Within a container the path may be the host's, and only the mount itself be there.
        for folder in (inner, *inner.parents):
            if folder.is_relative_to(base):
                yield _ControlGroup(folder, *names)


def _number(path: Path) -> int | None:
    lines = _lines(path)
    return int(lines[0]) if lines and lines[0].isdigit() else None


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8").splitlines()
    except OSError:
        return []
