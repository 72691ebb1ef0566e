"""The share of a command that is done, and the time left."""

from __future__ import annotations

import re

import pytest

from sphrom import progress
from sphrom.progress import Progress, StageTime


class Machine:
    """A clock, and work that takes some times as long as its estimate."""

    def __init__(self, slowness: float) -> None:
        self.time = 0.0
        self.slowness = slowness

    def work(self, seconds: float) -> None:
        self.time += self.slowness * seconds


@pytest.fixture
def machine(monkeypatch, request):
    made = Machine(getattr(request, "param", 1.0))
    monkeypatch.setattr(progress.time, "monotonic", lambda: made.time)
    monkeypatch.setattr(progress.clock, "lost", 0.0)
    return made


def told(whole: Progress) -> tuple[float, float]:
    """Return the share done, and the time left in seconds."""
    _, share, words = whole.shown()
    number, unit = re.fullmatch(r" *\d+ %  ([\d.]+) (s|minutes) left", words).groups()
    return share, float(number) * (60.0 if unit == "minutes" else 1.0)


def whole_of(**stages: StageTime) -> Progress:
    whole = Progress()
    whole.estimate(stages)
    return whole


@pytest.mark.parametrize("machine", [0.3, 1.0, 3.0], indirect=True)
def test_the_time_left_is_true_at_any_speed_of_the_machine(machine):
    """Also if the first items come from several workers, after a time for their start."""
    sweep = StageTime(180.0, {"sweep": 160.0}, uncounted=20.0, at_once=4)
    whole = whole_of(sweep=sweep, pod=StageTime(40.0, uncounted=40.0))
    left = []
    with whole.stage("sweep"):
        whole.begin("sweep", 16)
        machine.work(20.0)
        for _ in range(4):
            machine.work(40.0)
            for _ in range(4):
                whole.add("sweep", 1 / 16)
            left.append(told(whole)[1] / (220.0 * machine.slowness - machine.time))
    assert left == pytest.approx([1.0] * 4, abs=0.15)
    with whole.stage("pod"):
        machine.work(20.0)
        share, seconds = told(whole)
        assert share == pytest.approx(200 / 220, abs=0.02)
        assert seconds == pytest.approx(20.0 * machine.slowness, rel=0.15, abs=1.0)


def test_what_nothing_counts_runs_by_the_clock_but_never_ends(machine):
    whole = whole_of(pod=StageTime(100.0, uncounted=100.0), map=StageTime(10.0))
    seen = []
    with whole.stage("pod"):
        for _ in range(30):
            seen.append(told(whole))
            machine.work(10.0)
    shares, left = zip(*seen, strict=True)
    assert list(left[:8]) == pytest.approx([110.0 - 10.0 * k for k in range(8)], rel=0.1)
    assert sorted(shares) == list(shares)
    assert shares[-1] == pytest.approx(10 / 11, abs=0.01)
    assert left[-1] == pytest.approx(30.0, rel=0.1)  # the rest is expected to be as slow
    with whole.stage("map"):
        machine.work(1000.0)
        assert told(whole)[0] < 1.0


def test_what_exists_is_no_work(machine):
    """Then less is left, at the same pace."""
    runs = StageTime(10.0, {"run": 5.0})
    whole = whole_of(fom=runs, rom=runs)
    with whole.stage("fom"):  # one of two runs exists
        machine.work(5.0)
        whole.add("run, reynolds=1", 1.0)
    assert told(whole) == (pytest.approx(1 / 3, abs=0.01), 10.0)


def test_compiling_does_not_make_the_rest_longer(machine):
    whole = whole_of(fom=StageTime(10.0, {"run": 10.0}))
    with whole.stage("fom"):
        progress.clock.stop()
        machine.work(30.0)
        assert whole.shown()[-1] == "  0 %  10 s left after compiling"
        progress.clock.go_on()
        machine.work(5.0)
        whole.add("run", 0.5)
        assert told(whole) == (0.5, 5.0)


def test_a_stage_that_may_end_early_has_a_limit(machine):
    whole = whole_of(train=StageTime(10.0, is_limit=True))
    with whole.stage("train"):
        assert whole.shown() == ("train", 0.0, "  0 %  at most 10 s left")
