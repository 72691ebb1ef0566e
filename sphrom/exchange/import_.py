"""Command `import`: import another program's snapshots as the full run of a case.

The trajectory is used by `map` and later stages like one from `fom`. The case describes the
simulation, and the options describe the files. Either density or pressure is read, and the other
follows from the equation of state (Eq. 2.8). If the files have no snapshot at a time of the case,
each particle's position, velocity and density are interpolated by a polynomial in time through the
nearest four. Therefore particles must be the same, in the same order, in all files.
"""

from __future__ import annotations

import hashlib
import math
import re
import shlex
from bisect import bisect_left
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from sphrom.arrays import Array
from sphrom.case.loader import given_keys, load_case
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.yaml_reader import dump_yaml
from sphrom.errors import ArtifactError, CaseError, UnstableError
from sphrom.exchange.foreign_files import (
    COMPONENTS,
    ForeignSnapshot,
    Source,
    read_foreign,
    snapshots_in,
)
from sphrom.exchange.import_options import ImportOptions, pair, place
from sphrom.models.fom import ensure_packed
from sphrom.plots.tables import format_figure
from sphrom.setup import assembly, particles
from sphrom.setup.context import StageContext
from sphrom.setup.cost import require_room
from sphrom.setup.particles import MeasuredParticles
from sphrom.sph import fluid
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import fluctuation_of
from sphrom.sph.functional import Functional
from sphrom.sph.time_loop import DENSITY_LIMIT, Clock, Snapshot, TimeSteps, march
from sphrom.store.trajectory import TrajectoryWriter
from sphrom.store.workspace import Target, Workspace
from sphrom.text import counted, shortened

TIME_TOLERANCE = 1e-2
"""Tolerance for the times of snapshots that are used unchanged, over the snapshot interval."""
SAME_TIME = 1e-9
"""The same tolerance if other snapshots are interpolated."""
N_NODES = 4
"""Number of snapshots to interpolate from, by cubic polynomials."""
FARTHEST = 2.0
"""Largest motion of a particle between two snapshots, over that at the largest speed."""
Choice = tuple[float, list[Source]]
"""A time [s] with the snapshot to use unchanged, or with those to interpolate between."""


def find_sources(files: Sequence[Path], about: ImportOptions) -> list[Source]:
    """Return the snapshots in files from the start on, ordered by time after the start [s].

    Raises CaseError when neither the files nor --time-step provide times, or fewer than two
    snapshots remain; ArtifactError when a file can't be read, or two have the same time.
    """
    listed = [source for path in sorted(files, key=_natural) for source in snapshots_in(path)]
    if about.time_step is not None:
        listed = [replace(s, time=index * about.time_step) for index, s in enumerate(listed)]
    listed = [replace(source, time=_time_of(source, about)) for source in listed]
    listed.sort(key=lambda source: source.time)
    for source, later in pairwise(listed):
        if source.time == later.time:
            raise ArtifactError(f"{later.path}: has the same time as {source.path}")
    scale, rounding = about.scales["time"], 1e-9 * abs(listed[-1].time)
    sources = [
        replace(source, time=scale * time if abs(time) > rounding else 0.0)
        for source in listed
        if (time := source.time - about.start) >= -rounding
    ]
    if len(sources) < 2:
        raise CaseError(f"--start: leaves {counted(len(sources), 'snapshot')}; name more files")
    if sources[0].time > TIME_TOLERANCE * interval(sources):
        start = float(f"{about.start + sources[0].time / scale:.12g}")
        raise CaseError(
            f"--start: the files have {series(sources)}, and the case starts at 0 s; use "
            f"--start {start!r} to start it with the files"
        )
    return sources


def _time_of(source: Source, about: ImportOptions) -> float:
    if not math.isnan(source.time):
        return source.time
    time = read_foreign(source, about.array).time
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
    apart = np.diff([source.time for source in sources[: max(2, len(sources) - 1)]])
    return float(apart.sum() / np.rint(apart / np.median(apart)).sum())


def series(sources: Sequence[Source]) -> str:
    """Describe the number and the times of snapshots."""
    times = ", ".join(f"{source.time:.6g}" for source in sources)
    return f"{counted(len(sources), 'snapshot')}, at t = {shortened(times, 60)} s"


def choose(sources: Sequence[Source], steps: TimeSteps, about: ImportOptions) -> list[Choice]:
    """Return the snapshots to use for each snapshot time of a case.

    Raises CaseError if the files end before the case, or have less than half as many snapshots.
    """
    apart = steps.snapshot_interval
    instants = [apart * index for index in range(steps.n_snapshots)]
    times = np.array([source.time for source in sources])
    nearest = [sources[int(np.argmin(np.abs(times - instant)))] for instant in instants]
    gaps = [abs(source.time - time) for source, time in zip(nearest, instants, strict=True)]
    slack = TIME_TOLERANCE * apart
    tolerance = slack if max(gaps) <= slack else SAME_TIME * apart
    choices: list[Choice] = []
    for instant, source, gap in zip(instants, nearest, gaps, strict=True):
        after = bisect_left(times, instant)
        first = min(max(0, after - N_NODES // 2), max(0, len(times) - N_NODES))
        around = instant, [*sources[first : first + N_NODES]]
        choices.append((source.time, [source]) if gap <= tolerance else around)
    n_within = int((times <= instants[-1] + slack).sum())
    if times[-1] < instants[-1] - slack or 2 * n_within <= len(instants):
        raise CaseError(
            f"the files have {series(sources)}; the case has {len(instants)}, every {apart:g} s "
            f"until {instants[-1]:g} s; check --units time, --time-step and --start, or write a "
            "fitting case with --write-case FILE" + about.fitting("time", instants[-1] / times[-1])
        )
    return choices


def interpolated(
    near: Sequence[tuple[float, Snapshot]], time: float, domain: Domain, spacing: float
) -> Snapshot:
    """Return the snapshot at a time [s], interpolated by a polynomial through `near` ones.

    A single snapshot is returned unchanged.

    Raises CaseError if particles leave the fluid, or move `spacing` [m] farther than speeds allow.
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
    moved = np.zeros_like(base)
    velocity = np.zeros_like(base)
    fluctuation = np.zeros(base.shape[1])
    for (node, snapshot), weight in zip(near, weights, strict=True):
        offset = snapshot.position - base
        offset -= np.where(periodic, length * np.round(offset / length), 0.0)  # the shortest way
        farthest = float(np.hypot(*offset).max())
        seconds = abs(node - nodes[nearest])
        if farthest > FARTHEST * fastest * seconds + spacing:
            raise CaseError(
                f"--sort-by: a particle moves by {farthest:.4g} m within {seconds:.4g} s, faster "
                "than the largest speed, so the order differs between files; name the field that "
                "numbers the particles"
            )
        moved += weight * offset
        velocity += weight * snapshot.velocity
        fluctuation += weight * snapshot.density_fluctuation
    position = domain.wrap((base + moved).T)
    if outside := int(np.sum(~domain.contains(position))):
        raise CaseError(
            f"at t = {time:.6g} s, interpolation between files {np.diff(nodes).max():.3g} s apart "
            f"moves {counted(outside, 'particle')} out of the scene; use files closer in time, or "
            "a case with the times of the files (--write-case)"
        )
    return Snapshot(np.ascontiguousarray(position.T), fluctuation, velocity)


VELOCITIES = (("u", "v"), ("velocity.x", "velocity.y"))
"""Default names of the components of velocity."""
FLUCTUATION = "density_fluctuation"
"""Name of the density less its reference value in files that this program exported."""
ROUNDING = 1e-6
"""Share of the largest speed up to which a third component of velocity counts as zero."""
FOLLOWED = 0.5
"""Time for which the case's own model follows an imported run, over that of crossing the scene."""
MODEL_OFF, PER_SPACING, START_OFF = 3.0, 240.0, 20.0
"""Limits of differences in velocity [%]: the least limit of an imported run, the limit over spacing
per length, and that of its start. A finite-volume solution of the cavity departs by 4.2 and 8.2 %
(50 and 25 spacings) and is slowed by 4.6 and 8.9 %, with a wrong lid by 28 and 23 %. At 20 spacings
it is slowed by 16 %, more than the limit of 12 %."""
LEAST_SPEED, MOST_SPEED = 0.05, 5.0
"""Speeds over that of the scene: errors of slower flows are relative to the first, and above the
second, the unit is probably wrong."""
Kept = dict[int, tuple[float, Snapshot]]
"""Snapshots with their times [s], by number."""
COUNT_TOLERANCE = 0.05
"""Relative tolerance of the number of particles: programs fill edges differently."""


def run(context: StageContext, files: Sequence[Path], about: ImportOptions) -> list[str]:
    """Write the full run at one point from files; return the points that still have none.

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
    sources = find_sources(files, about)
    choices = choose(sources, case.plan.steps, about)
    options = shlex.join([*about.words, f"--only={points[0].label}"])
    named = f"{_named(files)} {options}"
    origin = {"imported/files": named, "imported/sha256": _digest(choices, options)}
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
    converter = Converter(case, about, choices[0][1][0])
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
    plan = workspace.case.plan
    about = converter.about
    attributes = {**assembly.run_attributes(case, point, plan.steps.time_step), **origin}
    crossing, last = case.scene.length_scale / plan.max_speed, len(choices) - 1
    begin = max(0, last - max(1, int(FOLLOWED * crossing / plan.steps.snapshot_interval)))
    with workspace.create(target, attributes) as artifact:
        model = particles.functional(case, point)
        kept = Kept()
        writer = TrajectoryWriter(
            artifact,
            len(choices),
            converter.n_particles,
            plan.sound_speed,
            walls=particles.walls(case, plan.flow(point)),
            forces=particles.wall_forces(case, point, model),
            fields=MeasuredParticles.of(case, point),
        )
        read = lru_cache(maxsize=2 * N_NODES)(converter)
        with workspace.context.report.progress(f"import, {point.label}", len(choices)) as advance:
            for index, (time, nodes) in enumerate(choices):
                near = [(node.time, read(node)) for node in nodes]
                snapshot = interpolated(near, time, case.scene.domain, plan.particle_spacing)
                writer.append(time, index * plan.steps.every, snapshot)
                if index in (0, begin, begin + 1, last):
                    kept[index] = time, snapshot
                advance(1)
        if converter.largest_fluctuation == 0.0:
            raise CaseError(
                "the density always equals the reference density, so there is no pressure; name a "
                "field with --density or --pressure"
            )
        writer.finish(None, about.seconds)
        # Interpolation is too inexact for a change over one interval.
        used = all(len(choices[index][1]) == 1 for index in (begin, min(begin + 1, last)))
        early = begin + 1 if used else last
        doubts = list(_doubts(workspace, point, model, kept, begin, early))
        for doubt in doubts:
            workspace.context.report.warn(f"{point.label}: {doubt}")
        artifact.annotate("imported/doubts", "\n".join(doubts))


def _doubts(
    workspace: Workspace,
    point: ParameterPoint,
    model: Functional,
    kept: Kept,
    begin: int,
    early: int,
) -> Iterator[str]:
    """Yield reasons to doubt that an imported run belongs to the case, from some of its snapshots.

    The first snapshot is compared with the initial conditions of the scene. Then the case's own
    full model runs from snapshot `begin` to the last one. It reproduces its own runs exactly, and
    runs of other schemes within their errors. Wrong walls are clearest in the change until
    snapshot `early`, a wrong viscosity in the difference at the end.
    """
    case = workspace.case
    plan = workspace.case.plan
    report = workspace.context.report
    first = kept[0][1]
    time, state = kept[begin]
    last = max(kept)
    every = plan.steps.every
    crossing, slow = case.scene.length_scale / plan.max_speed, LEAST_SPEED * plan.max_speed

    def apart(own: Array, theirs: Array) -> tuple[float, float]:
        """Return the difference of velocities (n, 2), and its part along them [%]."""
        scale = max(np.sum(theirs**2), np.sum(own**2), len(own) * slow**2)
        along = np.sum((own - theirs) * theirs) / scale
        return 100.0 * math.sqrt(np.sum((own - theirs) ** 2) / scale), 100.0 * float(along)

    scene = plan.flow(point).initial_velocity(first.position.T)
    if (start := apart(scene, first.velocity.T)[0]) > START_OFF:
        yield (
            f"its first velocities differ by {format_figure(start, 2)} % from the initial "
            "velocities of the scene; check --origin, --start, --units and the scene"
        )
    steps = TimeSteps(plan.steps.time_step, (last - begin) * every, every, time)
    begins = np.vstack((state.position, state.density_fluctuation, state.velocity))
    to = particles.map_onto(case, case.scene.domain.fill(plan.particle_spacing))
    own = {}
    name = "the case's own full model"
    density = case.fluid.reference_density
    try:
        with report.progress(f"{name}, {point.label}", steps.n_steps) as advance:
            for step, full in march(model, begins, steps, density, Clock(), advance):
                if (index := begin + step // every) in (early, last):
                    both = model.snapshot(full), kept[index][1]
                    own[index] = apart(
                        *(to(s.position.T, s.density_fluctuation, s.velocity.T)[1] for s in both)
                    )
    except (UnstableError, ValueError) as error:
        yield f"from t = {time:.4g} s on, {name} can't follow the files: {error}"
        return
    most = max(MODEL_OFF, PER_SPACING * plan.particle_spacing / case.scene.length_scale)
    departed, seconds = own[last][0], (early - begin) * plan.steps.snapshot_interval
    added = own[early][1] * crossing / seconds
    walls = "scene.lid, " * hasattr(case.scene, "lid") or "walls, " * case.scene.domain.has_walls
    if max(departed, abs(added)) > most:
        yield (
            f"from t = {time:.4g} to {kept[last][0]:.4g} s, velocities of {name} come to differ "
            f"from the files by {format_figure(departed, 2)} %, and at first its flow becomes "
            f"{format_figure(abs(added), 2)} % {'slower' if added < 0.0 else 'faster'} per "
            f"{crossing:.3g} s; for other schemes both are within {most:.2g} %. Check {walls}the "
            "Reynolds number, the body force, --units and --zero-mean-pressure"
        )


def _named(files: Sequence[Path]) -> str:
    """Return files in the form of a command line, by a pattern if it matches the same files."""
    folder = files[0].parent
    suffix = files[0].suffix
    pattern = re.sub(r"\d+(\D*)$", r"*\1", files[0].stem) + suffix
    if len(files) > 1 and set(folder.glob(pattern)) == set(files):
        return "*".join(map(shlex.quote, f"{folder}/{pattern}".split("*")))
    return shortened(shlex.join(map(str, files)))


def _digest(choices: Sequence[Choice], options: str) -> str:
    """Return one digest of the content of all files, in order, and of the options."""
    digest = hashlib.sha256(options.encode())
    for path in dict.fromkeys(source.path for _, nodes in choices for source in nodes):
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()


def fitted_case(
    source: Path, overrides: Sequence[str], files: Sequence[Path], about: ImportOptions, into: Path
) -> tuple[str, list[str]]:
    """Return the text of a case fitted to files, and the changed keys as `key=value`.

    The times change and, if the number of particles differs, the resolution. The time step is a
    whole fraction of the time between two snapshots, as stable as the case requires. Paths in the
    case are relative to the folder `into`.

    Raises CaseError when the case is not valid, or the files have fewer than two snapshots;
    ArtifactError when a file can't be read.
    """
    sources = find_sources(files, about)
    case = load_case(source, overrides)
    keys = list[str]()
    n_foreign = read_foreign(sources[0], about.array).n_particles
    if (resolution := _fitting_resolution(case, n_foreign)) is not None:
        keys.append(f"discretization.resolution={resolution}")
    if case.time.spin_up > 0.0:
        keys.append("time.spin_up=0")
    case = load_case(source, [*overrides, *keys])
    plan = case.plan
    apart = interval(sources)
    limit = case.time.courant_number / fluid.COURANT_LIMIT * plan.limits.least
    every = max(1, math.ceil(apart / limit))
    n = int(sources[-1].time / apart + TIME_TOLERANCE)
    keys += [
        f"time.final_time={float(f'{apart * n:.12g}')!r}",
        f"time.step={float(f'{apart / every:.12g}')!r}",
        f"snapshots.every={every}",
    ]
    try:
        load_case(source, [*overrides, *keys])
    except CaseError as error:  # the user gave none of these keys
        reason = re.sub(r"^because of --set [^:]*: ", "", str(error))
        raise CaseError(f"fitted to {series(sources)}, the case is invalid: {reason}") from error
    text = dump_yaml(given_keys(source, [*overrides, *keys], into))
    return f"# {source.name}, fitted to {files[0].name} and others.\n{text}", keys


def _fitting_resolution(case: Case, n_particles: int) -> int | None:
    """Return the resolution for about so many particles; None if the case has as many already."""
    ratio = n_particles / case.plan.n_particles
    # Lagrangian bases need the exact number of particles.
    if abs(ratio - 1.0) <= (0.0 if case.basis.lagrangian else COUNT_TOLERANCE):
        return None
    return round(case.discretization.resolution * ratio**0.5)


class Converter:
    """Reads snapshots, checks them, converts them to the case's units and frame, keeps extremes."""

    def __init__(self, case: Case, about: ImportOptions, source: Source) -> None:
        self.about = about
        self._case = case
        self._first = first = read_foreign(source, about.array)
        self._position = pair("position", about.position)
        self._origin = place("origin", about.origin)
        self._scales = about.scales
        usual = next((names for names in VELOCITIES if names[0] in first.fields), VELOCITIES[0])
        self._velocity = usual if about.velocity is None else pair("velocity", about.velocity)
        self.n_particles = first.n_particles
        self.largest_speed = self.largest_fluctuation = 0.0
        if (fitting := _fitting_resolution(case, self.n_particles)) is not None:
            raise CaseError(
                f"discretization.resolution: the case has {case.plan.n_particles} particles, "
                f"{first.path} has {self.n_particles}: "
                f"--set discretization.resolution={fitting} is nearest; --write-case FILE sets it"
                + (", and basis.lagrangian needs the exact number" * case.basis.lagrangian)
            )

    def __call__(self, source: Source) -> Snapshot:
        """Return a snapshot in SI units and the scene's frame, with its particles in the box.

        Raises CaseError or ArtifactError if it does not fit the case or the first snapshot.
        """
        foreign = read_foreign(source, self.about.array)
        order = self._order(foreign)
        velocity = np.stack([foreign.field(name, "--velocity")[order] for name in self._velocity])
        velocity = velocity * self._scales["velocity"]
        self.largest_speed = max(self.largest_speed, float(np.hypot(*velocity).max()))
        self._require_flat(foreign)
        position = self._place(foreign)[order]
        scene = self._case.plan.max_speed
        largest = self.largest_speed
        is_fast = largest > MOST_SPEED * scene
        fitting = self.about.fitting("velocity", scene / largest) if is_fast else ""
        if fitting or largest > self._case.plan.sound_speed:
            raise CaseError(
                f"{foreign.path}: the largest speed is {largest:.4g} m/s, that of the scene is "
                f"about {scene:.4g} m/s (fluid.reference_speed){fitting}"
            )
        fluctuation = self._fluctuation(foreign)[order]
        return Snapshot(np.ascontiguousarray(position.T), fluctuation, velocity)

    def _order(self, foreign: ForeignSnapshot) -> NDArray[np.intp]:
        """Return the order in which particles are the same in all files."""
        if foreign.n_particles != self.n_particles:
            raise ArtifactError(
                f"{foreign.path}: has {foreign.n_particles} particles, {self._first.path} has "
                f"{self.n_particles}; particles that enter or leave can't be imported"
            )
        if self.about.sort_by is None:
            return np.arange(self.n_particles)
        both = foreign, self._first
        numbers, firsts = (each.field(self.about.sort_by, "--sort-by") for each in both)
        unique = np.unique(numbers)
        if len(unique) < self.n_particles or not np.array_equal(unique, np.sort(firsts)):
            raise ArtifactError(
                f"{foreign.path}: {self.about.sort_by} (--sort-by) must be a unique number of each "
                "particle, the same in all files"
            )
        return np.argsort(numbers)

    def _place(self, foreign: ForeignSnapshot) -> Array:
        """Return positions (n_particles, 2) [m] in the scene, checked."""
        domain = self._case.scene.domain
        columns = [foreign.field(name, "--position") for name in self._position]
        position = (np.stack(columns, axis=1) - self._origin) * self._scales["length"]
        low = position.min(axis=0)
        high = position.max(axis=0)
        spacing = self._case.plan.particle_spacing
        # The fourth neighbour is one spacing away in lattices, and nearly so if particles pair.
        apart = float(np.median(KDTree(position).query(position, 5)[0][:, 4]))
        position = domain.wrap(position)
        outside = int(np.sum(~domain.contains(position)))
        if outside or not 0.7 < apart / spacing < 1.9:
            fitting = self.about.fitting("length", spacing / (apart or spacing))
            raise CaseError(
                f"{foreign.path}: {outside} of the particles are outside the scene; all span "
                f"{low[0]:.6g} to {high[0]:.6g} m and {low[1]:.6g} to {high[1]:.6g} m, with a "
                f"spacing of {apart:.3g} m, and {spacing:.3g} m in the case; check --units, "
                f"--origin, --array and the size of the scene{fitting}"
            )
        return position

    def _require_flat(self, foreign: ForeignSnapshot) -> None:
        """Raise CaseError if points or velocities leave the plane; named components may."""
        third = _third(self._position, foreign.fields)
        depth = 0.0 if third is None else float(np.ptp(foreign.fields[third]))
        is_flat = depth * self._scales["length"] <= 0.5 * self._case.plan.particle_spacing
        if is_flat and self.about.velocity is None:
            third = _third(self._velocity, foreign.fields)
            depth = 0.0 if third is None else float(np.abs(foreign.fields[third]).max())
            is_flat = depth * self._scales["velocity"] <= ROUNDING * self.largest_speed
        if not is_flat:
            raise CaseError(
                f"{foreign.path}: is three-dimensional: {third} reaches {depth:.4g}; name the "
                "components in the plane of the flow with --position and --velocity"
            )

    def _fluctuation(self, foreign: ForeignSnapshot) -> Array:
        """Return the density less its reference value (n_particles,) [kg/m3], checked."""
        reference = self._case.fluid.reference_density
        if self.about.pressure is None:
            usual = FLUCTUATION if FLUCTUATION in foreign.fields else "rho"
            name = self.about.density or usual
            density = foreign.field(name, "--density, or use --pressure") * self._scales["density"]
            fluctuation = density - (0.0 if name == FLUCTUATION else reference)
        else:
            pressure = foreign.field(self.about.pressure, "--pressure") * self._scales["pressure"]
            if self.about.zero_mean_pressure:
                pressure = pressure - pressure.mean()
            fluctuation = fluctuation_of(pressure, self._case.plan.sound_speed)
        largest = float(np.abs(fluctuation).max()) / reference
        self.largest_fluctuation = max(self.largest_fluctuation, largest)
        if largest > DENSITY_LIMIT:
            raise CaseError(
                f"{foreign.path}: |rho - rho_0| / rho_0 is {largest:.3g}, above the limit of "
                f"{DENSITY_LIMIT:g} for a weakly compressible flow; check the density or pressure "
                "of --units, fluid.reference_density and fluid.mach_number"
            )
        return fluctuation


def _third(names: tuple[str, str], fields: Collection[str]) -> str | None:
    """Return the field of a vector's third component, given the names of two; None if missing."""
    vector = names[0].rpartition(".")[0]
    families = (COMPONENTS, ("u", "v", "w"), tuple(f"{vector}.{c}" for c in COMPONENTS))
    others = [set(family) - set(names) for family in families if set(names) <= set(family)]
    return next((name for other in others for name in other if name in fields), None)
