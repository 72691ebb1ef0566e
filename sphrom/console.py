"""Report to a terminal with bars and tables, and elsewhere in plain lines.

Whatever the program shows goes through here: texts may come from files and arguments that somebody
else wrote, so that control characters are shown as escapes, and markup is shown as it stands.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from copy import copy
from datetime import datetime
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Protocol, Self

from sphrom.errors import CaseError
from sphrom.text import shortened, visible
from sphrom.whole_files import open_to_write

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

LOG = "sphrom.log"
"""The log's name beside a case's artifacts."""
LINE_INTERVAL = 10.0
"""Seconds before the first plain line about progress."""
LONGEST_INTERVAL = 600.0
"""Each interval is twice the one before, up to this one [s]."""
LONGEST_LINE = 500
"""Characters of an error or a warning: what they quote may be of any length."""


def tell(text: str, *, error: bool = False) -> None:
    """Write one line to the output, or to the error stream, where it has its middle left out."""
    if error:
        print(shortened(text, LONGEST_LINE), file=sys.stderr, flush=True)
    else:
        print(visible(text), flush=True)


class LogFile:
    """The log of a command: lines with their times, added to a file once its folder is there.

    A log is no result: where it can't be written, the command goes on with a warning.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._refused = False
        self._waiting: list[str] = []

    def write(self, text: str) -> None:
        """Add a line."""
        now = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
        self._waiting.append(f"{now}  {visible(text)}\n")
        if self._refused or not self._path.parent.is_dir():
            return
        lines, self._waiting = "".join(self._waiting), []
        try:
            with open_to_write(self._path, "a") as file:
                file.write(lines)
        except OSError as error:
            self._refused = True
            tell(f"warning: {self._path}: no log is written: {error.strerror}", error=True)


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


class Level(IntEnum):
    """How much a line matters."""

    DETAIL = 0
    """For the log, and for who asks for details."""
    INFO = 1
    """Hidden by --quiet."""
    RESULT = 2


class PlainReporter(Protocol):
    """A program's own reporter, which is told everything alike."""

    def info(self, text: str) -> None:
        """Take a line."""

    def warn(self, text: str) -> None:
        """Take a warning of one line."""

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Take a result as a table."""

    def progress(
        self, description: str, total: int
    ) -> AbstractContextManager[Callable[[int], None]]:
        """Begin something of `total` steps; the callable that it gives takes those done since."""


class Reporter:
    """Tells the user how a stage is getting on: lines of some level, warnings, tables, progress.

    Parameters
    ----------
    quiet : show warnings and results alone.
    verbose : show details, too.
    log : the file that has all of it.
    """

    def __init__(
        self, *, quiet: bool = False, verbose: bool = False, log: LogFile | None = None
    ) -> None:
        self._least = Level.RESULT if quiet else Level.DETAIL if verbose else Level.INFO
        self._level = Level.INFO
        self._is_brief = self._has_progress = False
        self._label = ""
        self._log = log
        self._terminal = sys.stdout.isatty()
        self._bars = _Bars()

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

    def _tell(self, text: str, level: Level) -> None:
        if not self._is_brief:
            self._show(text, level)

    def _show(self, text: str, level: Level) -> None:
        if self._log is not None:
            self._log.write(text)
        if level >= self._least:
            tell(text)

    def warn(self, text: str) -> None:
        """Warn the user in one line, on the error stream."""
        text = f"warning: {self._label}{text}"
        if self._log is not None:
            self._log.write(text)
        tell(text, error=True)

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Show a result as a table."""
        if self._is_brief:
            return
        lines = list(plain_table(title, columns, rows))
        shown = self._level >= min(self._least, Level.INFO)
        for line in lines:
            if self._log is not None:
                self._log.write(line)
            if shown and not self._terminal:
                tell(line)
        if shown and self._terminal:
            _print_rich_table(self._bars.console, title, columns, rows)

    def progress(
        self, description: str, total: int
    ) -> AbstractContextManager[Callable[[int], None]]:
        """Show how much of `total` is done, and the time left.

        The callable that it gives takes what was done since the last call. A bar goes when all is
        done. Bars may be nested; one inside another comes below it. Where there is no terminal a
        line comes now and then of what takes long, and at the end; of a detail that was done
        quickly there is none.
        """
        if self._is_brief and not self._has_progress:
            return nullcontext(lambda done: None)
        return self._progress(description, total)

    @contextmanager
    def _progress(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        def write(text: str, *, quickly: bool) -> None:
            hidden = self._terminal or (quickly and self._level is Level.DETAIL)
            self._show(text, Level.DETAIL if hidden else Level.INFO)

        lines = ProgressLines(description, total, write)
        if self._terminal and self._least <= Level.INFO:
            with self._bars.bar(description, total) as advance:

                def both(done: int) -> None:
                    lines.advance(done)
                    advance(done)

                yield both
        else:
            yield lines.advance
        lines.finish()


class ProgramReporter(Reporter):
    """Tells a program's own reporter."""

    def __init__(self, report: PlainReporter) -> None:
        super().__init__()
        self._report = report

    def _show(self, text: str, level: Level) -> None:
        self._report.info(text)

    def warn(self, text: str) -> None:
        """Warn the program in one line."""
        self._report.warn(self._label + text)

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Give the program a table."""
        if not self._is_brief:
            self._report.table(title, columns, rows)

    @contextmanager
    def _progress(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        with self._report.progress(description, total) as advance:
            yield advance


class SilentReporter(Reporter):
    """Tells nobody."""

    def __init__(self) -> None:
        super().__init__()
        self._is_brief = True

    def warn(self, text: str) -> None:
        """Drop it."""


class _Bars:
    """The bars of a terminal, while there are any."""

    def __init__(self) -> None:
        self._progress: Progress | None = None

    @property
    def console(self) -> Console | None:
        """Where to print above the bars; None where there are none."""
        return None if self._progress is None else self._progress.console

    @contextmanager
    def bar(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Show a bar within the block."""
        outermost = self._progress is None
        bars = self._progress = self._progress or _new_bars()
        if outermost:
            bars.start()
        task = bars.add_task(visible(description), total=total)
        try:
            yield lambda done: bars.advance(task, done)
        finally:
            if outermost:
                bars.stop()
                self._progress = None
            else:
                bars.remove_task(task)


class WriteProgress(Protocol):
    """Writes one line of progress."""

    def __call__(self, text: str, *, quickly: bool) -> None:
        """Take a line, which may be the last of what was done quickly."""


class ProgressLines:
    """Progress in lines: the more seldom the longer it takes, and one at the end."""

    def __init__(
        self,
        description: str,
        total: int,
        write: WriteProgress,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._description, self._total = description, total
        self._write, self._clock = write, clock
        self._start = clock()
        self._interval = LINE_INTERVAL
        self._next = self._start + self._interval
        self._done = self._first = 0
        self._since = self._start

    def advance(self, done: int) -> None:
        """Count what was done, and write a line when the last one is old."""
        now = self._clock()
        if not self._done:
            # Kernels may be compiled in what is done first: it says nothing of the rest.
            self._first, self._since = done, now
        self._done += done
        if now >= self._next and 0 < self._done < self._total:
            self._interval = min(2.0 * self._interval, LONGEST_INTERVAL)
            self._next = now + self._interval
            share = 100 * self._done // self._total
            text = f"{self._description}: {share} %"
            if self._done > self._first:
                each = (now - self._since) / (self._done - self._first)
                text += f", {format_seconds(each * (self._total - self._done))} left"
            self._write(text, quickly=False)

    def finish(self) -> None:
        """Write how long it took."""
        seconds = self._clock() - self._start
        text = f"{self._description}: {self._done} of {self._total} in {format_seconds(seconds)}"
        self._write(text, quickly=seconds < LINE_INTERVAL)


def format_seconds(seconds: float) -> str:
    """Return a duration for people, such as `0.4 s`, `12 s`, `3 min 5 s` or `2 h 10 min`."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def plain_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the lines of a table: the first column to the left, numbers to the right."""
    columns, *rows = ([visible(cell) for cell in row] for row in (columns, *rows))
    widths = [max(map(len, cells)) for cells in zip(columns, *rows, strict=True)]
    yield title
    for row in (columns, ["-" * width for width in widths], *rows):
        cells = [
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield "  ".join(cells).rstrip()


def _print_rich_table(
    console: Console | None, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]
) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    def plain(text: str) -> Text:
        return Text(visible(text))

    # Narrow gaps and folded cells: a wide table is still whole on a terminal of 80 columns.
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=0)
    for i, column in enumerate(columns):
        justify: Literal["left", "right"] = "left" if i == 0 else "right"
        table.add_column(plain(column), justify=justify, overflow="fold")
    for row in rows:
        table.add_row(*map(plain, row))
    console = console or Console()
    console.print(plain(title), style="bold")
    console.print(table)


def _new_bars() -> Progress:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    return Progress(
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        console=Console(),  # that of all programs in this process may be set in another way
        redirect_stderr=sys.stderr.isatty(),
        transient=True,
    )
