"""Report lines, warnings, tables and progress to a terminal, to a log, or to a program.

All output goes through this module. Texts may come from other people's files and arguments, so
control characters are shown as escapes. Only on a terminal, rich is loaded and lays out the output.
"""

from __future__ import annotations

import re
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from datetime import datetime
from enum import IntEnum
from functools import partial
from itertools import accumulate
from pathlib import Path
from typing import Any, Self, TextIO

from sphrom.progress import LEAST_LEFT, MOST_SHOWN, Progress, StageTime, clock
from sphrom.text import duration, shortened, visible
from sphrom.whole_files import open_to_write

LOG = "sphrom.log"
"""Name of the log file beside the artifacts of a case."""
LINE_INTERVAL = 10.0
"""Time before the first plain line about progress [s]; each next interval is twice as long."""
LONGEST_INTERVAL = 600.0
"""Longest interval between such lines [s]."""
LONGEST_LINE = 500
"""Largest number of characters of an error or a warning; the texts that they quote may be of any
length."""
PROSE = 100
"""Characters of a line of prose where there is no terminal."""
TOGETHER = re.compile("`[^`]*`|sphrom [^`]*$| %")
"""Texts that are never broken over lines: commands to copy, and a number with its percent sign."""
WHOLE_WORDS: Any = {"break_long_words": False, "break_on_hyphens": False}
AUTO_REFRESH = True
"""Whether bars are drawn again by themselves, about four times a second."""
_bars: Any = None
"""The progress bars below the lines of the terminal."""


def tell(text: str, *, error: bool = False, indent: int = 0, style: str = "") -> None:
    """Write one line, wrapped on a terminal, to the output or, shortened, to the error stream."""
    stream = sys.stderr if error else sys.stdout
    text = shortened(text, LONGEST_LINE) if error else visible(text)
    is_terminal = getattr(stream, "rich_proxied_file", stream).isatty()
    if is_terminal:
        text = TOGETHER.sub(lambda match: match[0].replace(" ", "\xa0"), text)
        width = shutil.get_terminal_size().columns
        text = textwrap.fill(text, width, subsequent_indent=" " * indent, **WHOLE_WORDS)
        text = text.replace("\xa0", " ")
    if is_terminal and (style or _bars):
        _console(stream).print(text, style=style, soft_wrap=True)
    else:
        print(text, file=stream, flush=True)


def _console(stream: TextIO) -> Any:
    """Return the terminal of a stream, which interprets no text as markup, emoji or a number."""
    from rich.console import Console

    if _bars is not None:
        return _bars.console
    return Console(file=stream, force_jupyter=False, markup=False, emoji=False, highlight=False)


def _show_table(columns: Sequence[Sequence[str]]) -> None:
    """Show a table on the terminal. Columns that don't fit follow below, beside the first one."""
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    console = _console(sys.stdout)
    ends = accumulate(2 + max(map(len, cells)) for cells in columns)
    n_fit = max(2, sum(end - 2 <= console.width for end in ends))
    headings, *rows = zip(*columns[:n_fit], strict=True)
    table = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, padding=(0, 1, 0, 0))
    for heading in headings:
        table.add_column(heading, justify="right" if table.columns else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    console.print(table)
    if columns[n_fit:]:
        _show_table([columns[0], *columns[n_fit:]])


def _new_bars() -> Any:
    """Return bars that update their text about four times a second."""
    from rich import progress

    class Bars(progress.Progress):
        def get_renderables(self) -> Any:
            for task in self.tasks:
                task.description, share, task.fields["beside"] = task.fields["shown"]()
                task.total = None if share is None else 1.0
                task.completed = share or 0.0
            return super().get_renderables()

    return Bars(
        progress.SpinnerColumn(), "{task.description}", progress.BarColumn(20),
        "{task.fields[beside]}",
        console=_console(sys.stdout), redirect_stderr=sys.stderr.isatty(), transient=True,
        auto_refresh=AUTO_REFRESH, refresh_per_second=4.0,
    )  # fmt: skip


Shown = Callable[[], tuple[str, float | None, str]]
"""A function that returns a bar's text, the share done if known, and a text beside the bar."""


@contextmanager
def _bar(shown: Shown) -> Iterator[None]:
    """Show a progress bar below the lines."""
    global _bars
    bars = _bars = _bars or _new_bars()
    task = bars.add_task("", beside="", shown=shown)
    try:
        bars.start()
        bars.refresh()
        bars.console.show_cursor()  # a killed process could not do it
        yield
    finally:
        if task == bars.task_ids[0]:
            _bars = None
            bars.stop()
        bars.remove_task(task)
        bars.refresh()


def show_compiling() -> None:
    """From now on, show below other bars the functions that are being compiled."""
    from numba.core import event

    class Compiling(event.Listener):
        def on_start(self, event: Any) -> None:
            name = event.data["dispatcher"].py_func.__name__
            if not running:
                clock.stop()
            running.append(ExitStack())
            if _bars:
                running[-1].enter_context(_bar(lambda: (f"compiling {name}", None, "")))

        def on_end(self, event: Any) -> None:
            running.pop().close()
            if not running:
                clock.go_on()

    running: list[ExitStack] = []
    event.register("numba:compile", Compiling())


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
            _warn(f"warning: {self._path}: no log is written: {error.strerror}")
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Reporter:
    """Reports the progress of a stage to the user: lines, warnings and tables."""

    quiet: bool = False
    """Whether to show only warnings and results."""
    verbose: bool = False
    """Whether to show details."""
    log: LogFile = field(default_factory=LogFile)
    """A file that gets all lines."""
    write: Callable[[str], object] | None = None
    """A program's own function, which takes each line instead of the output."""
    _level: Level = Level.INFO
    _is_brief: bool = False
    _has_progress: bool = True
    _whole: Progress | None = None
    _label: str = ""

    @property
    def details(self) -> Self:
        """A reporter whose lines go to the log, and to the terminal with --verbose only."""
        return replace(self, _level=Level.DETAIL)

    def brief(self, *, label: str = "", progress: bool = False) -> Self:
        """Return a reporter for auxiliary runs: it shows warnings, and progress if asked."""
        return replace(self, _is_brief=True, _has_progress=progress, _label=label and f"{label}: ")

    @property
    def _terminal(self) -> bool:
        return self.write is None and (_bars is not None or sys.stdout.isatty())

    @property
    def _has_bars(self) -> bool:
        return self._terminal and self._shows(Level.INFO) and _console(sys.stdout).is_interactive

    def _shows(self, level: Level) -> bool:
        return level >= (Level.RESULT if self.quiet else Level.INFO - self.verbose)

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
            self.log.write(text)
            if self._shows(level):
                (self.write or tell)(text)

    def warn(self, text: str) -> None:
        """Warn the user in one line, on the error stream."""
        text = f"warning: {self._label}{text}"
        self.log.write(text)
        (self.write or _warn)(text)

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Show a table with its first column aligned left and the others right."""
        rows = [[visible(cell) for cell in row] for row in (columns, *rows)]
        cells = list(zip(*rows, strict=True))
        widths = [max(map(len, column)) for column in cells]
        level = Level.DETAIL if self._level is Level.DETAIL else Level.RESULT
        is_laid_out = self._terminal and self._shows(level) and not self._is_brief
        show = self.log.write if is_laid_out else partial(self._tell, level=level)
        show(title)
        for row in (rows[0], ["-" * width for width in widths], *rows[1:]):
            texts = (row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:]))
            show("  ".join(texts).rstrip())
        if is_laid_out:
            tell(title, style="bold")
            _show_table(cells)

    @contextmanager
    def whole(self, times: Callable[[], Mapping[str, StageTime]]) -> Iterator[Self]:
        """On a terminal, show a bar above others: the share done of all stages, and the time left.

        The block gets a reporter, whose `stage` counts one of the stages. A block within another
        such block adds no bar.
        """
        if self._whole is not None or not (self._has_progress and self._has_bars):
            yield self
            return
        whole = Progress()
        with _bar(whole.shown):
            whole.estimate(times())
            yield replace(self, _whole=whole)

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Count a stage of the whole in a block."""
        whole = self._whole
        return whole.stage(name) if whole and name in whole.stages else nullcontext()

    @contextmanager
    def progress(self, description: str, total: int) -> Iterator[Callable[[int], None]]:
        """Show the share done of `total` items, by a bar, or by lines now and then.

        The block gets a function that takes the number of items done since its last call.
        """
        if not self._has_progress:
            yield lambda done: None
            return
        report = replace(self, _is_brief=False)
        has_bar = self._has_bars
        level = Level.DETAIL if has_bar else Level.INFO
        start = time.monotonic()
        lines = _progress_lines(description, total)
        next(lines)
        done = 0
        whole = self._whole

        def shown() -> tuple[str, float, str]:
            text = shortened(description, shutil.get_terminal_size().columns // 2 - 5)
            counted = f"  {done:>{len(str(total))}} of {total}" * (total > 1)
            share = min(done / max(1, total), MOST_SHOWN)
            return text + counted, share, f"{100.0 * share:3.0f} %"

        def advance(more: int) -> None:
            nonlocal done
            done += more
            if whole is not None:
                whole.add(description, more / total)
            if line := lines.send(done):
                report._tell(line, level)

        with _bar(shown) if has_bar else nullcontext():
            if whole is not None:
                whole.begin(description, total)
            yield advance
        seconds = time.monotonic() - start
        if seconds < LINE_INTERVAL:
            level = min(level, self._level)  # no line for details that are quickly done
        report._tell(f"{description}: {done} of {total} in {duration(seconds)}", level)


_warn = partial(tell, error=True, style="yellow")
SilentReporter = partial(Reporter, write=lambda text: None)
"""A reporter that shows nothing."""


def _progress_lines(description: str, total: int) -> Generator[str, int, None]:
    """Take numbers of items done, one after another; yield a line at growing intervals, or ""."""
    interval = LINE_INTERVAL
    due = time.monotonic() + interval
    first = done = yield ""
    since = time.monotonic()  # the rate leaves out the first items, which may include compiling
    while True:
        line = ""
        now = time.monotonic()
        if now >= due and 0 < done < total:
            interval = min(2.0 * interval, LONGEST_INTERVAL)
            due = now + interval
            line = f"{description}: {100 * done // total} %"
            if done > first:
                item = (now - since) / (done - first)
                line += f", {duration(max(LEAST_LEFT, item * (total - done)))} left"
        done = yield line
