"""The instants that a case keeps, from the snapshots of files: at them, or between them.

Where files hold no snapshot at such an instant, each particle's position, velocity and density are
interpolated by a polynomial in time through the nearest four, so that particles have to be the same
ones, in the same order, in all files.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphrom.case.fields import LARGEST
from sphrom.case.loader import given_keys, load_case
from sphrom.case.models import Case
from sphrom.case.yaml_reader import dump_yaml
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.converter import fitting_resolution
from sphrom.exchange.foreign_files import ForeignSnapshot, Stored, read_foreign, snapshots_in
from sphrom.exchange.meaning import Meaning
from sphrom.sph import fluid
from sphrom.sph.domain import Domain
from sphrom.sph.time_loop import Snapshot, TimeSteps

Array = NDArray[np.float64]

TIME_TOLERANCE = 1e-2
"""How far snapshots may be from the case's instants, over the time between two."""
N_NODES = 4
"""Snapshots that one instant is interpolated from: cubic polynomials."""
FARTHEST = 2.0
"""How far a particle may move between two snapshots, over what the largest speed carries it."""


@dataclass(frozen=True)
class Source:
    """A snapshot in a file, and its time [s] in the case."""

    path: Path
    time: float
    step: int = 0

    def read(self, meaning: Meaning) -> ForeignSnapshot:
        """Read it. Raises ArtifactError."""
        return read_foreign(self.path, meaning.array, self.step)


def find_sources(files: Sequence[Path], meaning: Meaning) -> list[Source]:
    """Return the snapshots in files in the order of their times, those before the start left out.

    Raises
    ------
    CaseError
        When the files do not tell their times, and --time-step does not either, when a time is
        beyond all numbers of a case, or the first of several is later than the case begins.
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
    scale = meaning.scales["time"]
    earliest = meaning.start - 1e-9 * abs(timed[-1][0]) if timed else 0.0
    sources = [
        Source(stored.path, (time - meaning.start) * scale, stored.step)
        for time, stored in timed
        if time >= earliest
    ]
    if sources and not sources[-1].time <= LARGEST:
        raise CaseError(
            f"{sources[-1].path}: {sources[-1].time:g} s after the start, beyond {LARGEST:g} s: "
            "check --units and --start"
        )
    if len(sources) > 1 and sources[0].time > TIME_TOLERANCE * interval(sources):
        start = float(f"{meaning.start + sources[0].time / scale:.12g}")
        raise CaseError(
            f"--start: the files hold {series(sources)}, and the case begins at 0 s: "
            f"--start {start!r} makes it begin with them"
        )
    return sources


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


def interval(sources: Sequence[Source]) -> float:
    """Return the mean time from snapshot to snapshot [s], to twelve digits."""
    return float(f"{(sources[-1].time - sources[0].time) / (len(sources) - 1):.12g}")


def series(sources: Sequence[Source]) -> str:
    """Return the times of snapshots in words."""
    if len(sources) < 2:
        return f"{len(sources)} snapshot" + ("s" if len(sources) == 0 else "")
    times = np.array([source.time for source in sources])
    gaps = np.diff(times)
    apart = f"{interval(sources):.6g} s"
    even = np.linspace(times[0], times[-1], len(times))
    if np.abs(even - times).max() > TIME_TOLERANCE * interval(sources):
        apart = f"{gaps.min():.6g} to {gaps.max():.6g} s"
    return f"{len(times)} snapshots from t = {times[0]:.6g} s to {times[-1]:.6g} s, {apart} apart"


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


def choose(found: Sequence[Source], case: Case) -> list[Source]:
    """Return the snapshots at the instants of a case, or all to interpolate between.

    Raises CaseError where the files end before the case, or hold less than half as many snapshots
    as it keeps: the units of their times may be others.
    """
    steps = case.plan.steps
    if (chosen := at_instants(found, steps)) is not None:
        return chosen
    asked = instants(steps)
    slack = 1e-6 * steps.snapshot_interval
    n_within = sum(source.time <= asked[-1] + slack for source in found)
    if 2 * n_within > len(asked) and found[-1].time >= asked[-1] - slack:
        return list(found)
    kept = series([Source(Path(), time) for time in asked])
    said = f"time, snapshots: the files hold {series(found)}; the case keeps {kept}"
    if len(found) < 2:
        raise CaseError(f"{said}; name more files")
    keys = " ".join(f"--set {key}" for key in fitting_keys(case, found))
    raise CaseError(f"{said}: --write-case FILE writes a case that fits them, as do {keys}")


def fitting_keys(case: Case, sources: Sequence[Source]) -> list[str]:
    """Return `key=value` of those keys with which a case keeps as many instants as there are.

    The time step is a whole part of the time between two, as stable as the case asks for.
    """
    apart = interval(sources)
    share = case.time.courant_number / fluid.COURANT_LIMIT
    limit = share * case.plan.limits.least
    every = max(1, math.ceil(apart / limit))
    return [
        f"time.final_time={float(f'{apart * (len(sources) - 1):.12g}')!r}",
        f"time.step={float(f'{apart / every:.12g}')!r}",
        f"snapshots.every={every}",
    ]


def fitting_text(
    source: Path, overrides: Sequence[str], files: Sequence[Path], meaning: Meaning
) -> tuple[str, list[str]]:
    """Return a case file that says what another one does, but for keys that don't fit the files.

    These are the times and, where another number of particles is found, the resolution; they come
    back as `key=value`.

    Raises
    ------
    CaseError
        When the case is not valid, or the files hold fewer than two snapshots.
    ArtifactError
        When a file can't be read.
    """
    found = find_sources(files, meaning)
    if len(found) < 2:
        raise CaseError(f"--write-case: the files hold {series(found)}; name two or more")
    case, keys = load_case(source, overrides), list[str]()
    resolution = fitting_resolution(case, found[0].read(meaning).n_particles)
    if resolution is not None:
        keys.append(f"discretization.resolution={resolution}")
    if case.time.spin_up > 0.0:
        keys.append("time.spin_up=0")
    keys += fitting_keys(load_case(source, [*overrides, *keys]), found)
    text = dump_yaml(given_keys(source, [*overrides, *keys]))
    return f"# {source.name}, fitted to {files[0].name} and others.\n{text}", keys


def snapshots_of(
    case: Case, sources: Sequence[Source], convert: Callable[[Source], Snapshot]
) -> Iterator[tuple[float, Snapshot]]:
    """Yield time and fields at the instants that a case keeps, of sources that were chosen for it.

    Raises CaseError where particles jump, so that they can't be the same in all files.
    """
    steps = case.plan.steps
    if at_instants(sources, steps) is not None:
        yield from ((source.time, convert(source)) for source in sources)
        return
    times = [source.time for source in sources]
    read = lru_cache(maxsize=2 * N_NODES)(lambda index: convert(sources[index]))
    domain = case.scene.domain
    for time in instants(steps):
        after = bisect_left(times, time)
        exact = [
            i
            for i in (after - 1, after)
            if 0 <= i < len(times) and abs(times[i] - time) <= 1e-9 * steps.snapshot_interval
        ]
        if exact:
            yield time, read(exact[0])
            continue
        first = min(max(0, after - N_NODES // 2), max(0, len(times) - N_NODES))
        nodes = range(first, min(len(times), first + N_NODES))
        near = [(times[node], read(node)) for node in nodes]
        yield time, interpolated(near, time, domain, case.plan.particle_spacing)


def interpolated(
    near: Sequence[tuple[float, Snapshot]], time: float, domain: Domain, spacing: float
) -> Snapshot:
    """Return the snapshot of an instant [s], by the polynomial through those of other times.

    Raises CaseError where particles move farther than their speeds carry them and `spacing` [m].
    """
    nodes = np.array([node for node, _ in near])
    weights = [
        np.prod([(time - other) / (node - other) for other in nodes if other != node])
        for node in nodes
    ]
    nearest = int(np.argmax(weights))
    base = near[nearest][1].position
    fastest = max(float(np.hypot(*snapshot.velocity).max()) for _, snapshot in near)
    moved = np.zeros_like(base)
    for (node, snapshot), weight in zip(near, weights, strict=True):
        offset = _offset(domain, snapshot.position, base)
        farthest, seconds = float(np.hypot(*offset).max()), abs(node - nodes[nearest])
        if farthest > FARTHEST * fastest * seconds + spacing:
            raise CaseError(
                f"--sort-by: a particle moves by {farthest:.4g} m within {seconds:.4g} s, and none "
                f"is faster than {fastest:.4g} m/s: the files have their particles in different "
                "orders; --sort-by names the field that numbers them"
            )
        moved += weight * offset
    parts = [(weight, snapshot) for weight, (_, snapshot) in zip(weights, near, strict=True)]
    return Snapshot(
        np.ascontiguousarray(domain.wrap((base + moved).T).T),
        np.asarray(sum(weight * snapshot.density_fluctuation for weight, snapshot in parts)),
        np.asarray(sum(weight * snapshot.velocity for weight, snapshot in parts)),
    )


def _offset(domain: Domain, position: Array, base: Array) -> Array:
    """Return the way from `base` to `position` (2, n_particles) [m], the shortest one."""
    offset = position - base
    for axis, (length, periodic) in enumerate(zip(domain.lengths, domain.periodic, strict=True)):
        if periodic:
            offset[axis] -= length * np.round(offset[axis] / length)
    return offset
