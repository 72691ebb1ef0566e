from __future__ import annotations

import sys
from contextlib import suppress

import pytest

from sphrom import console
from sphrom.console import LogFile, Reporter, SilentReporter


class Terminal:
    """A stream that says it is a terminal, and keeps what is written."""

    encoding = "utf-8"

    def __init__(self) -> None:
        self.text = ""

    def write(self, text: str) -> int:
        self.text += text
        return len(text)

    def flush(self) -> None: ...

    def isatty(self) -> bool:
        return True


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


def test_what_comes_from_outside_is_shown_and_never_obeyed(capsys, clock):
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
    """Its last line tells of all that is running, and is gone in the end, also of what fails."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setenv("COLUMNS", "200")
    report = Reporter()
    with report.progress("all runs", 2) as outer:
        with suppress(RuntimeError), report.progress(HOSTILE, 4) as inner:
            clock[0] = 1.0
            inner(2)
            report.info("a line between")
            clock[0] = 2.0
            inner(1)
            raise RuntimeError
        outer(2)
    erased = console._ERASE
    assert terminal.text == (
        f"{erased}all runs: 0 %{erased}all runs: 0 %; {SHOWN}: 0 %"
        f"{erased}all runs: 0 %; {SHOWN}: 50 %{erased}a line between\n"
        f"{erased}all runs: 0 %; {SHOWN}: 75 %, 1 s left{erased}"
        f"{erased}all runs: 100 %{erased}"
    )


def test_lines_of_a_terminal_have_whole_words(monkeypatch):
    """Commands stay whole, to be copied; columns of tables go on below, beside the first one."""
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setenv("COLUMNS", "20")
    console.tell("a well-known name  or `what it is`", indent=4)
    console.tell("next: `sphrom run a_case_of_a_long_name.yaml --out there`")
    Reporter().table("five words of a title", ["run", "speed", "pressure"], [["full", "1", "2"]])
    assert terminal.text.splitlines() == [
        "a well-known name", "    or `what it is`",
        "next:", "`sphrom run a_case_of_a_long_name.yaml --out there`", "five words of a", "title",
        "run   speed", "----  -----", "full      1",
        "run   pressure", "----  --------", "full         2",
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
