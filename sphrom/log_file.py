"""The log of a command: all that it says, and its details, with the time of each line."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from sphrom.errors import CaseError
from sphrom.output_files import open_to_write
from sphrom.text import visible

LOG = "sphrom.log"
"""The log's name beside a case's artifacts."""


class LogFile:
    """Lines added to a file, from when its folder is there on.

    A log is no result: where it can't be written, the command goes on, and `refused` is called with
    the reason once.
    """

    def __init__(self, path: Path, refused: Callable[[str], None]) -> None:
        self._path = path
        self._refused: Callable[[str], None] | None = refused
        self._waiting: list[str] = []

    def write(self, text: str) -> None:
        """Add a line."""
        now = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
        self._waiting.append(f"{now}  {visible(text)}\n")
        if self._refused is None or not self._path.parent.is_dir():
            return
        lines, self._waiting = "".join(self._waiting), []
        try:
            with open_to_write(self._path, "a") as file:
                file.write(lines)
        except OSError as error:
            tell, self._refused = self._refused, None
            tell(f"{self._path}: no log is written: {error.strerror}")


def require_log(path: Path) -> Path:
    """Return the path of a log that is asked for. Raises CaseError where it can't be written."""
    try:
        with open_to_write(path, "a"):
            return path
    except OSError as error:
        raise CaseError(f"--log: {path} can't be written: {error.strerror}") from error


@contextmanager
def recorded(log: LogFile | None, command: Sequence[str]) -> Iterator[None]:
    """Write what a command was told, and how it ended."""
    if log is None:
        yield
        return
    log.write("$ " + " ".join(command))
    try:
        yield
    except BaseException as error:
        for line in (str(error) or type(error).__name__).split("\n"):
            log.write(f"stopped: {line}")
        raise
    log.write("done")
