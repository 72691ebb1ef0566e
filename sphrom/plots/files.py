"""Writing a file as a whole: to a temporary beside it, renamed when it is complete."""

from __future__ import annotations

import glob
import os
import tempfile
from contextlib import suppress
from pathlib import Path

from sphrom.errors import ArtifactError


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that a reader finds the old one or the new one, never a part.

    What a killed process left of it goes. Of two writers at once the later one wins.

    Raises ArtifactError when the folder can't be written to.
    """
    temporary: Path | None = None
    try:
        _remove_temporaries(path)
        handle, name = _temporary(path)
        temporary = Path(name)
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        with suppress(FileNotFoundError):  # another writer has taken it for a killed one's
            temporary.chmod(0o644)
            temporary.replace(path)
    except BaseException as error:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        if not isinstance(error, OSError):
            raise
        raise _refusal(path, error) from error


def require_writable(path: Path) -> None:
    """Raise ArtifactError where a file can't be written, before anything is computed for it."""
    try:
        handle, name = _temporary(path)
        os.close(handle)
        os.unlink(name)
    except OSError as error:
        raise _refusal(path, error) from error


def _temporary(path: Path) -> tuple[int, str]:
    """Open a temporary file beside one. Raises ArtifactError where that can't be replaced.

    Whoever may replace a device takes it from all programs.
    """
    if path.exists() and not path.is_file():
        raise ArtifactError(f"{path} is not a file, so it can't be replaced; choose another name")
    return tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)


def _refusal(path: Path, error: OSError) -> ArtifactError:
    return ArtifactError(
        f"{path} can't be written ({error.strerror}): free space there, or choose another folder "
        "with --out"
    )


def remove_whole(path: Path) -> None:
    """Remove a file, and the temporary files of killed processes."""
    path.unlink(missing_ok=True)
    _remove_temporaries(path)


def _remove_temporaries(path: Path) -> None:
    for left in path.parent.glob(f".{glob.escape(path.name)}-*"):
        left.unlink(missing_ok=True)
