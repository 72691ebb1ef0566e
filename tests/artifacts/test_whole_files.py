"""A file is replaced as a whole, by one process, or left as it was."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from sphrom.artifacts import create_artifact
from sphrom.errors import ArtifactError
from sphrom.whole_files import locked, write_whole

# A writer of its own: told where to write and, as an option, how large a file may become.
WRITER = """
import resource, sys
import numpy as np
from sphrom.artifacts import Origin, create_artifact
from sphrom.errors import ArtifactError
if len(sys.argv) > 2:
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
try:
    with create_artifact(sys.argv[1], "sphrom/trajectory", stage="fom", origin=Origin("", "")
                         ) as artifact:
        stream = artifact.stream("position", (10_000, 2), 100)
        stream.append(np.zeros((10_000, 2)))
        print("writing", flush=True)
        if len(sys.argv) == 2:
            sys.stdin.readline()
        for _ in range(99):
            stream.append(np.ones((10_000, 2)))
except ArtifactError as error:
    print(error)
    sys.exit(error.exit_code)
"""


@contextlib.contextmanager
def other_writer(path: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that has begun to write `path`."""
    command = [sys.executable, "-c", WRITER, str(path)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "writing\n"
        try:
            yield process
        finally:
            process.kill()


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


@pytest.mark.parametrize("pointee", ["real.h5", "nothing.h5"])
def test_symbolic_link_is_never_written_through(
    write_trajectory, tmp_path: Path, pointee: str
) -> None:
    (tmp_path / "real.h5").write_text("precious")
    (tmp_path / "fom.h5").symlink_to(tmp_path / pointee)
    with pytest.raises(ArtifactError, match="symbolic link"):
        write_trajectory(force=True)
    assert (tmp_path / "real.h5").read_text() == "precious"
    assert not (tmp_path / "nothing.h5").exists()


def test_folder_is_no_target_and_a_file_no_folder(write_trajectory, tmp_path: Path) -> None:
    (tmp_path / "fom.h5").mkdir()
    with pytest.raises(ArtifactError, match="not a file"):
        write_trajectory(force=True)
    (tmp_path / "runs").write_text("")
    with pytest.raises(ArtifactError, match="was not written"):
        write_trajectory(tmp_path / "runs" / "fom.h5")


@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS, errno.ENOSPC])
def test_folder_that_refuses_files(
    write_trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    def refuse(*_: object) -> int:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr("sphrom.whole_files.os.open", refuse)
    with pytest.raises(ArtifactError, match=f"{os.strerror(number)}.*--out"):
        write_trajectory()
    assert list(tmp_path.iterdir()) == []


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


@pytest.mark.parametrize(
    ("folder", "limit"), [("small_disk", 100_000_000), ("tmp_path", 1_000_000)]
)
def test_full_disk_or_limit_on_file_size_ends_the_process_in_order(
    request: pytest.FixtureRequest, folder: str, limit: int
) -> None:
    place = request.getfixturevalue(folder)
    command = [sys.executable, "-c", WRITER, str(place / "fom.h5"), str(limit)]
    process = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert "was not written" in process.stdout
    assert (process.returncode, process.stderr) == (3, "")
    assert list(place.iterdir()) == []


def test_second_process_is_told_of_the_first(write_trajectory, tmp_path: Path) -> None:
    path = tmp_path / "fom.h5"
    with other_writer(path) as process:
        with pytest.raises(ArtifactError, match="another process"):
            write_trajectory()
        write_trajectory(tmp_path / "other.h5")
        assert not path.exists()
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=30)
        # What a killed process left neither blocks the next one nor stays.
        assert list(tmp_path.glob(".fom.h5.tmp"))
    write_trajectory()
    assert {entry.name for entry in tmp_path.iterdir()} == {"fom.h5", "other.h5"}


def test_interrupted_process_leaves_nothing(tmp_path: Path) -> None:
    with other_writer(tmp_path / "fom.h5") as process:
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=30) != 0
    assert list(tmp_path.iterdir()) == []


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
