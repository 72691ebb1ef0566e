"""Writing a file as a whole: to a temporary beside it, renamed when it is complete."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from sphrom.errors import ArtifactError


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that a reader finds the old one or the new one, never a part.

    Raises ArtifactError when the folder can't be written to.
    """
    temporary: Path | None = None
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
        temporary = Path(name)
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
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
