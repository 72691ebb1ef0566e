"""Replace a file as a whole, by one process at a time, or leave everything as it was.

A new file grows beside its target under a temporary name and takes the target's name once it is
complete and on disk. A lock beside the target keeps other processes away; it belongs to an open
file, so that the lock of a killed process is gone with it, and what that process left is removed.
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

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer

_NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
_NO_PERMISSION = {errno.EACCES, errno.EPERM}
_NO_LOCKS = {errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP}


class TemporaryFile(io.RawIOBase):
    """The file that HDF5 writes to.

    HDF5 can't close a file whose disk is full: it tries to write again, and crashes. So the first
    failure is kept, later writes are dropped, HDF5 closes in peace, and `check` raises the failure.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        self._position = 0
        self._failure: BaseException | None = None

    def check(self) -> None:
        """Raise what went wrong while HDF5 was writing, an interrupt included."""
        if self._failure is not None:
            raise self._failure

    @property
    def removed(self) -> bool:
        """Whether the file has no name any more."""
        return os.fstat(self._descriptor).st_nlink == 0

    def discard(self) -> None:
        """Drop every write from here on: the file will not be kept."""
        self._failure = self._failure or OSError(errno.ECANCELED, "discarded")

    def synchronize(self) -> None:
        """Wait until the disk has the bytes."""
        os.fsync(self._descriptor)

    def readable(self) -> bool:
        """HDF5 reads back what it wrote."""
        return True

    def writable(self) -> bool:
        """HDF5 writes."""
        return True

    def seekable(self) -> bool:
        """HDF5 writes anywhere."""
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to `offset`, from the start, the position or the end."""
        bases = {os.SEEK_SET: 0, os.SEEK_CUR: self._position}
        base = bases[whence] if whence in bases else os.fstat(self._descriptor).st_size
        self._position = base + offset
        return self._position

    def tell(self) -> int:
        """Return the position."""
        return self._position

    def readinto(self, buffer: WriteableBuffer) -> int:
        """Read at the position; beyond the file's end there are zeros."""
        view = memoryview(buffer).cast("B")
        count = os.preadv(self._descriptor, [view], self._position)
        view[count:] = bytes(len(view) - count)
        self._position += len(view)
        return len(view)

    def write(self, data: ReadableBuffer) -> int:
        """Write at the position, or drop the data when a write has failed before."""
        view = memoryview(data).cast("B")
        if self._failure is None and not self.closed:
            try:
                _write_fully(self._descriptor, view, self._position)
            except BaseException as error:
                self._failure = error
        self._position += len(view)
        return len(view)

    def truncate(self, size: int | None = None) -> int:
        """Set the file's length."""
        length = self._position if size is None else size
        if self._failure is None and not self.closed:
            try:
                os.ftruncate(self._descriptor, length)
            except BaseException as error:
                self._failure = error
        return length

    def flush(self) -> None:
        """Do nothing: nothing is buffered, and HDF5 flushes what an interrupt left open."""

    def close(self) -> None:
        """Close the file; a second time does nothing."""
        if not self.closed:
            os.close(self._descriptor)
        super().close()


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


def _write_fully(descriptor: int, view: memoryview, position: int) -> None:
    done = 0
    while done < len(view):
        done += os.pwrite(descriptor, view[done:], position + done)


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
        temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
        try:
            with explained(path):
                file = TemporaryFile(temporary)
            try:
                yield file
                with explained(path):
                    file.check()
                    file.synchronize()
            finally:
                file.close()
            _refuse_existing(path, force)
            with explained(path):
                os.replace(temporary, path)
                _synchronize_folder(path.parent)
        finally:
            with contextlib.suppress(FileNotFoundError):
                temporary.unlink()


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
        return "its folder, or what was there of it, was removed meanwhile"
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
def locked(path: Path) -> Iterator[None]:
    """Hold the lock of `path`, and remove what a killed writer of it left.

    Raises ArtifactError when another process holds it.
    """
    lock = path.with_name(f".{path.name}.lock")
    with explained(path):
        descriptor, held = _acquire(lock, path)
    try:
        if held:
            _remove_leftovers(path)
        yield
    finally:
        if held:
            with contextlib.suppress(OSError):
                lock.unlink()
        os.close(descriptor)


def _acquire(lock: Path, path: Path) -> tuple[int, bool]:
    """Return the lock's open file, and whether the file system has locks at all."""
    while True:
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
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
        if _is_named(lock, descriptor):
            with contextlib.suppress(OSError):  # of a full disk: the lock holds without a name too
                os.ftruncate(descriptor, 0)
                os.pwrite(descriptor, str(os.getpid()).encode(), 0)
            return descriptor, True
        os.close(descriptor)


def _is_named(lock: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(lock.lstat(), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _remove_leftovers(path: Path) -> None:
    prefix = f".{path.name}."
    with explained(path):
        for leftover in path.parent.iterdir():
            owner = leftover.name.removeprefix(prefix).removesuffix(".tmp")
            if leftover.name == f"{prefix}{owner}.tmp" and owner.isdigit():
                leftover.unlink()


def _synchronize_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
