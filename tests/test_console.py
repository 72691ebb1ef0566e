from __future__ import annotations

import re
import sys

import pytest

from sphrom.console import LogFile, ProgressLines, Reporter, SilentReporter, format_seconds


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
def in_terminal(monkeypatch):
    """Return a function that makes standard output a terminal, and returns it."""

    def replace() -> Terminal:
        stream = Terminal()
        monkeypatch.setattr(sys, "stdout", stream)
        monkeypatch.setenv("TERM", "xterm")
        monkeypatch.setenv("COLUMNS", "100")
        return stream

    return replace  # within the test, because pytest replaces the stream before it


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.04, "0.0 s"), (9.94, "9.9 s"), (9.96, "10 s"), (59.4, "59 s"), (59.6, "1 min 0 s"),
        (185, "3 min 5 s"), (3599.7, "1 h 0 min"), (7800, "2 h 10 min"),
    ],
)  # fmt: skip
def test_durations(seconds, text):
    assert format_seconds(seconds) == text


def progress_lines(course, total=100) -> list[tuple[str, bool]]:
    """Return the lines of a course of (time, done since), and whether it was done quickly."""
    now, lines = [0.0], []

    def write(text: str, *, quickly: bool) -> None:
        lines.append((text, quickly))

    progress = ProgressLines("fom", total, write, lambda: now[0])
    for at, done in course:
        now[0] = at
        progress.advance(done)
    progress.finish()
    return lines


def test_progress_in_lines():
    lines = progress_lines(((5.0, 10), (10.0, 10), (12.0, 5), (30.0, 35), (50.0, 40)))
    assert lines == [
        ("fom: 20 %, 40 s left", False),
        ("fom: 60 %, 20 s left", False),
        ("fom: 100 of 100 in 50 s", False),
    ]


def test_compiling_says_nothing_of_the_time_left():
    lines = progress_lines(((40.0, 10), (50.0, 40), (80.0, 40), (90.0, 10)))
    assert [text for text, _ in lines] == [
        "fom: 10 %", "fom: 90 %, 5.0 s left", "fom: 100 of 100 in 1 min 30 s",
    ]  # fmt: skip


def test_plain_lines_where_there_is_no_terminal(capsys):
    report = Reporter()
    report.info("2500 particles [kg]")
    report.warn("take care")
    with report.progress("fom", 3) as advance:
        advance(3)
    report.table("errors", ["model"], [])
    out, err = capsys.readouterr()
    assert out.splitlines() == [
        "2500 particles [kg]", "fom: 3 of 3 in 0.0 s", "errors", "model", "-----",
    ]  # fmt: skip
    assert err == "warning: take care\n"


HOSTILE = "a\x1b[2J\x07\x7f\x9b31m\u202eb\nc\u200b \udcff [red]d[/red] :warning:"
SHOWN = r"a\x1b[2J\x07\x7f\x9b31m\u202eb\nc\u200b \udcff [red]d[/red] :warning:"


def test_what_comes_from_outside_is_shown_and_never_obeyed(capsys):
    report = Reporter()
    report.info(HOSTILE)
    report.warn(HOSTILE)
    with report.progress(HOSTILE, 1) as advance:
        advance(1)
    report.table(HOSTILE, [HOSTILE, "b"], [["c", HOSTILE]])
    out, err = capsys.readouterr()
    line = "-" * len(SHOWN)
    assert out.splitlines() == [
        SHOWN, f"{SHOWN}: 1 of 1 in 0.0 s", SHOWN, f"{SHOWN}  {'b':>{len(SHOWN)}}",
        f"{line}  {line}", f"{'c':{len(SHOWN)}}  {SHOWN}",
    ]  # fmt: skip
    assert err == f"warning: {SHOWN}\n"


def test_a_terminal_shows_it_so_too(in_terminal, monkeypatch):
    terminal = in_terminal()
    monkeypatch.setenv("COLUMNS", "300")
    report = Reporter()
    with report.progress(HOSTILE, 1) as advance:
        advance(1)
        report.info(HOSTILE)
    report.table(HOSTILE, [HOSTILE, "b"], [["c", HOSTILE]])
    # Escapes of rich itself are those of colours and of the cursor.
    own = re.sub(r"\x1b\[\??[0-9;]*[mhlAK]", "", terminal.text).replace("\r", "").split("\n")
    assert "".join(own).isprintable()
    assert sum(line.count(SHOWN) for line in own) >= 5
    assert "[2J\x07" not in terminal.text


def test_quiet_leaves_warnings_and_results(capsys):
    report = Reporter(quiet=True)
    report.info("2500 particles")
    report.note("goes on from step 3")
    report.warn("take care")
    with report.progress("fom", 3) as advance:
        advance(3)
    report.table("errors", ["model"], [["a"]])
    report.details.table("more", ["model"], [["a"]])
    report.result("it is fast")
    out, err = capsys.readouterr()
    assert out.splitlines() == ["errors", "model", "-----", "a", "it is fast"]
    assert err == "warning: take care\n"


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


def test_details_are_for_who_asks(capsys):
    table = ["table", "model", "-----", "a"]
    every = ["info", "note", "result", *table, "progress: 1 of 1 in 0.0 s"]
    say_all(Reporter())
    out, err = capsys.readouterr()
    assert out.splitlines() == [*every, "note", "result"]
    assert err.count("warning: warning") == 2
    say_all(Reporter(verbose=True))
    assert capsys.readouterr().out.splitlines() == 2 * every


@pytest.mark.parametrize("how", [{"quiet": True}, {"verbose": True}])
def test_log_has_everything(tmp_path, how):
    log = LogFile(tmp_path / "runs" / "some.log")
    log.write("before its folder\x1b[2J")
    assert not (tmp_path / "runs").exists()
    (tmp_path / "runs").mkdir()
    say_all(Reporter(**how, log=log))
    text = (tmp_path / "runs" / "some.log").read_text()
    first, *lines = [line.split("  ", 1)[1] for line in text.splitlines()]
    table = ["table", "model", "-----", "a"]
    every = ["info", "note", "result", "warning: warning", *table, "progress: 1 of 1 in 0.0 s"]
    assert first == r"before its folder\x1b[2J"
    assert lines == 2 * every


def test_log_that_cannot_be_written_is_told_once(tmp_path, capsys):
    log = LogFile(tmp_path)  # a folder is no file
    log.write("one")
    log.write("two")
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"warning: {tmp_path}: no log is written: ")


def test_brief_reporter_passes_on_warnings_and_progress_if_asked(capsys):
    say_all(Reporter().brief(label="reynolds=100", progress=True))
    out, err = capsys.readouterr()
    assert out.splitlines() == ["progress: 1 of 1 in 0.0 s"]  # a quick detail has none
    assert err.splitlines() == 2 * ["warning: reynolds=100: warning"]
    say_all(Reporter().brief())
    assert capsys.readouterr().out == ""
    say_all(SilentReporter())
    assert capsys.readouterr() == ("", "")


def test_bars_on_a_terminal_may_be_nested(in_terminal):
    """The terminal is given back, also when a stage fails."""
    terminal = in_terminal()
    report = Reporter()
    with pytest.raises(RuntimeError), report.progress("fom", 3):
        raise RuntimeError
    assert sys.stdout is terminal
    with report.progress("all runs [1]", 2) as outer:
        with report.progress("reynolds=100", 10) as inner:
            inner(10)
            report.info("a line between")
        outer(2)
    for text in ("all runs [1]", "reynolds=100", "0/10", "2/2", "a line between"):
        assert text in terminal.text
    assert terminal.text.endswith("\r\x1b[1A\x1b[2K")  # the bars are gone: lines settle
    assert sys.stdout is terminal
