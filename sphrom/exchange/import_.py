"""Command `import`: snapshots of another program become the full run of a case.

From the trajectory that it writes, `map` and all that follows go on as from one of `fom`. The
case describes the simulation, the options describe the files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from sphrom.case.points import ParameterPoint
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.converter import Converter
from sphrom.exchange.instants import (
    Source,
    at_instants,
    choose,
    find_sources,
    series,
    snapshots_of,
)
from sphrom.exchange.meaning import Meaning
from sphrom.offline.fom import ensure_packed
from sphrom.setup import assembly, particles
from sphrom.setup.context import StageContext
from sphrom.setup.cost import require_room
from sphrom.setup.particles import MeasuredFields
from sphrom.store.trajectory import TrajectoryWriter
from sphrom.store.workspace import Target, Workspace

STAGE = "import"
"""The stage of an imported run in its artifact."""


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
    workspace, case = Workspace(context), context.case
    point = _only_point(context)
    if case.time.spin_up > 0.0:
        raise CaseError(
            "time.spin_up: must be 0, as an imported run is recorded from its start: "
            "--set time.spin_up=0; --start leaves earlier snapshots out"
        )
    target = replace(workspace.full_run(point), stage=STAGE, made_by="sphrom import CASE FILES")
    found = find_sources(files, meaning)
    sources = choose(found, case)
    if not workspace.must_make(target):
        _require_same_files(workspace, target, sources)
        return
    require_room(case, workspace.out, (point,))
    converter = Converter(case, meaning, sources[0].read(meaning))
    ensure_packed(workspace)
    _write(workspace, target, point, sources, converter, meaning)
    report, plan = context.report, case.plan.steps
    if converter.left_out is not None:
        report.warn(converter.left_out)
    if at_instants(sources, plan) is None:
        report.warn(f"interpolated in time, by cubic polynomials: the files hold {series(sources)}")
    elif len(sources) < len(found):
        report.info(f"{len(sources)} of {len(found)} snapshots are of the instants that are kept")
    report.info(
        f"{point.label}: {plan.n_snapshots} snapshots of {converter.n_particles} particles; the "
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
            forces=(
                particles.wall_forces(case, point, particles.functional(case, point))
                if case.scene.measured_walls
                else None
            ),
            fields=MeasuredFields.of(case),
        )
        snapshots = snapshots_of(case, sources, lambda source: converter(source.read(meaning)))
        for index, (time, snapshot) in enumerate(snapshots):
            writer.append(time, index * plan.every, snapshot)
            advance(1)
        writer.finish(None, meaning.seconds)


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
