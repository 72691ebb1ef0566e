"""Command `import`: snapshots of another program become the full run of a case.

From the trajectory that it writes, `map` and all that follows go on as from one of `fom`. The
case describes the simulation, the options describe the files.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from sphrom.artifacts.foreign_files import read_collection, read_foreign
from sphrom.case.models import Case
from sphrom.case.plan import step_plan
from sphrom.case.points import ParameterPoint
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.foreign_snapshots import Converter, Meaning
from sphrom.offline.fom import ensure_packed
from sphrom.setup import assembly, particles
from sphrom.setup.check import require_room
from sphrom.setup.context import StageContext
from sphrom.setup.measured_fields import MeasuredFields
from sphrom.sph.time_loop import TimeSteps
from sphrom.sph.wall_forces import WallForces
from sphrom.store.targets import Target
from sphrom.store.trajectory import TrajectoryWriter
from sphrom.store.workspace import Workspace

TIME_TOLERANCE = 1e-2
"""How far snapshots may be from the case's instants, over the time between two."""
COLLECTION = ".pvd"
STAGE = "import"
"""The stage of an imported run in its artifact."""


@dataclass(frozen=True)
class Source:
    """A file, and the time [s] of its snapshot in the case."""

    path: Path
    time: float


def run(context: StageContext, files: Sequence[Path], meaning: Meaning) -> None:
    """Write the full run at one parameter point from snapshots in files.

    Raises
    ------
    CaseError
        When options or the case do not fit what the files hold; the message says what would.
    ArtifactError
        When a file is missing, damaged, unsafe or lacks a field, particles come and go, or a run
        of another origin is there.
    """
    workspace = Workspace(context)
    point = _only_point(context)
    if context.case.time.spin_up > 0.0:
        raise CaseError(
            "time.spin_up: must be 0: an imported run is recorded from its start; --start leaves "
            "earlier snapshots out"
        )
    target = replace(workspace.full_run(point), stage=STAGE, made_by="sphrom import CASE FILES")
    sources = find_sources(files, meaning)
    if not workspace.must_make(target):
        _require_same_files(workspace, target, sources)
        return
    require_room(context.case, workspace.out, (point,))
    _check_times([source.time for source in sources], step_plan(context.case))
    converter = Converter(context.case, meaning, read_foreign(sources[0].path, meaning.array))
    ensure_packed(workspace)
    _write(workspace, target, point, sources, converter, meaning)
    context.report.info(
        f"{point.label}: {len(sources)} snapshots of {converter.n_particles} particles; the "
        f"largest speed is {converter.largest_speed:.4g} m/s, |rho - rho_0| / rho_0 at most "
        f"{converter.largest_fluctuation:.2g}"
    )


def _write(
    workspace: Workspace,
    target: Target,
    point: ParameterPoint,
    sources: Sequence[Source],
    converter: Converter,
    meaning: Meaning,
) -> None:
    """Write the snapshots of files as a full run at a parameter point."""
    case, plan = workspace.case, step_plan(workspace.case)
    names = [source.path.name for source in sources]
    attributes = {
        **assembly.run_attributes(case, point, plan.time_step),
        "imported/files": ", ".join(names if len(names) < 3 else [names[0], "...", names[-1]]),
        "imported/sha256": _digest(sources),
    }
    with (
        workspace.create(target, attributes) as artifact,
        workspace.context.report.progress(f"import, {point.label}", len(sources)) as advance,
    ):
        writer = TrajectoryWriter(
            artifact,
            len(sources),
            converter.n_particles,
            case.sound_speed,
            walls=particles.walls(case, assembly.scene(case, point)),
            forces=_wall_forces(case, point),
            fields=MeasuredFields.of(case),
        )
        for index, source in enumerate(sources):
            snapshot = converter(read_foreign(source.path, meaning.array))
            writer.append(source.time, index * plan.every, snapshot)
            advance(1)
        writer.finish(None, meaning.seconds)


def _wall_forces(case: Case, point: ParameterPoint) -> WallForces | None:
    if not case.scene.measured_walls:
        return None
    return particles.wall_forces(case, point, particles.functional(case, point))


def _require_same_files(workspace: Workspace, target: Target, sources: Sequence[Source]) -> None:
    """Raise ArtifactError when a run that is there was not imported from the same files."""
    with workspace.open(target) as artifact:
        found = artifact.attributes.get("imported/sha256")
    if found != _digest(sources):
        raise ArtifactError(
            f"{target.path} is there, and not of these files; `--force` writes over it, `--out` "
            "names another folder"
        )


def _only_point(context: StageContext) -> ParameterPoint:
    points = context.chosen(context.case.points)
    if len(points) != 1:
        known = ", ".join(point.label for point in points)
        raise CaseError(f"--only: name the one parameter value that the files belong to: {known}")
    return points[0]


def find_sources(files: Sequence[Path], meaning: Meaning) -> list[Source]:
    """Return the files in the order of their times, those before the start left out.

    Raises
    ------
    CaseError
        When the files do not tell their times, and --time-step does not either.
    ArtifactError
        When one can't be read, or two are of one time.
    """
    found: list[tuple[float | None, Path]] = []
    for path in sorted(files, key=_natural):
        if path.suffix.lower() == COLLECTION:
            found += read_collection(path)
        elif meaning.time_step is not None:
            found.append((None, path))
        else:
            found.append((read_foreign(path, meaning.array).time, path))
    if meaning.time_step is not None:
        found = [(index * meaning.time_step, path) for index, (_, path) in enumerate(found)]
    timed = [(time, path) for time, path in found if time is not None]
    if len(timed) < len(found):
        silent = next(path for time, path in found if time is None)
        raise CaseError(f"--time-step: is needed: {silent} does not tell its time")
    timed.sort(key=lambda pair: pair[0])
    for (time, path), (later, other) in pairwise(timed):
        if time == later:
            raise ArtifactError(f"{other}: is of the same time, {time:g}, as {path}")
    scale = meaning.scale("time")
    earliest = meaning.start - 1e-9 * abs(timed[-1][0]) if timed else 0.0
    return [
        Source(path, (time - meaning.start) * scale) for time, path in timed if time >= earliest
    ]


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort `a_2` before `a_10`."""
    parts = re.split(r"(\d+)", str(path))
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _check_times(times: Sequence[float], plan: TimeSteps) -> None:
    """Raise CaseError unless the snapshots are of the instants that the case keeps."""
    asked = [plan.snapshot_interval * index for index in range(plan.n_snapshots)]
    tolerance = TIME_TOLERANCE * plan.snapshot_interval
    if len(times) == len(asked) and np.allclose(times, asked, rtol=0.0, atol=tolerance):
        return
    remedy = ""
    if len(times) > 1:
        remedy = (
            f": set time.final_time={times[-1]:.6g}, and time.step and snapshots.every so that "
            f"their product is {_interval(times):.6g}"
        )
    raise CaseError(
        f"time, snapshots: the files hold {_series(times)}; the case keeps {_series(asked)}{remedy}"
    )


def _interval(times: Sequence[float]) -> float:
    return (times[-1] - times[0]) / (len(times) - 1)


def _series(times: Sequence[float]) -> str:
    if len(times) < 2:
        return f"{len(times)} snapshot" + ("s" if len(times) == 0 else "")
    return (
        f"{len(times)} snapshots from t = {times[0]:.6g} s to {times[-1]:.6g} s, "
        f"{_interval(times):.6g} s apart"
    )


def _digest(sources: Sequence[Source]) -> str:
    """Return one digest of all files' bytes, in their order."""
    digest = hashlib.sha256()
    for source in sources:
        with source.path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()
