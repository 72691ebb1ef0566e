"""Report to a terminal, to a log, or to a program: lines, warnings, tables, progress.

Whatever the program shows goes through here: texts may come from files and arguments that somebody
else wrote, so that control characters are shown as escapes.
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
"""The log's name beside a case's artifacts."""
LINE_INTERVAL = 10.0
"""Seconds before the first plain line about progress."""
LONGEST_INTERVAL = 600.0
"""Each interval is twice the one before, up to this one [s]."""
REFRESHED = 0.1
"""Seconds from one change of a terminal's last line to the next."""
LONGEST_LINE = 500
"""Characters of an error or a warning: what they quote may be of any length."""
PROSE = 100
"""Characters of a line of sentences where there is no terminal."""
TOGETHER = re.compile("`[^`]*`|sphrom [^`]*$| %")
"""What stands in one line: a command to copy, of any length, a figure and its percent sign."""
WHOLE_WORDS: Any = {"break_long_words": False, "break_on_hyphens": False}
_ERASE = "\r\x1b[K"

_status = ""
"""The terminal's last line, which says how far things are."""


def tell(text: str, *, error: bool = False, indent: int = 0) -> None:
    """Write one line to the output, or to the error stream, where it has its middle left out.

    A terminal has it in lines of whole words, of which all but the first may be indented.
    """
    _show_status("")
    stream = sys.stderr if error else sys.stdout
    text = shortened(text, LONGEST_LINE) if error else visible(text)
    if stream.isatty():
        text = TOGETHER.sub(lambda found: found[0].replace(" ", "\xa0"), text)
        text = textwrap.fill(text, _columns(), subsequent_indent=" " * indent, **WHOLE_WORDS)
        text = text.replace("\xa0", " ")
    print(text, file=stream, flush=True)


def _columns() -> int:
    return shutil.get_terminal_size().columns


def _show_status(text: str) -> None:
    """Put a text in place of the terminal's last line."""
    global _status
    text = textwrap.shorten(visible(text), _columns() - 1, placeholder=" ...", **WHOLE_WORDS)
    if text != _status:
        _status = text
        print(_ERASE + text, end="", flush=True)


class LogFile:
    """The log of a command: lines with their times, added to a file once its folder is there.

    A log is no result: where it can't be written, the command goes on with a warning. Without a
    path there is no log.
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
        """Write what a command was told, and how it ended."""
        self.write("$ " + " ".join(command))
        try:
            yield
        except BaseException as error:
            for line in (str(error) or type(error).__name__).split("\n"):
                self.write(f"stopped: {line}")
            raise
        self.write("done")


class Level(IntEnum):
    """How much a line matters."""

    DETAIL = 0
    """For the log, and for who asks for details."""
    INFO = 1
    """Hidden by --quiet."""
    RESULT = 2


class Reporter:
    """Tells the user how a stage is getting on: lines of some level, warnings, tables, progress.

    Parameters
    ----------
    quiet : show warnings and results alone.
    verbose : show details, too.
    log : the file that has all of it.
    write : a program's own function, which takes each line in place of the output.
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
        """The reporter of details, which go to the log and appear only with --verbose."""
        return self._changed(_level=Level.DETAIL)

    def brief(self, *, label: str = "", progress: bool = False) -> Self:
        """Return the reporter of runs that are a means only: warnings, and progress if asked."""
        return self._changed(
            _is_brief=True, _has_progress=progress, _label=f"{label}: " if label else ""
        )

    def _changed(self, **attributes: object) -> Self:
        changed = copy(self)
        changed.__dict__.update(attributes)
        return changed

    def info(self, text: str) -> None:
        """Tell something in one line."""
        self._tell(text, self._level)

    def note(self, text: str) -> None:
        """Tell something in one line, also where details are hidden."""
        self._tell(text, Level.INFO)

    def result(self, text: str) -> None:
        """Tell a result in one line."""
        self._tell(text, Level.RESULT)

    def prose(self, text: str) -> None:
        """Tell a result in sentences."""
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
        """Show a result as a table: the first column to the left, numbers to the right.

        Columns that don't fit a terminal's line follow below, beside the first one again.
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

        The callable that it gives takes what was done since the last call. A terminal's last line
        says how far all that is running is. Where there is no terminal a line comes now and then
        of what takes long, and at the end; of a detail that was done quickly there is none.
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
    """Tells nobody."""

    def __init__(self) -> None:
        super().__init__(write=lambda text: None)


class _Progress:
    """How much of something is done, since when, and when to say so again."""

    def __init__(self, description: str, total: int) -> None:
        self._description, self._total = description, total
        self.start = self._since = time.monotonic()
        self.shown = -REFRESHED
        """When a terminal's line last told of it."""
        self.done = self._first = 0
        self._interval = LINE_INTERVAL
        self._next = self.start + self._interval

    def count(self, done: int) -> None:
        """Count what was done."""
        if not self.done:
            # Kernels may be compiled in what is done first: it says nothing of the rest.
            self._first, self._since = done, time.monotonic()
        self.done += done

    def is_due(self) -> bool:
        """Return whether to write a line: the more seldom the longer it takes."""
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
