"""Where artifacts are kept: disks that fill up or may not be written, links, and two at once."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

LONG = ("--set", "time.final_time=40", "--threads", "1", "--only", "reynolds=100")
FULL = "fom-reynolds100.h5"


@pytest.fixture
def room(monkeypatch):
    """Say that there is room, as there is until another process takes it."""
    usage = shutil._ntuple_diskusage(10**12, 0, 10**12)
    monkeypatch.setattr("sphrom.setup.cost.shutil.disk_usage", lambda folder: usage)


def test_a_run_goes_on_after_its_disk_was_full(empty, small_disk, sphrom, digests, room):
    run = ("fom", "tiny.yaml", "--threads", 1, "--only", "reynolds=100",
           "--set", "discretization.initial_particles=lattice")  # fmt: skip
    sphrom(*run, "--out", "whole", code=0)
    out = small_disk / "runs"
    out.mkdir()
    hog = small_disk / "hog"
    hog.write_bytes(bytes(10**6 - 150_000))
    stopped = sphrom(*run, "--out", out, "--checkpoint-every", 0)
    if stopped.exit_code == 0:
        pytest.skip("the disk was large enough")
    assert (stopped.exit_code, "No space" in stopped.stderr) == (3, True)
    assert not [*out.glob("*.h5"), *out.glob(".*.tmp")]
    hog.unlink()
    sphrom(*run, "--out", out, "--resume", code=0)
    assert digests(out)[FULL] == digests(Path("whole"))[FULL]


@pytest.mark.slow
def test_two_processes_on_one_folder(empty, refused, wait_for):
    command = [sys.executable, "-m", "sphrom", "fom", "tiny.yaml", *LONG]
    first = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        wait_for(first, lambda: list(empty.glob(f".{FULL}.tmp")))
        for options in ((), ("--force",), ("--resume",)):
            line = refused("fom", "tiny.yaml", *LONG, *options)
            assert f"{FULL} is being written by another process" in line
        first.send_signal(signal.SIGINT)
        assert first.wait(timeout=300) == 130
    finally:
        first.kill()
    assert not (empty / FULL).exists()


def test_a_link_is_followed_by_readers_and_never_written_through(place, sphrom, refused, tmp_path):
    precious = tmp_path / "elsewhere.h5"
    shutil.move(place / FULL, precious)
    (place / FULL).symlink_to(precious)
    (place / "map-reynolds100.h5").unlink()
    before = precious.read_bytes()
    sphrom("map", "tiny.yaml", "--threads", 1, code=0)
    line = refused("fom", "tiny.yaml", "--only", "reynolds=100", "--force")
    assert "is a symbolic link, which is never written through; remove it" in line
    assert precious.read_bytes() == before
    precious.unlink()  # a link to nothing
    assert "symbolic link" in refused("fom", "tiny.yaml", "--only", "reynolds=100")
    assert not precious.exists()


def test_another_schema_version_is_refused(place, refused):
    with h5py.File(place / FULL, "r+") as file:
        file.attrs["schema_version"] = np.bytes_("9.0")
    (place / "map-reynolds100.h5").unlink()
    assert "version '9.0'" in refused("map", "tiny.yaml")
