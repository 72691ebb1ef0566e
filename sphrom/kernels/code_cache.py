"""Where compiled code is kept: in files that are read whole or not at all.

Each file begins with a digest of the rest. One that is empty, cut or changed, as a power cut may
leave it, counts for nothing: the code is compiled and kept again. A file comes to its name when it
is complete, so that any number of processes may compile the same code at once.
"""

from __future__ import annotations

import hashlib
import os
import secrets
import stat
import tempfile
from dataclasses import dataclass
from pathlib import Path

VARIABLES = ("SPHROM_CACHE", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME")
"""Environment variables that name the folder: the first that is set."""
REMEDY = f"choose another folder with {VARIABLES[0]}"
DIGEST_SIZE = hashlib.sha256().digest_size


class CodeCacheWarning(UserWarning):
    """Compiled code is not kept where it should be."""


@dataclass(frozen=True)
class CodeCache:
    """Folders of compiled code, read one after the other; the last one is written to."""

    folders: tuple[Path, ...]
    fault: str | None = None
    """Why code is not kept where it should be, and what happens instead."""

    def read(self, name: str) -> bytes | None:
        """Return what is kept under a name; None where there is nothing, or it is damaged."""
        for folder in self.folders:
            try:
                kept = (folder / name).read_bytes()
            except OSError:
                continue
            digest, content = kept[:DIGEST_SIZE], kept[DIGEST_SIZE:]
            if hashlib.sha256(content).digest() == digest:
                return content
        return None

    def write(self, name: str, content: bytes) -> str | None:
        """Keep something under a name, over what is there; return why it can't be kept."""
        for folder in self.folders[-1:]:
            try:
                _write_whole(folder / name, hashlib.sha256(content).digest() + content)
            except OSError as error:
                return f"{_refusal(folder, error)}; {REMEDY}"
        return None


def find_cache(name: str) -> CodeCache:
    """Return the cache of a name: a temporary one where its own can't be written to, or none."""
    own = None
    try:
        own = _own_folder() / name
        _require_writable(own)
    except (OSError, RuntimeError) as error:
        fault = _refusal(own, error)
    else:
        return CodeCache((own,))
    try:
        temporary = _temporary_folder() / name
        _require_writable(temporary)
    except OSError:
        return CodeCache((), f"{fault}; every command compiles them anew; {REMEDY}")
    readable = (temporary,) if own is None else (own, temporary)
    return CodeCache(readable, f"{fault}; they are kept in {temporary.parent}; {REMEDY}")


def _own_folder() -> Path:
    """Return the user's folder. Raises RuntimeError when there is none."""
    named = next(filter(None, map(os.environ.get, VARIABLES)), None)
    return (Path(named) if named else Path.home() / ".cache") / "sphrom"


def _temporary_folder() -> Path:
    """Return a folder that nobody else can have put code into. Raises OSError."""
    user = os.getuid()
    folder = Path(tempfile.gettempdir()) / f"sphrom-{user}"
    folder.mkdir(mode=0o700, exist_ok=True)
    found = folder.lstat()
    others = stat.S_IWGRP | stat.S_IWOTH
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != user or found.st_mode & others:
        raise PermissionError(f"{folder} is not this user's alone")
    return folder


def _require_writable(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()


def _write_whole(path: Path, content: bytes) -> None:
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    try:
        temporary.write_bytes(content)
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _refusal(folder: Path | None, error: Exception) -> str:
    where = "" if folder is None else f" in {folder}"
    reason = getattr(error, "strerror", None) or str(error).rstrip(".")
    return f"compiled kernels can't be kept{where}: {reason}"
