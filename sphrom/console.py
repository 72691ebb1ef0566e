"""Report to a terminal with bars and tables, and elsewhere in plain lines.

Whatever the program shows goes through here: texts may come from files and arguments that somebody
else wrote, so that control characters are shown as escapes, and markup is shown as it stands.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import TYPE_CHECKING, Literal, Protocol

from sphrom.text import shortened, visible

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

    from sphrom.log_file import LogFile

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


class ConsoleReporter:
    """Tell the user how a stage is getting on; `quiet` leaves warnings and results.

    Details are shown where `verbose` asks for them, and are in the log in any case.
    """

    def __init__(
        self, *, quiet: bool = False, verbose: bool = False, log: LogFile | None = None
    ) -> None:
        self._quiet = quiet
        self._verbose = verbose
        self._log = log
        self._terminal = sys.stdout.isatty()
        self._bars: Progress | None = None

    @property
    def details(self) -> DetailReporter:
        """Who is told details."""
        return DetailReporter(self)

    def info(self, text: str, *, detail: bool = False) -> None:
        """Tell the user something in one line, unless quiet; a detail to who wants details."""
        self._write_log(text)
        if not self._quiet and (self._verbose or not detail):
            tell(text)

    def note(self, text: str) -> None:
        """Tell the user something in one line, also where details are hidden, unless quiet."""
        self.info(text)

    def result(self, text: str) -> None:
        """Tell the user a result in one line."""
        self._write_log(text)
        tell(text)

    def warn(self, text: str) -> None:
        """Warn the user in one line, on the error stream."""
        self._write_log(f"warning: {text}")
        tell(f"warning: {text}", error=True)

    def table(
        self,
        title: str,
        columns: Sequence[str],
        rows: Sequence[Sequence[str]],
        *,
        detail: bool = False,
    ) -> None:
        """Show a result as a table; one of details to who wants details."""
        lines = list(plain_table(title, columns, rows))
        for line in lines if self._log else ():
            self._write_log(line)
        if detail and not self._verbose:
            return
        if self._terminal:
            console = self._bars.console if self._bars else None
            _print_rich_table(console, title, columns, rows)
        else:
            for line in lines:
                tell(line)

    @contextmanager
    def progress(
        self, description: str, total: int, *, detail: bool = False
    ) -> Iterator[Callable[[int], None]]:
        """Show how much of `total` is done, and the time left.

        A bar goes when all is done. Bars may be nested; one inside another comes below it. Where
        there is no terminal a line comes now and then of what takes long, and at the end; of a
        detail that was done quickly there is none.
        """

        def tell_line(text: str, *, quickly: bool) -> None:
            self._write_log(text)
            shown = not self._terminal and not (detail and quickly)
            if not self._quiet and (shown or self._verbose):
                tell(text)

        lines = ProgressLines(description, total, tell_line)
        if self._quiet or not self._terminal:
            yield lines.advance
        else:
            with self._bar(description, total) as advance:

                def both(done: int) -> None:
                    lines.advance(done)
                    advance(done)

                yield both
        lines.finish()

    @contextmanager
    def _bar(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        outermost = self._bars is None
        bars = self._bars = self._bars or _new_bars()
        if outermost:
            bars.start()
        task = bars.add_task(visible(description), total=total)
        try:
            yield lambda done: bars.advance(task, done)
        finally:
            if outermost:
                bars.stop()
                self._bars = None
            else:
                bars.remove_task(task)

    def _write_log(self, text: str) -> None:
        if self._log is not None:
            self._log.write(text)


class DetailReporter:
    """Whom a stage tells what is a detail where it runs: most of it is for the log."""

    def __init__(self, report: ConsoleReporter) -> None:
        self._report = report
        self.note, self.result, self.warn = report.note, report.result, report.warn

    @property
    def details(self) -> DetailReporter:
        """Who is told details: the same."""
        return self

    def info(self, text: str) -> None:
        """Tell a detail in one line."""
        self._report.info(text, detail=True)

    def progress(
        self, description: str, total: int
    ) -> AbstractContextManager[Callable[[int], None]]:
        """Show how much of `total` is done, and the time left."""
        return self._report.progress(description, total, detail=True)

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Show details as a table."""
        self._report.table(title, columns, rows, detail=True)


class WriteProgress(Protocol):
    """Whom progress is told."""

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
        redirect_stderr=sys.stderr.isatty(),
        transient=True,
    )
