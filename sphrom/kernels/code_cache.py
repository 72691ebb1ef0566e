"""The cache of compiled code: files that are read as a whole or not at all.

Each file begins with a digest of the rest. A file that is empty, truncated or changed, for example
after a power failure, is ignored, and the code is compiled and stored again. A file gets its name
when it is complete, so any number of processes may compile the same code at the same time. Usually
only one does: a process that starts to compile claims the code, and the others wait.
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import os
import secrets
import tempfile
import time
import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path

VARIABLES = ("SPHROM_CACHE", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME")
"""Environment variables that name the folder; the first one that is set is used."""
PATIENCE = 60.0
"""Longest time to wait for code that another process compiles [s]."""
MOMENT = 0.02
"""Time after which a waiting process looks again [s]."""
DIGEST_SIZE = hashlib.sha256().digest_size


class CodeCacheWarning(UserWarning):
    """Compiled code cannot be stored."""


class CompilingWarning(CodeCacheWarning):
    """Code that is not stored yet is being compiled."""


@dataclass(frozen=True)
class CodeCache:
    """A folder of compiled code; None if the user has none."""

    folder: Path | None
    writable: bool = True

    def read(self, name: str) -> bytes | None:
        """Return the content stored under a name; None if there is none, or it is damaged."""
        try:
            kept = (self.folder / name).read_bytes() if self.folder else b""
        except OSError:
            return None
        digest, content = kept[:DIGEST_SIZE], kept[DIGEST_SIZE:]
        return content if hashlib.sha256(content).digest() == digest else None

    def write(self, name: str, content: bytes) -> None:
        """Store content under a name, replacing the old one; warn if it cannot be stored."""
        if self.folder is None or not self.writable:
            return
        temporary = self.folder / f".{name}.{secrets.token_hex(8)}"
        try:
            temporary.write_bytes(hashlib.sha256(content).digest() + content)
            temporary.replace(self.folder / name)
        except OSError as error:
            _warn_of(self.folder, error)
        finally:
            temporary.unlink(missing_ok=True)

    def claim(self, name: str) -> None:
        """Wait while another process compiles the code of a name, then claim it until `release`.

        A claim ends with its process. Where files can't be locked, nothing is claimed or awaited.
        """
        end = time.monotonic() + PATIENCE
        while self._lock(name, fcntl.LOCK_EX | fcntl.LOCK_NB) and time.monotonic() < end:
            time.sleep(MOMENT)

    def release(self, name: str) -> None:
        """End a claim."""
        self._lock(name, fcntl.LOCK_UN)

    def _lock(self, name: str, how: int) -> bool:
        """Lock or unlock the byte of a name; return whether another process has locked it."""
        if self.folder is None or not self.writable:
            return False
        place = int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big")
        try:
            file = _lock_file(self.folder)
        except OSError:  # for example of another user
            return False
        try:
            fcntl.lockf(file, how, 1, place)
        except OSError as error:
            return error.errno in (errno.EACCES, errno.EAGAIN)
        return False


@cache
def _lock_file(folder: Path) -> int:
    """Open the file whose bytes are locked; it stays open, since closing it ends all claims."""
    return os.open(folder.with_suffix(".lock"), os.O_RDWR | os.O_CREAT, 0o666)


def find_cache(name: str) -> CodeCache:
    """Return the cache of a name in the user's folder; warn if it is not writable."""
    named = next(filter(None, map(os.environ.get, VARIABLES)), None)
    folder = None
    try:
        folder = (Path(named) if named else Path.home() / ".cache") / "sphrom" / name
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except (OSError, RuntimeError) as error:
        _warn_of(folder, error)
        return CodeCache(folder, writable=False)
    return CodeCache(folder)


def _warn_of(folder: Path | None, error: Exception) -> None:
    where = "" if folder is None else f" in {folder}"
    reason = getattr(error, "strerror", None) or str(error).rstrip(".")
    warnings.warn(
        f"compiled kernels can't be kept{where}: {reason}; every command compiles them again; "
        f"choose another folder with {VARIABLES[0]}",
        CodeCacheWarning,
        stacklevel=1,
    )
