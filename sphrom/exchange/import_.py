"""Command `import`: import another program's snapshots as the full run of a case.

The trajectory is used by `map` and later stages like one from `fom`. The case describes the
simulation, and the options describe the files.
"""

from __future__ import annotations

import hashlib
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from sphrom.case.points import ParameterPoint
from sphrom.errors import ArtifactError, CaseError
from sphrom.exchange.conversion import Converter
from sphrom.exchange.doubts import Followed, doubts_about
from sphrom.exchange.import_options import ImportOptions
from sphrom.exchange.instants import N_NODES, Choice, choose, find_sources, interpolated, series
from sphrom.models.fom import ensure_packed
from sphrom.setup import assembly, particles
from sphrom.setup.context import StageContext
from sphrom.setup.cost import require_room
from sphrom.setup.particles import MeasuredParticles
from sphrom.store.trajectory import TrajectoryWriter
from sphrom.store.workspace import Target, Workspace
from sphrom.text import shortened


def run(context: StageContext, files: Sequence[Path], fields: ImportOptions) -> list[str]:
    """Write the full run at one point from files; return the points that still lack a run.

    Raises CaseError when options or the case do not fit the files, with a fitting value;
    ArtifactError when a file is missing, damaged, unsafe or lacks a field, when the number of
    particles changes, or a run of another origin exists.
    """
    workspace = Workspace(context)
    case = context.case
    points = context.chosen(case.plan.points)
    if len(points) != 1:
        labels = ", ".join(point.label for point in points)
        raise CaseError(f"--only: name the parameter value of the files, one of {labels}")
    if case.time.spin_up > 0.0:
        raise CaseError(
            "time.spin_up: must be 0, because an imported run is recorded from its start; use "
            "--set time.spin_up=0, and --start to leave out earlier snapshots"
        )
    made_by = f"sphrom import {context.words} FILES"
    target = replace(workspace.full_run(points[0]), stage="import", made_by=made_by)
    sources = find_sources(files, fields)
    choices = choose(sources, case.plan.steps, fields)
    words = shlex.join([*fields.words, f"--only={points[0].label}"])
    named = f"{_named(files)} {words}"
    origin = {"imported/files": named, "imported/sha256": _digest(choices, words)}
    there = workspace.imported(target)
    same = there.get("imported/sha256") == origin["imported/sha256"]
    if target.path.exists() and not (same or context.force):
        before = f"imported from {there['imported/files']}" if there else "computed here"
        raise ArtifactError(
            f"{target.path} exists already, {before}, and not from {named}; `--force` overwrites "
            "it, `--out` names another folder"
        )
    others = [point for point in case.plan.points if point != points[0]]
    missing = [p.label for p in others if not workspace.full_run(p).path.exists()]
    if not workspace.must_make(target):
        return missing
    read = {source for _, nodes in choices for source in nodes}
    if left_out := [source for source in sources if source not in read]:
        context.report.warn(
            f"{len(left_out)} of {len(sources)} snapshots left out, because the case has no "
            f"snapshots at their times; the last is {left_out[-1].path.name}, at "
            f"t = {left_out[-1].time:.6g} s"
        )
    require_room(case, workspace.out, points)
    converter = Converter(case, fields, choices[0][1][0])
    ensure_packed(workspace)
    _write(workspace, target, points[0], choices, converter, origin)
    if between := sum(len(nodes) > 1 for _, nodes in choices):
        context.report.warn(
            f"{between} of {len(choices)} snapshots interpolated in time, by cubic polynomials; "
            f"the files have {series(sources)}"
        )
    context.report.info(
        f"{points[0].label}: {len(choices)} snapshots of {converter.n_particles} particles, from "
        f"{len(sources)} in the files; the largest speed is {converter.largest_speed:.4g} m/s, "
        f"|rho - rho_0| / rho_0 at most {converter.largest_fluctuation:.2g}"
    )
    return missing


def _write(
    workspace: Workspace,
    target: Target,
    point: ParameterPoint,
    choices: Sequence[Choice],
    converter: Converter,
    origin: Mapping[str, str],
) -> None:
    """Write the snapshots of files as a full run at a parameter point."""
    case = workspace.case
    context = workspace.context
    plan = case.plan
    attributes = {**assembly.run_attributes(case, point, plan.steps.time_step), **origin}
    followed = Followed.of(case, [len(nodes) > 1 for _, nodes in choices])
    read = lru_cache(maxsize=2 * N_NODES)(converter)
    with workspace.create(target, attributes) as artifact:
        model = particles.functional(case, point)
        writer = TrajectoryWriter(
            artifact,
            len(choices),
            converter.n_particles,
            plan.sound_speed,
            n_dim=case.scene.domain.n_dim,
            walls=particles.walls(case, plan.flow(point)),
            forces=particles.wall_forces(case, point, model),
            fields=MeasuredParticles.of(case, point),
        )
        with context.report.progress(f"import, {point.label}", len(choices)) as advance:
            for index, (time, nodes) in enumerate(choices):
                given = [(node.time, read(node)) for node in nodes]
                snapshot = interpolated(given, time, case.scene.domain, plan.particle_spacing)
                writer.append(time, index * plan.steps.every, snapshot)
                followed.keep(index, time, snapshot)
                advance(1)
        if converter.largest_fluctuation == 0.0:
            raise CaseError(
                "the density always equals the reference density, so there is no pressure; name a "
                "field with --density or --pressure"
            )
        writer.finish(None, converter.options.seconds)
        doubts = list(doubts_about(context, point, model, followed))
        for doubt in doubts:
            context.report.warn(f"{point.label}: {doubt}")
        artifact.annotate("imported/doubts", "\n".join(doubts))


def _named(files: Sequence[Path]) -> str:
    """Return files in the form of a command line, by a pattern if it matches the same files."""
    folder = files[0].parent
    suffix = files[0].suffix
    pattern = re.sub(r"\d+(\D*)$", r"*\1", files[0].stem) + suffix
    if len(files) > 1 and set(folder.glob(pattern)) == set(files):
        return "*".join(map(shlex.quote, f"{folder}/{pattern}".split("*")))
    return shortened(shlex.join(map(str, files)))


def _digest(choices: Sequence[Choice], words: str) -> str:
    """Return one digest of the content of all files, in order, and of the options."""
    digest = hashlib.sha256(words.encode())
    for path in dict.fromkeys(source.path for _, nodes in choices for source in nodes):
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()
