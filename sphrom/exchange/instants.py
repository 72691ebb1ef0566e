"""Snapshots of files at the instants that a case keeps: as they are, or interpolated in time.

Where files hold no snapshot at an instant, each particle's position, velocity and density are
interpolated by a polynomial in time through the nearest four, so that particles have to be the same
ones, in the same order, in all files.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.foreign_files import Source, read_foreign, snapshots_in
from sphrom.exchange.import_options import ImportOptions
from sphrom.sph.domain import Domain
from sphrom.sph.time_loop import Snapshot, TimeSteps
from sphrom.text import counted, shortened

TIME_TOLERANCE = 1e-2
"""How far snapshots may be from the instants to be taken for them, over the time between two."""
ROUNDING = 1e-9
"""The same where some instants have no snapshot, and others are interpolated."""
N_NODES = 4
"""Snapshots that one instant is interpolated from: cubic polynomials."""
FARTHEST = 2.0
"""How far a particle may move between two snapshots, over what the largest speed carries it."""
Choice = tuple[float, list[Source]]
"""An instant [s], and the one snapshot that is taken for it, or those to interpolate between."""


def find_sources(files: Sequence[Path], about: ImportOptions) -> list[Source]:
    """Return the snapshots in files by time [s] after the start, those before it left out.

    Raises CaseError when the files do not tell their times, and --time-step does not either, or
    hold no two snapshots from the start on; ArtifactError when one can't be read, or two are of one
    time.
    """
    found = [source for path in sorted(files, key=_natural) for source in snapshots_in(path)]
    if about.time_step is not None:
        found = [replace(s, time=index * about.time_step) for index, s in enumerate(found)]
    found = [replace(source, time=_time_of(source, about)) for source in found]
    found.sort(key=lambda source: source.time)
    for source, later in pairwise(found):
        if source.time == later.time:
            raise ArtifactError(f"{later.path}: is of the same time as {source.path}")
    scale, rounding = about.scales["time"], 1e-9 * abs(found[-1].time)
    sources = [
        replace(source, time=scale * time if abs(time) > rounding else 0.0)
        for source in found
        if (time := source.time - about.start) >= -rounding
    ]
    if len(sources) < 2:
        raise CaseError(f"--start: leaves {counted(len(sources), 'snapshot')}; name more files")
    if sources[0].time > TIME_TOLERANCE * interval(sources):
        start = float(f"{about.start + sources[0].time / scale:.12g}")
        raise CaseError(
            f"--start: the files hold {series(sources)}, and the case begins at 0 s: "
            f"--start {start!r} makes it begin with them"
        )
    return sources


def _time_of(source: Source, about: ImportOptions) -> float:
    if not math.isnan(source.time):
        return source.time
    time = read_foreign(source, about.array).time
    if math.isnan(time):
        raise CaseError(f"--time-step: is needed: {source.path} does not tell its time")
    return time


def _natural(path: Path) -> list[Any]:
    """Sort `a_2` before `a_10`."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", str(path))]


def interval(sources: Sequence[Source]) -> float:
    """Return the mean time from snapshot to snapshot [s], of which some may be missing.

    The last one doesn't count where there are more than two: many programs write it at the end.
    """
    apart = np.diff([source.time for source in sources[: max(2, len(sources) - 1)]])
    return float(apart.sum() / np.rint(apart / np.median(apart)).sum())


def series(sources: Sequence[Source]) -> str:
    """Return the times of snapshots in words."""
    times = ", ".join(f"{source.time:.6g}" for source in sources)
    return f"{counted(len(sources), 'snapshot')}, at t = {shortened(times, 60)} s"


def choose(sources: Sequence[Source], steps: TimeSteps, about: ImportOptions) -> list[Choice]:
    """Return the snapshots for each instant that a case keeps.

    Raises CaseError where the files end before the case, or hold less than half as many snapshots
    as it keeps: the units of their times may be others.
    """
    apart = steps.snapshot_interval
    instants = [apart * index for index in range(steps.n_snapshots)]
    times = np.array([source.time for source in sources])
    nearest = [sources[int(np.argmin(np.abs(times - instant)))] for instant in instants]
    gaps = [abs(source.time - time) for source, time in zip(nearest, instants, strict=True)]
    slack = TIME_TOLERANCE * apart
    tolerance = slack if max(gaps) <= slack else ROUNDING * apart
    choices: list[Choice] = []
    for instant, source, gap in zip(instants, nearest, gaps, strict=True):
        after = bisect_left(times, instant)
        first = min(max(0, after - N_NODES // 2), max(0, len(times) - N_NODES))
        around = instant, [*sources[first : first + N_NODES]]
        choices.append((source.time, [source]) if gap <= tolerance else around)
    n_within = int((times <= instants[-1] + slack).sum())
    if times[-1] < instants[-1] - slack or 2 * n_within <= len(instants):
        raise CaseError(
            f"the files hold {series(sources)}; the case keeps {len(instants)}, every {apart:g} s "
            f"until {instants[-1]:g} s; --units time, --time-step or --start may be others, or "
            "--write-case FILE writes a case that fits them"
            + about.fitting("time", instants[-1] / times[-1])
        )
    return choices


def interpolated(
    near: Sequence[tuple[float, Snapshot]], time: float, domain: Domain, spacing: float
) -> Snapshot:
    """Return the snapshot of an instant [s], by the polynomial through those of other times.

    A single one is returned as it is.

    Raises CaseError where particles move farther than their speeds carry them and `spacing` [m],
    or out of the fluid.
    """
    if len(near) == 1:
        return near[0][1]
    nodes = np.array([node for node, _ in near])
    weights = [
        np.prod([(time - other) / (node - other) for other in nodes if other != node])
        for node in nodes
    ]
    nearest = int(np.argmax(weights))
    base = near[nearest][1].position
    fastest = max(float(np.hypot(*snapshot.velocity).max()) for _, snapshot in near)
    length, periodic = (np.array(each)[:, None] for each in (domain.lengths, domain.periodic))
    moved, velocity, fluctuation = np.zeros_like(base), np.zeros_like(base), np.zeros(base.shape[1])
    for (node, snapshot), weight in zip(near, weights, strict=True):
        offset = snapshot.position - base
        offset -= np.where(periodic, length * np.round(offset / length), 0.0)  # the shortest way
        farthest, seconds = float(np.hypot(*offset).max()), abs(node - nodes[nearest])
        if farthest > FARTHEST * fastest * seconds + spacing:
            raise CaseError(
                f"--sort-by: a particle moves by {farthest:.4g} m within {seconds:.4g} s, faster "
                "than any is: its order differs between files; name the field with its number"
            )
        moved += weight * offset
        velocity += weight * snapshot.velocity
        fluctuation += weight * snapshot.density_fluctuation
    position = domain.wrap((base + moved).T)
    if outside := int(np.sum(~domain.contains(position))):
        raise CaseError(
            f"at t = {time:.6g} s interpolation between files {np.diff(nodes).max():.3g} s apart "
            f"takes {counted(outside, 'particle')} out of the scene: it needs files closer in time "
            "or a case with the times of the files (--write-case)"
        )
    return Snapshot(np.ascontiguousarray(position.T), fluctuation, velocity)
