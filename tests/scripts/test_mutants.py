"""What counts as noticing a change: a test of the changed copy that passes without the change."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from pathlib import Path
from types import ModuleType

import pytest

pytestmark = pytest.mark.slow
PROGRAM = '"""Twice."""\n\n\ndef twice(x):\n    return x + x\n'
TWICE = "from sphrom.tiny import twice\n"
CASE = "tests/test_tiny.py"
ENDLESS = """
import pathlib, subprocess
from sphrom.tiny import twice

def test_twice():
    if twice(1) != 2:
        sleeper = subprocess.Popen(["sleep", "600"])
        pathlib.Path({pid!r}).write_text(str(sleeper.pid))
        while True:
            pass
"""


@pytest.fixture
def mutants(script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script, for a program of one function."""
    mutants = script("mutants")
    monkeypatch.setattr(mutants, "ROOT", tmp_path / "program")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")
    for file, text in {"sphrom/__init__.py": "", "sphrom/tiny.py": PROGRAM}.items():
        (mutants.ROOT / file).parent.mkdir(parents=True, exist_ok=True)
        (mutants.ROOT / file).write_text(text)
    return mutants


def run(mutants: ModuleType, monkeypatch: pytest.MonkeyPatch, tests: str, *options: str) -> None:
    (mutants.ROOT / "tests").mkdir()
    (mutants.ROOT / CASE).write_text(tests)
    monkeypatch.setattr(sys, "argv", ["mutants.py", "--folder", "kept", "--seed", "1", *options])
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        mutants.main()
    finally:
        for number, handler in before.items():  # other tests of this process interrupt themselves
            signal.signal(number, handler)


@pytest.mark.parametrize(
    ("tests", "verdict", "left_out"),
    [
        (TWICE + "def test_twice(): assert twice(2) == 4", f"killed {CASE}::test_twice", ""),
        (TWICE + "TENTH = 1 / (twice(3) - 3)\ndef test(): pass", f"killed {CASE}", ""),
        (TWICE + "def test(): pass\ndef test_5(): assert twice(2) == 5", "survived", "::test_5"),
        (TWICE + "import nothing_of_this_name\ndef test(): pass", "survived", CASE),
    ],
    ids=["noticed", "noticed while loading", "one fails anyway", "never loads"],
)
def test_what_fails_without_a_change_notices_none(
    mutants, monkeypatch, capsys, tests, verdict, left_out
) -> None:
    # The first change drops a term.
    change = mutants.Finder(Path("sphrom/tiny.py"), mutants.random.Random(1)).changes[0]
    monkeypatch.setattr(mutants, "draw", lambda *_: [change])
    run(mutants, monkeypatch, tests)
    out = capsys.readouterr().out
    state, _, by = verdict.partition(" ")
    assert f"\n{state} " in out
    assert f"[{by or state}]" in out
    assert out.count("left out") == bool(left_out)
    assert f"{left_out}: it was not seen to pass without a change" in out or not left_out
    assert (mutants.ROOT / change.path).read_text() == PROGRAM


def test_a_program_that_is_loaded_from_elsewhere_ends_the_run(mutants, monkeypatch) -> None:
    hidden_by = mutants.ROOT / "sphrom/tiny/__init__.py"
    hidden_by.parent.mkdir()
    hidden_by.write_text("def twice(x):\n    return 2\n")
    with pytest.raises(SystemExit, match=r"sphrom.tiny is loaded from .*, not from the copy's"):
        run(mutants, monkeypatch, "def test(): pass")


def test_a_hang_is_noticed_and_leaves_no_process(mutants, monkeypatch, capsys, tmp_path) -> None:
    monkeypatch.setattr(mutants, "HANGS", 2)
    pid = tmp_path / "pid"
    run(mutants, monkeypatch, ENDLESS.format(pid=str(pid)), "--count", "1")
    assert f"[{CASE}::test_twice]" in capsys.readouterr().out
    status, deadline = Path("/proc", pid.read_text(), "stat"), time.monotonic() + 10.0
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        while status.read_text().split()[2] != "Z":
            assert time.monotonic() < deadline
            time.sleep(0.05)
