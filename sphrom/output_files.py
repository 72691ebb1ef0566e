"""Open files to write to, without waiting for anybody."""

from __future__ import annotations

import io
import os
from pathlib import Path


def open_to_write(path: Path, mode: str) -> io.TextIOWrapper:
    """Open a file to write text to; a pipe has to have a reader already.

    Raises OSError when it can't be written to.
    """

    def opened(name: str, flags: int) -> int:
        descriptor = os.open(name, flags | os.O_NONBLOCK, 0o666)
        os.set_blocking(descriptor, True)
        return descriptor

    return io.TextIOWrapper(io.FileIO(path, mode, opener=opened), encoding="utf-8")
