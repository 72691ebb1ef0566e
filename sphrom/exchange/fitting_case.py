"""The keys of a case that fit the times of another program's snapshots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from sphrom.artifacts.foreign_files import read_foreign
from sphrom.case.loader import given_keys, load_case
from sphrom.case.models import Case
from sphrom.case.yaml_reader import dump_yaml
from sphrom.errors import CaseError
from sphrom.exchange.foreign_snapshots import fitting_resolution
from sphrom.exchange.instants import find_sources, interval, require_start, series
from sphrom.exchange.meaning import Meaning
from sphrom.sph import fluid


def fitting_keys(case: Case, times: Sequence[float]) -> list[str]:
    """Return `key=value` of those keys with which a case keeps instants like `times` [s].

    The time step is a whole part of the time between two, as stable as the case asks for.
    """
    apart = interval(times)
    share = case.time.courant_number / fluid.COURANT_LIMIT
    limit = share * min(case.plan.acoustic_limit, case.plan.viscous_limit, case.plan.force_limit)
    every = max(1, math.ceil(apart / limit))
    return [
        f"time.final_time={float(f'{apart * (len(times) - 1):.12g}')!r}",
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
    require_start(found, meaning)
    times = [source.time for source in found]
    if len(times) < 2:
        raise CaseError(f"--write-case: the files hold {series(times)}; name two or more")
    case, keys = load_case(source, overrides), list[str]()
    first = read_foreign(found[0].path, meaning.array, found[0].step)
    resolution = fitting_resolution(case, first.n_particles)
    if resolution is not None:
        keys.append(f"discretization.resolution={resolution}")
    if case.time.spin_up > 0.0:
        keys.append("time.spin_up=0")
    keys += fitting_keys(load_case(source, [*overrides, *keys]), times)
    text = dump_yaml(given_keys(source, [*overrides, *keys]))
    return f"# {source.name}, fitted to {files[0].name} and others.\n{text}", keys
