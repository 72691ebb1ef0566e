"""A file is replaced as a whole, by one process, or left as it was."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from sphrom.artifacts import create_artifact
from sphrom.errors import ArtifactError
from sphrom.whole_files import locked, write_whole

WRITER = """
import sys
from sphrom.artifacts import Origin, create_artifact
with create_artifact(sys.argv[1], "sphrom/trajectory", stage="fom", origin=Origin("", "")):
    print("writing", flush=True)
    sys.stdin.readline()
"""


def test_existing_target_needs_force(write_trajectory, tmp_path: Path) -> None:
    before = write_trajectory().read_bytes()
    with pytest.raises(ArtifactError, match=r"fom\.h5 exists already; --force"):
        write_trajectory()
    assert (tmp_path / "fom.h5").read_bytes() == before
    write_trajectory(force=True)
    assert (tmp_path / "fom.h5").read_bytes() != before
    assert [path.name for path in tmp_path.iterdir()] == ["fom.h5"]


@pytest.mark.parametrize("failure", [RuntimeError, KeyboardInterrupt])
def test_failed_replacement_leaves_the_old_file(
    write_trajectory, arguments, tmp_path: Path, failure: type[BaseException]
) -> None:
    before = write_trajectory().read_bytes()

    def run() -> None:
        path = tmp_path / "fom.h5"
        with create_artifact(path, "sphrom/trajectory", force=True, **arguments) as artifact:
            artifact.stream("position", (5, 2), 3)
            raise failure

    with pytest.raises(failure):
        run()
    assert (tmp_path / "fom.h5").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["fom.h5"]


def test_folder_is_no_target(write_trajectory, tmp_path: Path) -> None:
    (tmp_path / "fom.h5").mkdir()
    with pytest.raises(ArtifactError, match="not a file"):
        write_trajectory(force=True)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
@pytest.mark.parametrize("successes", [0, 5])
def test_disk_that_fails_at_any_time(
    write_trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int, successes: int
) -> None:
    left = successes

    def write(descriptor: int, data: memoryview, write=os.write) -> int:
        nonlocal left
        left -= 1
        if left < 0:
            raise OSError(number, os.strerror(number))
        return write(descriptor, data)

    before = write_trajectory().read_bytes()
    monkeypatch.setattr("sphrom.whole_files.os.write", write)
    with pytest.raises(ArtifactError, match=rf"not written: {os.strerror(number)}"):
        write_trajectory(force=True)
    assert left < 0
    assert (tmp_path / "fom.h5").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["fom.h5"]


def test_interrupt_beneath_hdf5_is_an_interrupt(
    write_trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("sphrom.whole_files.os.write", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_trajectory()
    assert list(tmp_path.iterdir()) == []


def test_second_process_is_told_of_the_first(write_trajectory, tmp_path: Path) -> None:
    path = tmp_path / "fom.h5"
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"writing\n"
        with pytest.raises(ArtifactError, match="another process"):
            write_trajectory()
        write_trajectory(tmp_path / "other.h5")
        assert not path.exists()
        process.kill()
        process.wait(timeout=300)
        # What a killed process left neither blocks the next one nor stays.
        assert list(tmp_path.glob(".fom.h5.tmp"))
    write_trajectory()
    assert {entry.name for entry in tmp_path.iterdir()} == {"fom.h5", "other.h5"}


def test_file_system_without_locks_is_used(
    write_trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("sphrom.whole_files.fcntl.flock", refuse)
    assert write_trajectory().is_file()
    assert [path.name for path in tmp_path.iterdir()] == ["fom.h5"]


def test_later_of_two_writers_of_a_whole_file_waits_and_wins(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    later = threading.Thread(target=write_whole, args=(path, b"later"))
    with locked(path):
        later.start()
        later.join(0.2)
        assert later.is_alive()
        path.write_bytes(b"first")
    later.join(30)
    assert path.read_bytes() == b"later"
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_that_was_killed_leaves_nothing_in_the_end(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    (tmp_path / ".table.csv.tmp").write_text("{...")
    write_whole(path, b"1")
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == b"1"
