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
        handle, name = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
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
        raise ArtifactError(
            f"{path} can't be written ({error.strerror}): free space there, or choose another "
            "folder with --out"
        ) from error


def remove_whole(path: Path) -> None:
    """Remove a file, and the temporary files of killed processes."""
    path.unlink(missing_ok=True)
    _remove_temporaries(path)


def _remove_temporaries(path: Path) -> None:
    for left in path.parent.glob(f".{glob.escape(path.name)}-*"):
        left.unlink(missing_ok=True)
