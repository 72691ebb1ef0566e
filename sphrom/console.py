"""Report lines, warnings, tables and progress to a terminal, to a log, or to a program.

All output goes through this module. Texts may come from other people's files and arguments, so
control characters are shown as escapes.
"""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import copy
from datetime import datetime
from enum import IntEnum
from functools import partial
from pathlib import Path
from typing import Any, Self

from sphrom.text import duration, shortened, visible
from sphrom.whole_files import open_to_write

LOG = "sphrom.log"
"""Name of the log file beside the artifacts of a case."""
LINE_INTERVAL = 10.0
"""Time before the first plain line about progress [s]; each next interval is twice as long."""
LONGEST_INTERVAL = 600.0
"""Longest interval between such lines [s]."""
REFRESHED = 0.1
"""Time between changes of a terminal's last line [s]."""
LONGEST_LINE = 500
"""Most characters of an error or a warning; the texts that they quote may be of any length."""
PROSE = 100
"""Characters of a line of prose where there is no terminal."""
TOGETHER = re.compile("`[^`]*`|sphrom [^`]*$| %")
"""Texts that are never broken over lines: commands to copy, and a number with its percent sign."""
WHOLE_WORDS: Any = {"break_long_words": False, "break_on_hyphens": False}
_ERASE = "\r\x1b[K"

_status = ""
"""The terminal's last line, which shows progress."""


def tell(text: str, *, error: bool = False, indent: int = 0) -> None:
    """Write one line to the output, or shortened to the error stream.

    On a terminal the line is wrapped at whole words, with an indent from the second line on.
    """
    _show_status("")
    stream = sys.stderr if error else sys.stdout
    text = shortened(text, LONGEST_LINE) if error else visible(text)
    if stream.isatty():
        text = TOGETHER.sub(lambda match: match[0].replace(" ", "\xa0"), text)
        text = textwrap.fill(text, _columns(), subsequent_indent=" " * indent, **WHOLE_WORDS)
        text = text.replace("\xa0", " ")
    print(text, file=stream, flush=True)


def _columns() -> int:
    return shutil.get_terminal_size().columns


def _show_status(text: str) -> None:
    """Replace the terminal's last line."""
    global _status
    text = textwrap.shorten(visible(text), _columns() - 1, placeholder=" ...", **WHOLE_WORDS)
    if text != _status:
        _status = text
        print(_ERASE + text, end="", flush=True)


class LogFile:
    """The log of a command: lines with their times, appended to a file once its folder exists.

    If the log can't be written, the command continues with a warning. No path means no log.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._waiting: list[str] = []

    def write(self, text: str) -> None:
        """Add a line."""
        now = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
        self._waiting.append(f"{now}  {visible(text)}\n")
        if self._path is None or not self._path.parent.is_dir():
            return
        try:
            with open_to_write(self._path, "a") as file:
                file.write("".join(self._waiting))
        except OSError as error:
            tell(f"warning: {self._path}: no log is written: {error.strerror}", error=True)
            self._path = None
        self._waiting.clear()

    @contextmanager
    def recorded(self, command: Sequence[str]) -> Iterator[None]:
        """Write the command line at the start of the block, and the outcome at its end."""
        self.write("$ " + " ".join(command))
        try:
            yield
        except BaseException as error:
            for line in (str(error) or type(error).__name__).split("\n"):
                self.write(f"stopped: {line}")
            raise
        self.write("done")


class Level(IntEnum):
    """The importance of a line."""

    DETAIL = 0
    """In the log; on the terminal with --verbose only."""
    INFO = 1
    """Hidden by --quiet."""
    RESULT = 2


class Reporter:
    """Reports the progress of a stage to the user: lines, warnings and tables.

    Parameters
    ----------
    quiet : whether to show only warnings and results.
    verbose : whether to show details.
    log : log file, which gets all lines.
    write : a program's own function, which takes each line instead of the output.
    """

    def __init__(
        self,
        *,
        quiet: bool = False,
        verbose: bool = False,
        log: LogFile | None = None,
        write: Callable[[str], object] | None = None,
    ) -> None:
        self._least = Level.RESULT if quiet else Level.DETAIL if verbose else Level.INFO
        self._level = Level.INFO
        self._is_brief = self._has_progress = False
        self._label = ""
        self._log = log or LogFile()
        self._write = write
        self._terminal = write is None and sys.stdout.isatty()
        self._running: list[_Progress] = []

    @property
    def details(self) -> Self:
        """A reporter whose lines go to the log, and to the terminal with --verbose only."""
        return self._changed(_level=Level.DETAIL)

    def brief(self, *, label: str = "", progress: bool = False) -> Self:
        """Return a reporter for auxiliary runs: it shows warnings, and progress if asked."""
        return self._changed(
            _is_brief=True, _has_progress=progress, _label=f"{label}: " if label else ""
        )

    def _changed(self, **attributes: object) -> Self:
        changed = copy(self)
        changed.__dict__.update(attributes)
        return changed

    def info(self, text: str) -> None:
        """Report one line."""
        self._tell(text, self._level)

    def note(self, text: str) -> None:
        """Report one line, also where details are hidden."""
        self._tell(text, Level.INFO)

    def result(self, text: str) -> None:
        """Report a result in one line."""
        self._tell(text, Level.RESULT)

    def prose(self, text: str) -> None:
        """Report a result in sentences."""
        for line in [text] if self._terminal else textwrap.wrap(text, PROSE, **WHOLE_WORDS):
            self.result(line)

    def _tell(self, text: str, level: Level) -> None:
        if not self._is_brief:
            self._show(text, level)

    def _show(self, text: str, level: Level) -> None:
        self._log.write(text)
        if level >= self._least:
            (self._write or tell)(text)

    def warn(self, text: str) -> None:
        """Warn the user in one line, on the error stream."""
        text = f"warning: {self._label}{text}"
        self._log.write(text)
        (self._write or partial(tell, error=True))(text)

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Show a table with its first column aligned left and the others right.

        Columns that don't fit the width of the terminal follow below, with the first one repeated.
        """
        columns, *rows = ([visible(cell) for cell in row] for row in (columns, *rows))
        widths = [max(map(len, cells)) for cells in zip(columns, *rows, strict=True)]
        level = Level.DETAIL if self._level is Level.DETAIL else Level.RESULT
        room = _columns() if self._terminal else sys.maxsize
        parts: list[list[int]] = [[]]
        for k in range(1, len(widths)):
            if parts[-1] and widths[0] + sum(2 + widths[i] for i in (*parts[-1], k)) > room:
                parts.append([])
            parts[-1].append(k)
        self._tell(title, level)
        for part in parts:
            for row in (columns, ["-" * width for width in widths], *rows):
                cells = (row[k].rjust(widths[k]) for k in part)
                self._tell("  ".join((row[0].ljust(widths[0]), *cells)).rstrip(), level)

    @contextmanager
    def progress(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Show how much of `total` is done, and the time left.

        The block gets a function that takes the number of items done since its last call. The last
        line of a terminal shows all tasks in progress. Without a terminal, a line is written now
        and then, and at the end; for details that are quickly done, there is none.
        """
        if self._is_brief and not self._has_progress:
            yield lambda done: None
            return
        progress = _Progress(description, total)
        self._running.append(progress)

        def show() -> None:
            now, is_seen = time.monotonic(), self._terminal and self._least <= Level.INFO
            if is_seen and now >= progress.shown + REFRESHED:
                progress.shown = now
                _show_status("; ".join(map(str, self._running)))

        def advance(done: int) -> None:
            progress.count(done)
            show()
            if progress.is_due():
                self._show(str(progress), Level.DETAIL if self._terminal else Level.INFO)

        show()
        try:
            yield advance
        finally:
            self._running.remove(progress)
            _show_status("")
        seconds = time.monotonic() - progress.start
        is_hidden = self._terminal or (seconds < LINE_INTERVAL and self._level is Level.DETAIL)
        self._show(
            f"{description}: {progress.done} of {total} in {duration(seconds)}",
            Level.DETAIL if is_hidden else Level.INFO,
        )


class SilentReporter(Reporter):
    """A reporter that shows nothing."""

    def __init__(self) -> None:
        super().__init__(write=lambda text: None)


class _Progress:
    """Progress of a task: the share that is done, its rate, and the time of the next report."""

    def __init__(self, description: str, total: int) -> None:
        self._description, self._total = description, total
        self.start = self._since = time.monotonic()
        self.shown = -REFRESHED
        """Time of the last refresh of the terminal's line [s]."""
        self.done = self._first = 0
        self._interval = LINE_INTERVAL
        self._next = self.start + self._interval

    def count(self, done: int) -> None:
        """Add to the number of items done."""
        if not self.done:
            # The first items may include compiling kernels, so they don't count in the rate.
            self._first, self._since = done, time.monotonic()
        self.done += done

    def is_due(self) -> bool:
        """Return whether to write a line; the intervals grow with time."""
        now = time.monotonic()
        if now < self._next or not 0 < self.done < self._total:
            return False
        self._interval = min(2.0 * self._interval, LONGEST_INTERVAL)
        self._next = now + self._interval
        return True

    def __str__(self) -> str:
        text = f"{self._description}: {100 * self.done // max(1, self._total)} %"
        if self.done > self._first:
            each = (time.monotonic() - self._since) / (self.done - self._first)
            text += f", {duration(each * (self._total - self.done))} left"
        return text
