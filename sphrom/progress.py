"""The progress of a command: the share of all its work that is done, and the time left.

Work is measured by its estimated time. Some work is counted, item by item. The progress of other
work follows the clock, and becomes ever slower if the work takes longer than estimated. The pace is
the ratio of the time of all work so far to its estimate.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from sphrom.text import duration

MOST_SHOWN = 0.99
"""Largest share that is shown, because a display of 100 % would mean the end."""
LEAST_LEFT = 1.0
"""Smallest time left that is shown [s]."""
PRIOR = 0.01
"""Share of all work that counts as done at the estimated pace, so that the first items don't set
the pace alone."""


@dataclass
class _Clock:
    """A clock that stops during compilation, which says nothing about the time of other work."""

    lost: float = 0.0
    """Time of compilation so far [s]."""
    stopped: float | None = None
    """Start of the current compilation."""

    def now(self) -> float:
        return (time.monotonic() if self.stopped is None else self.stopped) - self.lost

    def stop(self) -> None:
        self.stopped = time.monotonic()

    def go_on(self) -> None:
        self.lost = time.monotonic() - self.now()
        self.stopped = None


clock = _Clock()


@dataclass(frozen=True)
class StageTime:
    """The estimated time of a stage [s]."""

    seconds: float
    items: Mapping[str, float] = field(default_factory=dict)
    """The time [s] of each counted part of it, by the part's description up to a comma."""
    uncounted: float = 0.0
    """The part before the first counted item, or the whole stage; its progress follows the
    clock."""
    at_once: int = 1
    """The number of items that are made at the same time."""
    is_limit: bool = False
    """Whether the stage may end much earlier."""


class Progress:
    """The share of all stages that is done, and the time left."""

    def __init__(self) -> None:
        self.stages: Mapping[str, StageTime] = {}
        self._title = "starting"
        self._stage = StageTime(0.0)
        self._total = self._done = self._end = self._uncounted = self._ahead = self._most = 0.0
        self._pace = 1.0
        self._start = self._counted_at = clock.now()

    def estimate(self, stages: Mapping[str, StageTime]) -> None:
        """Take the estimated times of all stages."""
        self.stages = stages
        self._total = sum(stage.seconds for stage in stages.values())
        self._start = self._counted_at = clock.now()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count a stage in a block. If artifacts exist and it ends early, all work becomes less."""
        n_stages = len(self.stages)
        place = f"stage {[*self.stages].index(name) + 1} of {n_stages}: " * (n_stages > 1)
        self._title = f"{place}{name}"
        self._stage = stage = self.stages[name]
        self._uncounted = stage.uncounted
        self._ahead = 0.0
        begin = self._done
        self._end = begin + stage.seconds
        start = self._counted_at = clock.now()
        yield
        by_clock = min((clock.now() - start) / self._pace, stage.seconds)
        done = max(self._done, begin + by_clock)
        self._total -= self._end - done
        self._uncounted = self._ahead = 0.0
        self._count(done - self._done)

    def begin(self, description: str, total: int) -> None:
        """Begin to count the items of a part of the stage."""
        self._ahead = self._work_of(description) / max(1, total) * self._stage.at_once

    def add(self, description: str, share: float) -> None:
        """Count a share of a part of the stage."""
        if work := share * self._work_of(description):
            before = self._uncounted
            self._uncounted = 0.0
            self._count(min(before + work, self._end - self._done))

    def _work_of(self, description: str) -> float:
        return self._stage.items.get(description.partition(",")[0], 0.0)

    def _count(self, work: float) -> None:
        if work > 0.0:
            self._most = self._reached()
            self._done += work
            self._counted_at = clock.now()
            self._pace = self._pace_at(self._reached())

    def _pace_at(self, reached: float) -> float:
        least = PRIOR * self._total
        return (clock.now() - self._start + least) / (reached + least)

    def _reached(self) -> float:
        """Return the work done, including a likely part of the item in progress."""
        most = min(self._uncounted + self._ahead, self._end - self._done)
        likely = 0.0
        if most > 0.0:
            by_clock = (clock.now() - self._counted_at) / self._pace
            likely = by_clock / (1.0 + (by_clock / most) ** 8) ** 0.125
        return max(self._most, self._done + likely)

    def shown(self) -> tuple[str, float, str]:
        """Return the text of the bar, the share done, and the time left in words."""
        if not self._total:
            return self._title, 0.0, ""
        reached = self._reached()
        share = min(reached / self._total, MOST_SHOWN)
        pace = max(self._pace, self._pace_at(reached))  # slower while work is overdue
        left = max(LEAST_LEFT, (self._total - reached) * pace)
        most = "at most " * self._stage.is_limit
        words = f"{most}{duration(math.ceil(left))} left" + " after compiling" * (
            clock.stopped is not None
        )
        return self._title, share, f"{100.0 * share:3.0f} %  {words}"
