from __future__ import annotations

import os
import signal
import sys
import time
import weakref
from contextlib import ExitStack

import pytest

from sphrom.signals import (
    Terminated,
    interrupts_come_again,
    termination_interrupts,
)


class Thing:
    """What a weak reference can point to."""


@pytest.mark.parametrize("kind", [KeyboardInterrupt, Terminated])
def test_an_interrupt_is_lost_at_no_moment(monkeypatch, capsys, kind):
    """It comes again at once, and so also while the one before is still dealt with."""
    monkeypatch.setattr("sphrom.signals.MOMENT", 0.0)

    def interrupt(reference):
        raise kind

    def work():
        things = [Thing(), Thing(), Thing()]
        references = [weakref.ref(thing, interrupt) for thing in things]
        things.clear()
        deadline = time.monotonic() + 5.0
        while time.monotonic() < deadline:
            assert references[0]() is None
            time.sleep(0.001)

    before = sys.unraisablehook
    for _ in range(50):
        with termination_interrupts(), pytest.raises(kind), interrupts_come_again():
            work()
    assert sys.unraisablehook is before
    assert capsys.readouterr().err == ""


def test_a_second_termination_does_not_disturb_the_clean_up() -> None:
    cleaned: list[bool] = []

    def clean() -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.001)
        cleaned.append(True)

    def work() -> None:
        with ExitStack() as stack:
            stack.callback(clean)
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(10.0)

    for _ in range(2):
        with pytest.raises(Terminated), termination_interrupts(), interrupts_come_again():
            work()
    assert cleaned == [True, True]


def test_other_exceptions_are_told_as_before(monkeypatch):
    told = []
    monkeypatch.setattr(sys, "unraisablehook", lambda lost: told.append(lost.exc_type))

    def fail(reference):
        raise ZeroDivisionError

    thing = Thing()
    reference = weakref.ref(thing, fail)
    with interrupts_come_again():
        del thing
    assert reference() is None
    assert told == [ZeroDivisionError]


@pytest.mark.parametrize(
    ("number", "code", "asked", "told"),
    [
        (2, 130, "fom C", "finished artifacts and checkpoints are kept: `C --resume` continues"),
        (15, 143, "run C --out o", "finished artifacts and checkpoints are kept: `C --resume`"),
        (2, 130, "trade C --force", "finished runs are kept: `C` continues"),
        (2, 130, "fit C m.csv", "complete files are kept: `C` starts again"),
        (2, 130, "export C", "complete files are kept: `C --force` starts again"),
    ],
)
def test_a_stopped_command_says_how_to_go_on(
    sphrom, case_file, monkeypatch, number, code, asked, told
):
    def work(*_, **__):
        os.kill(os.getpid(), number)
        time.sleep(10.0)

    before = signal.getsignal(signal.SIGTERM)
    words = ["sphrom", *asked.replace("C", str(case_file)).split()]
    monkeypatch.setattr("sphrom.stages.run_stage", work)
    monkeypatch.setattr(sys, "argv", words)
    result = sphrom(*words[1:], code=code)
    told = told.replace("C", " ".join(words).replace(" --force", ""))
    assert result.stderr.startswith(f"{'interrupted' if number == 2 else 'terminated'}; {told}")
    assert signal.getsignal(signal.SIGTERM) is before


def test_where_interrupts_are_ignored_the_program_tells_what_stops_it(sphrom, stages, case_file):
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        result = sphrom("pod", case_file)
    finally:
        signal.signal(signal.SIGINT, before)
    assert (result.exit_code, result.stdout.count("stop this command with SIGTERM")) == (0, 1)
    assert "SIGINT" not in sphrom("pod", case_file).stdout
