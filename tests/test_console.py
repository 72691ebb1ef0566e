from __future__ import annotations

import io
import os
import pty
import re
import signal
import subprocess
import sys
from contextlib import suppress

import numba
import pytest

from sphrom import console
from sphrom.console import LogFile, Reporter, SilentReporter
from sphrom.progress import StageTime


class Terminal(io.StringIO):
    """A stream that says it is a terminal, and keeps what is written."""

    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


def at_terminal(monkeypatch, columns: int, kind: str = "xterm") -> Terminal:
    """Return a terminal that is both streams."""
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", kind)
    monkeypatch.setenv("COLUMNS", str(columns))
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(console, "AUTO_REFRESH", False)
    return terminal


def drawn(terminal: Terminal) -> list[str]:
    """Draw the bars of a terminal again, and return its lines."""
    console._bars.refresh()
    return screen(terminal.getvalue())


def screen(text: str) -> list[str]:
    """Return the lines that a terminal shows of an output, whose codes may only be rich's."""
    lines = [""]
    for part in re.split(r"(\x1b\[[\d;?]*[a-zA-Z]|[\r\n])", text):
        if part == "\n":
            lines.append("")
        elif part == "\x1b[1A":
            lines.pop()
        elif part == "\x1b[2K":
            lines[-1] = ""
        elif not re.fullmatch(r"\r|\x1b\[(\?25[lh]|[\d;]*m)", part):
            assert part.isprintable()
            lines[-1] += part
    return [line.rstrip() for line in lines]


@pytest.fixture
def clock(monkeypatch):
    """Return a list whose only item is the time."""
    now = [0.0]
    monkeypatch.setattr(console.time, "monotonic", lambda: now[0])
    return now


@pytest.mark.parametrize(
    ("course", "expected"),
    [
        (
            ((5.0, 10), (10.0, 10), (12.0, 5), (30.0, 35), (50.0, 40)),
            ["fom: 20 %, 40 s left", "fom: 60 %, 20 s left", "fom: 100 of 100 in 50 s"],
        ),
        (  # of compiling, in the first ten, nothing is said
            ((40.0, 10), (50.0, 40), (80.0, 40), (90.0, 10)),
            ["fom: 10 %", "fom: 90 %, 5 s left", "fom: 100 of 100 in 90 s"],
        ),
        (  # what isn't done yet takes some time
            ((9.9, 10), (10.0, 89), (10.0, 1)),
            ["fom: 99 %, 1 s left", "fom: 100 of 100 in 10 s"],
        ),
    ],
)
def test_progress_in_lines(clock, course, expected):
    """The more seldom, the longer it takes."""
    lines = []
    with Reporter(write=lines.append).progress("fom", 100) as advance:
        for clock[0], done in course:
            advance(done)
    assert lines == expected


HOSTILE = "a\x1b[2J\x07\x7f\x9b31m\u202eb\nc\u200b \udcff [red]d[/red] :warning:"
SHOWN = r"a\x1b[2J\x07\x7f\x9b31m\u202eb\nc\u200b \udcff [red]d[/red] :warning:"


def test_what_comes_from_outside_is_shown_and_never_obeyed(capsys, clock, monkeypatch):
    monkeypatch.setitem(sys.modules, "rich.console", None)  # only terminals need it
    report = Reporter()
    report.info(HOSTILE)
    report.warn(HOSTILE)
    with report.progress(HOSTILE, 1) as advance:
        advance(1)
    report.table(HOSTILE, [HOSTILE, "b"], [["c", HOSTILE]])
    out, err = capsys.readouterr()
    line = "-" * len(SHOWN)
    assert out.splitlines() == [
        SHOWN, f"{SHOWN}: 1 of 1 in 0 µs", SHOWN, f"{SHOWN}  {'b':>{len(SHOWN)}}",
        f"{line}  {line}", f"{'c':{len(SHOWN)}}  {SHOWN}",
    ]  # fmt: skip
    assert err == f"warning: {SHOWN}\n"


def test_a_terminal_shows_it_so_too(monkeypatch, clock):
    """Bars of all that is running are below the lines, and gone in the end, also of what fails."""
    terminal = at_terminal(monkeypatch, 200)
    report = Reporter()
    with report.progress("all runs", 2) as outer:
        with suppress(RuntimeError), report.progress(HOSTILE, 4) as inner:
            inner(1)
            report.info(HOSTILE)
            report.warn("of 1 fault")
            print("of another program", file=sys.stderr)
            report.table(HOSTILE, ["run", HOSTILE], [[HOSTILE, "1"]])
            *lines, first, second = drawn(terminal)
            assert [first[-5:], second[-5:]] == ["  0 %", " 25 %"]
            raise RuntimeError
        outer(1)
        assert drawn(terminal)[-1].endswith("  50 %")
        outer(1)
        assert drawn(terminal)[-1].endswith("  99 %")
    width = len(SHOWN)
    assert screen(terminal.getvalue()) == [*lines, ""] == [
        SHOWN, "warning: of 1 fault", "of another program", SHOWN,
        f"{'run':{width}}  {SHOWN}", "─" * (2 * width + 2), f"{SHOWN}  {'1':>{width}}", "",
    ]  # fmt: skip
    assert sys.stdout is sys.stderr is terminal
    assert "\x1b[33mwarning: of 1 fault\x1b[0m" in terminal.getvalue()
    assert f"\x1b[1m{SHOWN}\x1b[0m" in terminal.getvalue()


def test_terminal_without_codes_gets_lines(monkeypatch, clock):
    terminal = at_terminal(monkeypatch, 80, "dumb")
    say_all(Reporter())
    assert "\x1b" not in terminal.getvalue()
    assert screen(terminal.getvalue()) == [
        "info", "note", "result", "warning: warning", "table", "model", "─────", "a", EVERY[-1],
        "note", "result", "warning: warning", "",
    ]  # fmt: skip


def test_an_interrupt_removes_the_bar_and_restores_the_cursor():
    code = (
        "import signal; from sphrom.console import Reporter\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "with Reporter().progress('a run', 9) as advance: advance(1); signal.raise_signal(2)"
    )
    reader, terminal = pty.openpty()
    done = subprocess.run(
        [sys.executable, "-c", code], stdout=terminal, stderr=subprocess.DEVNULL, timeout=300,
        env={**os.environ, "TERM": "xterm", "NO_COLOR": "1"},
    )  # fmt: skip
    output = os.read(reader, 4096).decode()
    os.close(reader)
    os.close(terminal)
    assert done.returncode == -signal.SIGINT
    assert "a run  1 of 9 " in output  # without colours
    assert screen(output) == [""]
    assert output.rindex("\x1b[?25h") > output.rindex("\x1b[?25l")


def test_lines_of_a_terminal_have_whole_words(monkeypatch):
    """Commands stay whole, to be copied; columns of tables go on below, beside the first one."""
    terminal = at_terminal(monkeypatch, 20)
    console.tell("a well-known name  or `what it is`", indent=4)
    console.tell("next: `sphrom run a_case_of_a_long_name.yaml --out there`")
    Reporter().table("five words of a title", ["run", "speed", "pressure"], [["full", "1", "2"]])
    Reporter().table("wide", ["run", "speed"], [["a name of five words", "1"]])
    assert screen(terminal.getvalue()) == [
        "a well-known name", "    or `what it is`",
        "next:", "`sphrom run a_case_of_a_long_name.yaml --out there`", "five words of a", "title",
        "run   speed", "───────────", "full      1",
        "run   pressure", "──────────────", "full         2",
        "wide", "run            speed", "─" * 20, "a name of          1", "five words", "",
    ]  # fmt: skip


def say_all(report) -> None:
    """Tell something of every kind, once as such and once as a detail."""
    for to in (report, report.details):
        to.info("info")
        to.note("note")
        to.result("result")
        to.warn("warning")
        to.table("table", ["model"], [["a"]])
        with to.progress("progress", 1) as advance:
            advance(1)


TABLE = ["table", "model", "-----", "a"]
EVERY = ["info", "note", "result", *TABLE, "progress: 1 of 1 in 0 µs"]


@pytest.mark.parametrize(
    ("how", "expected"),
    [
        ({}, [*EVERY, "note", "result"]),
        ({"verbose": True}, 2 * EVERY),
        ({"quiet": True}, ["result", *TABLE, "result"]),
    ],
)
def test_details_are_for_who_asks_and_the_log_has_everything(
    tmp_path, capsys, clock, how, expected
):
    log = LogFile(tmp_path / "runs" / "some.log")
    log.write("before its folder\x1b[2J")
    assert not (tmp_path / "runs").exists()
    (tmp_path / "runs").mkdir()
    say_all(Reporter(**how, log=log))
    out, err = capsys.readouterr()
    assert out.splitlines() == expected
    assert err.splitlines() == 2 * ["warning: warning"]
    text = (tmp_path / "runs" / "some.log").read_text()
    first, *lines = [line.split("  ", 1)[1] for line in text.splitlines()]
    assert first == r"before its folder\x1b[2J"
    assert lines == 2 * [*EVERY[:3], "warning: warning", *EVERY[3:]]


def test_log_that_cannot_be_written_is_told_once(tmp_path, capsys):
    log = LogFile(tmp_path)  # a folder is no file
    log.write("one")
    log.write("two")
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"warning: {tmp_path}: no log is written: ")


def test_brief_reporter_passes_on_warnings_and_progress_if_asked(capsys, clock):
    say_all(Reporter().brief(label="reynolds=100", progress=True))
    out, err = capsys.readouterr()
    assert out.splitlines() == ["progress: 1 of 1 in 0 µs"]  # a quick detail has none
    assert err.splitlines() == 2 * ["warning: reynolds=100: warning"]
    say_all(Reporter().brief())
    assert capsys.readouterr().out == ""
    say_all(SilentReporter())
    assert capsys.readouterr() == ("", "")


def test_the_stages_of_a_command_are_one_whole(monkeypatch, clock):
    """Its share only grows, also if a stage has nothing to do; items of workers count too."""
    terminal = at_terminal(monkeypatch, 200)
    times = {
        "fom": StageTime(4.0, {"full run": 2.0, "full runs": 4.0}),
        "map": StageTime(1.0),
        "rom": StageTime(5.0, {"a": 4.0}),
    }
    seen = []

    def look(report, description, total, done, seconds):
        with report.progress(description, total) as advance:
            clock[0] += seconds
            advance(done)
            first = next(line for line in drawn(terminal) if line[2:].startswith("stage"))
        seen.append(re.sub(r"\W*━.*?(\d+ %)", r" \1", first[2:]))

    with Reporter().whole(lambda: times) as report:
        assert drawn(terminal)[-1][2:].startswith("starting ")
        with report.stage("fom"):
            look(report, "full run, reynolds=1", 4, 3, 3.0)
            look(report.details, "full runs", 4, 2, 3.5)
        with report.stage("map"):  # its artifacts exist
            pass
        with report.stage("rom"), report.whole(dict) as same, same.stage("a part"):
            look(same, "b", 1, 1, 0.0)
            look(same, "a, reynolds=1", 2, 1, 4.0)
            assert "a, reynolds=1  1 of 2 " in terminal.getvalue()
    assert seen == [
        "stage 1 of 3: fom 15 %  17 s left", "stage 1 of 3: fom 35 %  12 s left",
        "stage 3 of 3: rom 41 %  10 s left", "stage 3 of 3: rom 65 %  6 s left",
    ]  # fmt: skip
    assert screen(terminal.getvalue()) == [""]


def test_a_progress_without_items_is_shown_too(monkeypatch):
    terminal = at_terminal(monkeypatch, 80)
    times = {"rom": StageTime(4.0, {"runs": 4.0})}
    with (
        Reporter().whole(lambda: times) as report,
        report.stage("rom"),
        report.progress("runs", 0),
    ):
        assert drawn(terminal)[-1].endswith("  0 %")


def test_without_a_terminal_the_whole_is_not_estimated():
    lines = []
    with Reporter(write=lines.append).whole(pytest.fail) as report, report.stage("fom"):
        report.info("fom")
    assert lines == ["fom"]


def test_a_kernel_that_is_compiled_is_shown_by_name(monkeypatch):
    terminal = at_terminal(monkeypatch, 80)
    console.show_compiling()
    with Reporter().progress("fom", 4):
        kernel = numba.njit(lambda x: x + 1)
        kernel.py_func.__name__ = "evaluate"
        kernel(1)
        assert drawn(terminal)[-1][2:].startswith("fom ")
    assert "compiling evaluate " in terminal.getvalue()
