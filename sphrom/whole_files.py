"""Read a file whole; replace it whole, by one process at a time, or leave everything as it was.

A new file grows beside its target under a temporary name and takes the target's name once it is
complete and on disk. A lock beside the target keeps other processes away; it belongs to an open
file, so that the lock of a killed process is gone with it. Its next writer removes what a killed
process left.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import gc
import io
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from sphrom.errors import ArtifactError
from sphrom.machine import available_ram
from sphrom.text import data_size

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer

TIMES_SIZE = 8
"""Memory that a file may need while it is read, over its size: words and numbers are objects."""
_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_NO_PERMISSION = {errno.EACCES, errno.EPERM}
_NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP}


class Unreadable(ValueError):
    """Why a file is not read, in words that continue `FILE ...`."""


def read_whole(path: Path, most: int) -> bytes:
    """Return what a file of at most so many bytes holds.

    Raises Unreadable when it is no file or too large, OSError when it can't be read.
    """
    require_size(path, most)
    return path.read_bytes()


def require_size(path: Path, most: int) -> None:
    """Raise Unreadable unless the path is a file of at most `most` bytes that fits into memory."""
    size = path.stat().st_size
    if not path.is_file():  # a pipe would be waited for
        raise Unreadable("is not a file")
    if size > most:
        raise Unreadable(
            f"is larger than the {data_size(most)} that are read: it has {data_size(size)}"
        )
    available = available_ram()
    if available is not None and TIMES_SIZE * size > available:
        raise Unreadable(
            f"has {data_size(size)}, and {data_size(available)} of memory are available"
        )


def open_to_write(path: Path, mode: str) -> io.TextIOWrapper:
    """Open a file to write text to; a pipe has to have a reader already.

    Raises OSError when it can't be written to.
    """

    def opened(name: str, flags: int) -> int:
        descriptor = os.open(name, flags | os.O_NONBLOCK, 0o666)
        os.set_blocking(descriptor, True)
        return descriptor

    return io.TextIOWrapper(io.FileIO(path, mode, opener=opened), encoding="utf-8")


class TemporaryFile(io.FileIO):
    """A file in the making, which HDF5 may write to.

    HDF5 can't close a file whose disk is full: it tries to write again, and crashes. So the first
    failure is kept, later writes are dropped, HDF5 closes in peace, and `check` raises the failure.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path, "x+")
        self._failure: BaseException | None = None

    def check(self) -> None:
        """Raise the first failure of a write, an interrupt included."""
        if self._failure is not None:
            raise self._failure

    def discard(self) -> None:
        """Drop every write from here on: the file will not be kept."""
        self._failure = self._failure or OSError(errno.ECANCELED, "discarded")

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move the position. HDF5 moves it in a closed file too, which an interrupt left open."""
        return offset if self.closed else super().seek(offset, whence)

    def readinto(self, buffer: WriteableBuffer) -> int:
        """Read at the position; beyond the file's end there are zeros."""
        view = memoryview(buffer).cast("B")
        count = super().readinto(view) or 0
        view[count:] = bytes(len(view) - count)
        return len(view)

    def write(self, data: ReadableBuffer) -> int:
        """Write all data at the position, or drop them when a write has failed before."""
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
        """Do nothing: nothing is buffered, and HDF5 flushes a file that an interrupt left open."""


class Uncollected:
    """Keeps Python from collecting garbage while HDF5 writes to a `TemporaryFile`.

    HDF5 calls the file's methods, and Python may collect garbage in any of them. What it frees may
    be HDF5's own, such as datasets of another artifact: HDF5 is then entered a second time, and
    what it writes is damaged. A class, so that an interrupt can't leave a generator half done.
    """

    _collects = False

    def __enter__(self) -> None:
        self._collects = gc.isenabled()
        gc.disable()

    def __exit__(self, _: object, error: BaseException | None, __: object) -> None:
        if self._collects:
            gc.enable()


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that a reader finds the old one or the new one, never a part.

    Of two writers at once the later one wins. Raises ArtifactError when it can't be written, or is
    no file: whoever replaces a device takes it from all programs.
    """
    _require_file(path)
    with locked(path, wait=True), _temporary(path) as file:
        file.write(content)


def require_writable(path: Path) -> None:
    """Raise ArtifactError unless `write_whole` can write there: long work may come before it."""
    _require_file(path)
    with locked(path):  # which is a file beside it
        pass


def _require_file(path: Path) -> None:
    if path.exists() and not path.is_file():
        raise ArtifactError(f"{path} is not a file, so it can't be replaced; choose another name")


def remove_whole(path: Path) -> None:
    """Remove a file, and the temporary files of killed processes."""
    with locked(path, wait=True):
        path.unlink(missing_ok=True)


@contextlib.contextmanager
def replacement(path: Path, *, force: bool) -> Iterator[TemporaryFile]:
    """Open a temporary file that becomes `path` when the block ends without an exception.

    Raises ArtifactError when `path` may not be written: it exists and `force` is not set, it is a
    link or no file, another process writes it, permission or room is missing.
    """
    with explained(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    with locked(path):
        _refuse_existing(path, force)
        with _temporary(path) as file:
            yield file
            _refuse_existing(path, force)


@contextlib.contextmanager
def _temporary(path: Path) -> Iterator[TemporaryFile]:
    """Open a file beside `path` that takes its name in the end."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with explained(path):
            file = TemporaryFile(temporary)
        try:
            yield file
            with explained(path):
                file.check()
                os.fsync(file.fileno())
        finally:
            file.close()
        with explained(path):
            os.replace(temporary, path)
            folder = os.open(path.parent, os.O_RDONLY)
            try:
                os.fsync(folder)
            finally:
                os.close(folder)
    finally:
        temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn an error of the operating system while writing `path` into an ArtifactError."""
    try:
        yield
    except OSError as error:
        raise ArtifactError(f"{path} was not written: {_reason(error, path)}") from error


def _reason(error: OSError, path: Path) -> str:
    if error.errno in _NO_ROOM:
        return f"no room is left ({error.strerror}); free some, or write elsewhere with --out"
    if error.errno in _NO_PERMISSION:
        return f"no permission to write in {path.parent}; write elsewhere with --out"
    if error.errno == errno.EROFS:
        return f"{path.parent} is read-only; write elsewhere with --out"
    if error.errno == errno.ENOENT:
        return "its folder is missing, or was removed meanwhile"
    return f"{error.strerror or error}"


def _refuse_existing(path: Path, force: bool) -> None:
    with explained(path):
        try:
            mode = path.lstat().st_mode
        except FileNotFoundError:
            return
    if stat.S_ISLNK(mode):
        raise ArtifactError(f"{path} is a symbolic link, which is never written through; remove it")
    if not stat.S_ISREG(mode):
        raise ArtifactError(f"{path} is not a file, so it can't be replaced; remove it")
    if not force:
        raise ArtifactError(f"{path} exists already; --force replaces it")


@contextlib.contextmanager
def locked(path: Path, *, wait: bool = False) -> Iterator[None]:
    """Hold the lock of `path`, and remove what a killed writer of it left.

    Raises ArtifactError when another process holds it, unless this one is to wait.
    """
    lock = path.with_name(f".{path.name}.lock")
    with explained(path):
        descriptor, held = _acquire(lock, path, wait)
    try:
        if held:
            _remove_leftovers(path)
        yield
    finally:
        if held:
            with contextlib.suppress(OSError):
                lock.unlink()
        os.close(descriptor)


def _acquire(lock: Path, path: Path, wait: bool) -> tuple[int, bool]:
    """Return the lock's open file, and whether the file system has locks at all."""
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except BlockingIOError:
            owner = os.read(descriptor, 20).decode("ascii", "replace").strip() or "?"
            os.close(descriptor)
            raise ArtifactError(
                f"{path} is being written by another process (pid {owner}); "
                "wait for it, or write elsewhere with --out"
            ) from None
        except OSError as error:
            if error.errno in _NO_LOCKS:
                # The rename alone still keeps the file whole.
                return descriptor, False
            os.close(descriptor)
            raise
        # Whoever held the lock before removed its name on leaving: only a named lock counts.
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(lock.lstat(), os.fstat(descriptor)):
                with contextlib.suppress(OSError):  # of a full disk: it holds without a name too
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, str(os.getpid()).encode(), 0)
                return descriptor, True
        os.close(descriptor)


def _remove_leftovers(path: Path) -> None:
    prefix = f".{path.name}."
    with explained(path):
        for leftover in path.parent.iterdir():
            owner = leftover.name.removeprefix(prefix).removesuffix(".tmp")
            if leftover.name == f"{prefix}{owner}.tmp" and owner.isdigit():
                leftover.unlink()
