"""The instants of an imported run: which snapshots of files a case takes, and those between them.

If the files have no snapshot at a time of the case, each particle's position, velocity and density
are interpolated by a polynomial in time through the nearest four. Therefore particles must be the
same, in the same order, in all files.
"""

from __future__ import annotations

import math
import re
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
"""Tolerance for the times of snapshots that are used unchanged, relative to the snapshot
interval."""
SAME_TIME = 1e-9
"""The tolerance for such times if other snapshots are interpolated."""
N_NODES = 4
"""Number of snapshots to interpolate from, by cubic polynomials."""
FARTHEST = 2.0
"""Largest motion of a particle between two snapshots, relative to that at the largest speed."""
Choice = tuple[float, list[Source]]
"""A time [s] with the snapshot to use unchanged, or with those to interpolate between."""


def find_sources(files: Sequence[Path], options: ImportOptions) -> list[Source]:
    """Return the snapshots in files since the start, ordered by time after the start [s].

    Raises CaseError when neither the files nor --time-step provide times, or fewer than two
    snapshots remain; ArtifactError when a file can't be read, or two have the same time.
    """
    listed = [source for path in sorted(files, key=_natural) for source in snapshots_in(path)]
    for index, source in enumerate(listed):
        step = options.time_step
        time = _time_of(source, options) if step is None else index * step
        listed[index] = replace(source, time=time)
    listed.sort(key=lambda source: source.time)
    for source, later in pairwise(listed):
        if source.time == later.time:
            raise ArtifactError(f"{later.path}: has the same time as {source.path}")
    scale, rounding = options.scales["time"], 1e-9 * abs(listed[-1].time)
    sources = [
        replace(source, time=scale * time if abs(time) > rounding else 0.0)
        for source in listed
        if (time := source.time - options.start) >= -rounding
    ]
    if len(sources) < 2:
        raise CaseError(f"--start: leaves {counted(len(sources), 'snapshot')}; name more files")
    if sources[0].time > TIME_TOLERANCE * interval(sources):
        start = float(f"{options.start + sources[0].time / scale:.12g}")
        raise CaseError(
            f"--start: the files have {series(sources)}, and the case starts at 0 s; use "
            f"--start {start!r} to start it with the files"
        )
    return sources


def _time_of(source: Source, options: ImportOptions) -> float:
    if not math.isnan(source.time):
        return source.time
    time = read_foreign(source, options.array).time
    if math.isnan(time):
        raise CaseError(f"--time-step: is required, because {source.path} has no time")
    return time


def _natural(path: Path) -> list[Any]:
    """Return a sort key that orders `a_2` before `a_10`."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", str(path))]


def interval(sources: Sequence[Source]) -> float:
    """Return the mean time between snapshots [s], even if some are missing.

    If there are more than two, the last one is ignored: many programs write it at the final time.
    """
    gaps = np.diff([source.time for source in sources[: max(2, len(sources) - 1)]])
    return float(gaps.sum() / np.rint(gaps / np.median(gaps)).sum())


def series(sources: Sequence[Source]) -> str:
    """Describe the number and the times of snapshots."""
    times = ", ".join(f"{source.time:.6g}" for source in sources)
    return f"{counted(len(sources), 'snapshot')}, at t = {shortened(times, 60)} s"


def choose(sources: Sequence[Source], steps: TimeSteps, options: ImportOptions) -> list[Choice]:
    """Return the snapshots to use for each snapshot time of a case.

    Raises CaseError if the files end before the case, or have less than half as many snapshots.
    """
    interval = steps.snapshot_interval
    instants = interval * np.arange(steps.n_snapshots)
    times = np.array([source.time for source in sources])
    nearest = np.abs(times - instants[:, None]).argmin(axis=1)
    gaps = np.abs(times[nearest] - instants)
    slack = TIME_TOLERANCE * interval
    tolerance = slack if gaps.max() <= slack else SAME_TIME * interval
    firsts = np.searchsorted(times, instants) - N_NODES // 2
    firsts = firsts.clip(0, max(0, len(times) - N_NODES))
    choices: list[Choice] = []
    for instant, k, gap, first in zip(instants.tolist(), nearest, gaps, firsts, strict=True):
        if gap <= tolerance:
            choices.append((sources[k].time, [sources[k]]))
        else:
            choices.append((instant, [*sources[first : first + N_NODES]]))
    n_within = int((times <= instants[-1] + slack).sum())
    if times[-1] < instants[-1] - slack or 2 * n_within <= len(instants):
        fitting = options.fitting("time", instants[-1] / times[-1])
        raise CaseError(
            f"the files have {series(sources)}; the case has {len(instants)}, every {interval:g} s "
            f"until {instants[-1]:g} s; check --units time, --time-step and --start, or write a "
            f"fitting case with --write-case FILE{fitting}"
        )
    return choices


def interpolated(
    given: Sequence[tuple[float, Snapshot]], time: float, domain: Domain, spacing: float
) -> Snapshot:
    """Return the snapshot at a time [s], interpolated by a polynomial through the given ones.

    A single snapshot is returned unchanged.

    Raises CaseError if particles leave the fluid, or move `spacing` [m] farther than speeds allow.
    """
    if len(given) == 1:
        return given[0][1]
    nodes = np.array([node for node, _ in given])
    weights = [
        np.prod([(time - other) / (node - other) for other in nodes if other != node])
        for node in nodes
    ]
    nearest = int(np.argmax(weights))
    base = given[nearest][1].position
    fastest = max(float(np.hypot.reduce(snapshot.velocity, axis=0).max()) for _, snapshot in given)
    length = np.array(domain.lengths)[:, None]
    periodic = np.array(domain.periodic)[:, None]
    n_dim = len(base)
    total = np.zeros((2 * n_dim + 1, base.shape[1]))
    for (node, snapshot), weight in zip(given, weights, strict=True):
        offset = snapshot.position - base
        offset -= np.where(periodic, length * np.round(offset / length), 0.0)  # the shortest way
        farthest = float(np.hypot.reduce(offset, axis=0).max())
        seconds = abs(node - nodes[nearest])
        if farthest > FARTHEST * fastest * seconds + spacing:
            raise CaseError(
                f"--sort-by: a particle moves by {farthest:.4g} m within {seconds:.4g} s, faster "
                "than the largest speed, so the order differs between files; name the field that "
                "numbers the particles"
            )
        total += weight * np.vstack((offset, snapshot.velocity, snapshot.density_fluctuation))
    moved, velocity, fluctuation = np.split(total, (n_dim, 2 * n_dim))
    position = domain.wrap((base + moved).T)
    if outside := int(np.sum(~domain.contains(position))):
        raise CaseError(
            f"at t = {time:.6g} s, interpolation between files {np.diff(nodes).max():.3g} s apart "
            f"moves {counted(outside, 'particle')} out of the scene; use files closer in time, or "
            "a case with the times of the files (--write-case)"
        )
    return Snapshot(np.ascontiguousarray(position.T), fluctuation[0], velocity)
