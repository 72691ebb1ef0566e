"""Read files as a whole, and replace them atomically, by one process at a time.

A new file is written beside its target under a temporary name. Once it is complete and on disk, it
is renamed to the target. The writer holds a lock on it, which keeps other writers away. If the
process is killed, the system releases its lock, and the next writer empties the temporary file.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import gc
import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from sphrom.errors import ArtifactError
from sphrom.machine import available_ram
from sphrom.text import data_size

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer

TIMES_SIZE = 8
"""Memory to read a file, relative to its size; it is large because words and numbers become
objects."""


class Unreadable(ValueError):
    """The reason why a file is not read, as a phrase that continues `FILE ...`."""


def read_whole(path: Path, most: int) -> bytes:
    """Return the content of a file of at most `most` bytes.

    Raises Unreadable when it is no file or too large, OSError when it can't be read.
    """
    require_size(path, most)
    return path.read_bytes()


def require_size(path: Path, most: int) -> None:
    """Raise Unreadable unless the path is a file of at most `most` bytes that fits into memory."""
    size = path.stat().st_size
    available = available_ram()
    if not path.is_file():  # reading a pipe would wait for its writer
        raise Unreadable("is not a file")
    most = most if available is None else min(most, available // TIMES_SIZE)
    if size > most:
        raise Unreadable(f"is larger than the limit of {data_size(most)}: it has {data_size(size)}")


def open_to_write(path: Path, mode: str) -> io.TextIOWrapper:
    """Open a text file for writing; a pipe must have a reader already.

    Raises OSError when it can't be written to.
    """

    def opened(name: str, flags: int) -> int:
        descriptor = os.open(name, flags | os.O_NONBLOCK, 0o666)
        os.set_blocking(descriptor, True)
        return descriptor

    return io.TextIOWrapper(io.FileIO(path, mode, opener=opened), encoding="utf-8")


class TemporaryFile(io.FileIO):
    """An incomplete file that HDF5 may write to.

    On a full disk HDF5 can't close a file: it tries to write again, and crashes. Therefore this
    class keeps the first failure and drops later writes, so HDF5 can close; `check` raises it.
    """

    def __init__(self, path: Path) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW
        super().__init__(path, "r+", opener=lambda name, _: os.open(name, flags, 0o666))
        self.path = path
        self._failure: BaseException | None = None

    def check(self) -> None:
        """Raise the first failure of a write, an interrupt included."""
        if self._failure is not None:
            raise self._failure

    def discard(self) -> None:
        """Drop all further writes, because the file will not be kept."""
        self._failure = self._failure or OSError(errno.ECANCELED, "discarded")

    @property
    def is_named(self) -> bool:
        """Whether the file still has its temporary name."""
        try:
            return os.path.samestat(self.path.lstat(), os.fstat(self.fileno()))
        except FileNotFoundError:
            return False

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the position; HDF5 also does so after the file is closed, if it was interrupted."""
        return offset if self.closed else super().seek(offset, whence)

    def readinto(self, buffer: WriteableBuffer) -> int:
        """Read at the position; beyond the end of the file, read zeros."""
        view = memoryview(buffer).cast("B")
        count = super().readinto(view) or 0
        view[count:] = bytes(len(view) - count)
        return len(view)

    def write(self, data: ReadableBuffer) -> int:
        """Write all data at the position, or drop them after an earlier failure."""
        view = memoryview(data).cast("B")
        if self._failure is None and not self.closed:
            try:
                done = 0
                while done < len(view):
                    done += os.write(self.fileno(), view[done:])
            except BaseException as error:
                self._failure = error
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the file's length."""
        if self._failure is None and not self.closed:
            try:
                return super().truncate(size)
            except BaseException as error:
                self._failure = error
        return size or 0

    def flush(self) -> None:
        """Do nothing: the file has no buffer, and HDF5 also flushes closed files."""


class GarbageCollectionPaused:
    """Pauses Python's garbage collection while HDF5 writes to a `TemporaryFile`.

    HDF5 calls the file's methods, and Python may collect garbage in any of them. If the garbage
    includes HDF5's own objects, such as datasets of another artifact, HDF5 is entered a second time
    and writes a damaged file. It is a class, because an interrupt could leave a generator half
    done.
    """

    _collects = False

    def __enter__(self) -> None:
        self._collects = gc.isenabled()
        gc.disable()

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if self._collects:
            gc.enable()


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that a reader finds the old content or the new one, never a part.

    Of two simultaneous writers the later one wins. Raises ArtifactError when the file can't be
    written, or is not a regular file: replacing a device would take it from all programs.
    """
    _require_file(path)
    with locked(path, wait=True) as file:
        file.write(content)
        _publish(file, path)


def require_writable(path: Path) -> None:
    """Raise ArtifactError unless `write_whole` can write to a path; call it before long work."""
    _require_file(path)
    with locked(path):  # this makes a file in the same folder
        pass


@contextlib.contextmanager
def replacement(path: Path, *, force: bool) -> Iterator[TemporaryFile]:
    """Open a temporary file that becomes `path` when the block ends without an exception.

    Raises ArtifactError when `path` exists and `force` is not set, when it is a link or no file,
    when another process writes it, and when permission or disk space is missing.
    """
    with explained(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path) as file:
        _require_free(path, force)
        yield file
        _require_free(path, force)
        _publish(file, path)


def _require_free(path: Path, force: bool) -> None:
    if path.is_symlink():
        raise ArtifactError(f"{path} is a symbolic link, which is never written through; remove it")
    _require_file(path)
    if path.exists() and not force:
        raise ArtifactError(f"{path} exists already; --force replaces it")


def _require_file(path: Path) -> None:
    if path.exists() and not path.is_file():
        raise ArtifactError(f"{path} is not a file, so it can't be replaced; choose another name")


def _publish(file: TemporaryFile, path: Path) -> None:
    """Flush a file to disk, then give it its final name."""
    with explained(path):
        file.check()
        os.fsync(file.fileno())
        os.replace(file.path, path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


@contextlib.contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn an error of the operating system while writing `path` into an ArtifactError."""
    try:
        yield
    except OSError as error:
        raise ArtifactError(
            f"{path} was not written: {error.strerror or error}; --out writes to another folder, "
            "such as one with free space and permission"
        ) from error


@contextlib.contextmanager
def locked(path: Path, *, wait: bool = False) -> Iterator[TemporaryFile]:
    """Open and lock the temporary file of `path`; remove it at the end unless it was renamed.

    If another process holds the lock, `wait` for it, or raise ArtifactError.
    """
    with explained(path):
        file = _acquire(path, wait)
        file.truncate(0)  # a killed process may have left data
    try:
        yield file
    finally:
        with contextlib.suppress(OSError):
            if file.is_named:
                file.path.unlink()
        file.close()


def _acquire(path: Path, wait: bool) -> TemporaryFile:
    """Open the temporary file of `path`, and lock it where the file system has locks."""
    while True:
        file = TemporaryFile(path.with_name(f".{path.name}.tmp"))
        try:
            fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            file.close()
            raise ArtifactError(
                f"{path} is being written by another process; wait for it, or write to another "
                "folder with --out"
            ) from None
        except OSError:
            # Without locks, a temporary name of its own still keeps the file whole.
            file.path.unlink(missing_ok=True)
            file.close()
            return TemporaryFile(path.with_name(f".{path.name}.{os.getpid()}.tmp"))
        # The previous holder of the lock may have renamed or removed the file.
        if file.is_named:
            return file
        file.close()
