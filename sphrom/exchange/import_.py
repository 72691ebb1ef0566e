"""Command `import`: snapshots of another program become the full run of a case.

From the trajectory that it writes, `map` and all that follows go on as from one of `fom`. The
case describes the simulation, the options describe the files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from sphrom.artifacts.foreign_files import ForeignSnapshot, read_foreign
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.fitting_case import fitting_keys
from sphrom.exchange.foreign_snapshots import Converter
from sphrom.exchange.instants import (
    Source,
    at_instants,
    find_sources,
    instants,
    is_even,
    require_start,
    series,
)
from sphrom.exchange.meaning import Meaning
from sphrom.exchange.resampling import Resampler
from sphrom.offline.fom import ensure_packed
from sphrom.setup import assembly, particles
from sphrom.setup.context import StageContext
from sphrom.setup.cost import require_room
from sphrom.setup.measured_fields import MeasuredFields
from sphrom.sph.time_loop import Snapshot, TimeSteps
from sphrom.sph.wall_forces import WallForces
from sphrom.store.targets import Target
from sphrom.store.trajectory import TrajectoryWriter
from sphrom.store.workspace import Workspace

STAGE = "import"
"""The stage of an imported run in its artifact."""


def run(
    context: StageContext, files: Sequence[Path], meaning: Meaning, resample: bool = False
) -> None:
    """Write the full run at one parameter point from snapshots in files.

    With `resample` the fields are interpolated in time at the instants that the case keeps.

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
            "time.spin_up: must be 0, as an imported run is recorded from its start: "
            "--set time.spin_up=0; --start leaves earlier snapshots out"
        )
    target = replace(workspace.full_run(point), stage=STAGE, made_by="sphrom import CASE FILES")
    found = find_sources(files, meaning)
    plan = context.case.plan.steps
    chosen = at_instants(found, plan)
    if chosen is None and not resample:
        raise CaseError(_misfit(context.case, found, meaning))
    sources = chosen or _around(found, plan, meaning)
    if not workspace.must_make(target):
        _require_same_files(workspace, target, sources)
        return
    require_room(context.case, workspace.out, (point,))
    converter = Converter(context.case, meaning, _read(sources[0], meaning))
    ensure_packed(workspace)
    _write(workspace, target, point, sources, converter, meaning)
    _tell(context, point, found, sources, converter)


def _tell(
    context: StageContext,
    point: ParameterPoint,
    found: Sequence[Source],
    sources: Sequence[Source],
    converter: Converter,
) -> None:
    """Report what was imported, and what was made of it."""
    report, plan = context.report, context.case.plan.steps
    if converter.left_out is not None:
        report.warn(converter.left_out)
    if at_instants(sources, plan) is None:
        given = series([source.time for source in sources])
        report.info(f"interpolated in time, by cubic polynomials: the files hold {given}")
    elif len(sources) < len(found):
        report.info(f"{len(sources)} of {len(found)} snapshots are of the instants that are kept")
    report.info(
        f"{point.label}: {plan.n_snapshots} snapshots of {converter.n_particles} particles; the "
        f"largest speed is {converter.largest_speed:.4g} m/s, |rho - rho_0| / rho_0 at most "
        f"{converter.largest_fluctuation:.2g}"
    )


def _misfit(case: Case, found: Sequence[Source], meaning: Meaning) -> str:
    """Return why snapshots can't be taken as they are, and what helps."""
    require_start(found, meaning)
    times, asked = [source.time for source in found], instants(case.plan.steps)
    said = f"time, snapshots: the files hold {series(times)}; the case keeps {series(asked)}"
    if len(times) < 2:
        return f"{said}; name more files"
    keys = " ".join(f"--set {key}" for key in fitting_keys(case, times))
    if not is_even(times):
        return (
            f"{said}: --resample interpolates between uneven times; with --write-case FILE, or "
            f"{keys}, the case keeps as many"
        )
    words = f"--write-case FILE writes a case that keeps them, as do {keys}"
    if asked[-1] <= times[-1]:
        words += "; --resample interpolates at the case's instants"
    return f"{said}: {words}"


def _around(found: Sequence[Source], plan: TimeSteps, meaning: Meaning) -> list[Source]:
    """Return the snapshots to interpolate from.

    Raises CaseError where the case keeps instants before the first or after the last.
    """
    require_start(found, meaning)
    asked, times = instants(plan), [source.time for source in found]
    slack = 1e-6 * plan.snapshot_interval
    if len(times) < 2 or times[-1] < asked[-1] - slack:
        raise CaseError(
            f"--resample: the files hold {series(times)}; the case keeps {series(asked)}: "
            "--write-case FILE writes a case that ends with them"
        )
    return list(found)


def _read(source: Source, meaning: Meaning) -> ForeignSnapshot:
    return read_foreign(source.path, meaning.array, source.step)


def _snapshots(
    case: Case, sources: Sequence[Source], convert: Callable[[Source], Snapshot]
) -> Iterator[tuple[float, Snapshot]]:
    """Yield time and fields at the instants that a case keeps, from files or between them."""
    plan = case.plan.steps
    if at_instants(sources, plan) is not None:
        yield from ((source.time, convert(source)) for source in sources)
        return
    times = [source.time for source in sources]
    resample = Resampler(
        times, lambda i: convert(sources[i]), case.scene.domain, case.plan.particle_spacing
    )
    yield from ((time, resample(time)) for time in instants(plan))


def _write(
    workspace: Workspace,
    target: Target,
    point: ParameterPoint,
    sources: Sequence[Source],
    converter: Converter,
    meaning: Meaning,
) -> None:
    """Write the snapshots of files as a full run at a parameter point."""
    case, plan = workspace.case, workspace.case.plan.steps
    names = list(dict.fromkeys(source.path.name for source in sources))
    attributes = {
        **assembly.run_attributes(case, point, plan.time_step),
        "imported/files": ", ".join(names if len(names) < 3 else [names[0], "...", names[-1]]),
        "imported/sha256": _digest(sources),
    }
    with (
        workspace.create(target, attributes) as artifact,
        workspace.context.report.progress(f"import, {point.label}", plan.n_snapshots) as advance,
    ):
        writer = TrajectoryWriter(
            artifact,
            plan.n_snapshots,
            converter.n_particles,
            case.plan.sound_speed,
            walls=particles.walls(case, case.plan.flow(point)),
            forces=_wall_forces(case, point),
            fields=MeasuredFields.of(case),
        )
        snapshots = _snapshots(case, sources, lambda source: converter(_read(source, meaning)))
        for index, (time, snapshot) in enumerate(snapshots):
            writer.append(time, index * plan.every, snapshot)
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
    points = context.chosen(context.case.plan.points)
    if len(points) != 1:
        known = ", ".join(point.label for point in points)
        raise CaseError(f"--only: name the one parameter value that the files belong to: {known}")
    return points[0]


def _digest(sources: Sequence[Source]) -> str:
    """Return one digest of all files' bytes, in their order."""
    digest = hashlib.sha256()
    for path in dict.fromkeys(source.path for source in sources):
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()
