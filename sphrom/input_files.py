"""Read files whole, once their size shows that memory takes them."""

from __future__ import annotations

from pathlib import Path

from sphrom.machine import available_ram
from sphrom.text import data_size

TIMES_SIZE = 8
"""Memory that a file may need while it is read, over its size: words and numbers are objects."""


class Unreadable(ValueError):
    """Why a file is not read, in words that continue `FILE ...`."""


def read_whole(path: Path, most: int) -> bytes:
    """Return what a file of at most so many bytes holds.

    Raises Unreadable when it is no file or too large, OSError when it can't be read.
    """
    require_size(path, most)
    return path.read_bytes()


def require_size(path: Path, most: int) -> None:
    """Raise Unreadable for what is no file, or has more bytes than `most` or memory takes."""
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
