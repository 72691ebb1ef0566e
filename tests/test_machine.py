"""Memory is the machine's, or less within a control group of either version."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from sphrom.machine import available_ram, physical_ram

MEGABYTE = 2**20
MACHINE = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


@pytest.fixture
def machine(tmp_path: Path):
    """Write the files of a machine that has 100 MiB left."""

    def write(groups: str = "", **files: str) -> Path:
        files = {"proc/meminfo": "MemTotal: 999999 kB\nMemAvailable: 102400 kB\n"} | files
        for name, text in {"proc/self/cgroup": groups, **files}.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
        return tmp_path

    return write


def version_2(folder: str, limit: str, used: int = 0, cache: int = 0) -> dict[str, str]:
    place = f"sys/fs/cgroup/{folder}".rstrip("/")
    return {
        f"{place}/memory.max": f"{limit}\n",
        f"{place}/memory.current": f"{used}\n",
        f"{place}/memory.stat": f"anon 7\ninactive_file {cache}\nactive_file 0\n",
    }


def test_without_a_limit_it_is_the_machine_s(machine, tmp_path: Path) -> None:
    assert available_ram(tmp_path) is None  # nothing is known
    for root in (machine(), machine("0::/a\n", **version_2("a", "max"))):
        assert available_ram(root) == 100 * MEGABYTE
        assert physical_ram(root) == MACHINE


@pytest.mark.parametrize("limited", ["a/b", "a", ""])
def test_the_tightest_of_the_groups_around_counts(machine, limited: str) -> None:
    files = version_2("a/b", "max") | version_2("a", str(70 * MEGABYTE))
    files |= version_2(limited, str(50 * MEGABYTE), 30 * MEGABYTE, 10 * MEGABYTE)
    root = machine("0::/a/b\n", **files)
    assert available_ram(root) == 30 * MEGABYTE
    assert physical_ram(root) == 50 * MEGABYTE


def test_a_path_that_is_the_hosts_and_more_in_use_than_allowed(machine) -> None:
    root = machine("0::/kubepods/pod7\n", **version_2("", str(MEGABYTE), 2 * MEGABYTE))
    assert physical_ram(root) == MEGABYTE
    assert available_ram(root) == 0


@pytest.mark.parametrize("limit", [40 * MEGABYTE, 9223372036854771712])
def test_version_1(machine, limit: int) -> None:
    place = "sys/fs/cgroup/memory/job"
    root = machine(
        "5:cpu,cpuacct:/job\n4:memory:/job\n1:name=systemd:/x\n",
        **{
            f"{place}/memory.limit_in_bytes": f"{limit}\n",
            f"{place}/memory.usage_in_bytes": f"{30 * MEGABYTE}\n",
            f"{place}/memory.stat": f"total_inactive_file {MEGABYTE}\ntotal_active_file 0\n",
        },
    )
    limited = limit < MACHINE
    assert available_ram(root) == (11 if limited else 100) * MEGABYTE
    assert physical_ram(root) == (limit if limited else MACHINE)
