"""Which snapshots of files stand for the instants that a case keeps."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from sphrom.artifacts.foreign_files import Stored, read_foreign, snapshots_in
from sphrom.case.fields import LARGEST
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.meaning import Meaning
from sphrom.sph.time_loop import TimeSteps

TIME_TOLERANCE = 1e-2
"""How far snapshots may be from the case's instants, over the time between two."""


@dataclass(frozen=True)
class Source:
    """A snapshot in a file, and its time [s] in the case."""

    path: Path
    time: float
    step: int = 0


def find_sources(files: Sequence[Path], meaning: Meaning) -> list[Source]:
    """Return the snapshots in files in the order of their times, those before the start left out.

    Raises
    ------
    CaseError
        When the files do not tell their times, and --time-step does not either, or a time is
        beyond all numbers of a case.
    ArtifactError
        When one can't be read, or two are of one time.
    """
    found = [stored for path in sorted(files, key=_natural) for stored in snapshots_in(path)]
    if meaning.time_step is not None:
        times = [index * meaning.time_step for index in range(len(found))]
    else:
        times = [_time_of(stored, meaning) for stored in found]
    timed = sorted(zip(times, found, strict=True), key=lambda pair: pair[0])
    for (time, stored), (later, other) in pairwise(timed):
        if time == later:
            raise ArtifactError(f"{other.path}: is of the same time, {time:g}, as {stored.path}")
    scale = meaning.scale("time")
    earliest = meaning.start - 1e-9 * abs(timed[-1][0]) if timed else 0.0
    sources = [
        Source(stored.path, (time - meaning.start) * scale, stored.step)
        for time, stored in timed
        if time >= earliest
    ]
    for source in sources[-1:]:
        if not source.time <= LARGEST:
            raise CaseError(
                f"{source.path}: {source.time:g} s after the start, beyond {LARGEST:g} s: check "
                "--time-unit and --start"
            )
    return sources


def require_start(sources: Sequence[Source], meaning: Meaning) -> None:
    """Raise CaseError when the first snapshot is later than the case begins, if there are two."""
    times = [source.time for source in sources]
    if len(times) > 1 and times[0] > TIME_TOLERANCE * interval(times):
        start = float(f"{meaning.start + times[0] / meaning.scale('time'):.12g}")
        raise CaseError(
            f"--start: the files hold {series(times)}, and the case begins at 0 s: "
            f"--start {start!r} makes it begin with them"
        )


def _time_of(stored: Stored, meaning: Meaning) -> float:
    if stored.time is not None:
        return stored.time
    time = read_foreign(stored.path, meaning.array, stored.step).time
    if time is None:
        raise CaseError(f"--time-step: is needed: {stored.path} does not tell its time")
    return time


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort `a_2` before `a_10`."""
    parts = re.split(r"(\d+)", str(path))
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def instants(plan: TimeSteps) -> list[float]:
    """Return the times [s] at which a case keeps snapshots."""
    return [plan.snapshot_interval * index for index in range(plan.n_snapshots)]


def at_instants(sources: Sequence[Source], plan: TimeSteps) -> list[Source] | None:
    """Return the snapshot nearest to each instant of a case; None where one has none near it."""
    if not sources:
        return None
    times = np.array([source.time for source in sources])
    nearest = [int(np.argmin(np.abs(times - instant))) for instant in instants(plan)]
    apart = np.abs(times[nearest] - instants(plan))
    if apart.max() > TIME_TOLERANCE * plan.snapshot_interval:
        return None
    return [sources[index] for index in nearest]


def is_even(times: Sequence[float]) -> bool:
    """Whether times are evenly spaced."""
    even = np.linspace(times[0], times[-1], len(times))
    return bool(np.abs(even - times).max() <= TIME_TOLERANCE * interval(times))


def interval(times: Sequence[float]) -> float:
    """Return the mean time from snapshot to snapshot [s], to twelve digits."""
    return float(f"{(times[-1] - times[0]) / (len(times) - 1):.12g}")


def series(times: Sequence[float]) -> str:
    """Return times in words."""
    if len(times) < 2:
        return f"{len(times)} snapshot" + ("s" if len(times) == 0 else "")
    if is_even(times):
        apart = f"{interval(times):.6g} s"
    else:
        gaps = np.diff(times)
        apart = f"{gaps.min():.6g} to {gaps.max():.6g} s"
    return f"{len(times)} snapshots from t = {times[0]:.6g} s to {times[-1]:.6g} s, {apart} apart"
