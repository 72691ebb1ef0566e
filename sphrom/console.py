"""Report to a terminal with bars and tables, and elsewhere in plain lines.

Whatever the program shows goes through here: texts may come from files and arguments that somebody
else wrote, so that control characters are shown as escapes, and markup is shown as it stands.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

from sphrom.text import visible

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

LINE_INTERVAL = 10.0
"""Seconds between two plain lines about progress."""


def tell(text: str, *, error: bool = False) -> None:
    """Write one line to the output, or to the error stream."""
    print(visible(text), file=sys.stderr if error else sys.stdout, flush=True)


class ConsoleReporter:
    """Tell the user how a stage is getting on; `quiet` leaves warnings and results."""

    def __init__(self, *, quiet: bool = False) -> None:
        self._quiet = quiet
        self._terminal = sys.stdout.isatty()
        self._bars: Progress | None = None

    def info(self, text: str) -> None:
        """Tell the user something in one line, unless quiet."""
        if not self._quiet:
            tell(text)

    def warn(self, text: str) -> None:
        """Warn the user in one line, on the error stream."""
        tell(f"warning: {text}", error=True)

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Show a result as a table."""
        if self._terminal:
            console = self._bars.console if self._bars else None
            _print_rich_table(console, title, columns, rows)
        else:
            for line in plain_table(title, columns, rows):
                tell(line)

    @contextmanager
    def progress(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Show how much of `total` is done, and the time left.

        Bars may be nested; one inside another comes below it.
        """
        if self._quiet:
            yield lambda done: None
        elif self._terminal:
            with self._bar(description, total) as advance:
                yield advance
        else:
            lines = ProgressLines(description, total, self.info)
            yield lines.advance
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


class ProgressLines:
    """Progress where no bar can be drawn: a line now and then, and one at the end."""

    def __init__(
        self,
        description: str,
        total: int,
        write: Callable[[str], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._description, self._total = description, total
        self._write, self._clock = write, clock
        self._start = self._last = clock()
        self._done = 0

    def advance(self, done: int) -> None:
        """Count what was done, and write a line when the last one is old."""
        self._done += done
        now = self._clock()
        if now - self._last >= LINE_INTERVAL and 0 < self._done < self._total:
            self._last = now
            left = (now - self._start) / self._done * (self._total - self._done)
            share = 100 * self._done // self._total
            self._write(f"{self._description}: {share} %, {format_seconds(left)} left")

    def finish(self) -> None:
        """Write how long it took."""
        taken = format_seconds(self._clock() - self._start)
        self._write(f"{self._description}: {self._done} of {self._total} in {taken}")


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
    )
