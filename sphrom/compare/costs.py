"""The cost of stages, of full and reduced runs, and of making a reduced model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from sphrom.artifacts import Artifact, open_artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.metrics.histories import compression_factor, field_compression_factor
from sphrom.store.trained_models import memory_timing
from sphrom.store.workspace import Target, Workspace

SECONDS = {"unit": "s"}


@dataclass(frozen=True)
class RunTiming:
    """One reduced run against the full one, both as they ran, undisturbed by other programs.

    That is all steps at the least time of a step, means of ten in a row, or for a run of
    milliseconds the least of several. None where an imported run doesn't tell.
    """

    model: str
    parameters: str
    n_modes: int
    full_step: float = field(metadata=SECONDS)
    reduced_step: float = field(metadata=SECONDS)
    memory_length: float | None = field(metadata=SECONDS)
    full_seconds: float | None = field(metadata=SECONDS)
    reduced_seconds: float | None = field(metadata=SECONDS)
    speed_up: float | None
    compression_factor: float
    """Eq. 4.2 the right way up."""
    field_compression_factor: float


@dataclass(frozen=True)
class StageTiming:
    """The wall-clock of one artifact."""

    artifact: str
    stage: str
    seconds: float = field(metadata=SECONDS)
    threads: int


def reduced_timing(
    case: Case,
    model: ReducedModelSection,
    point: ParameterPoint,
    trajectory: Artifact,
    full_seconds: float | None,
) -> RunTiming:
    """Return the cost of a reduced run's time steps, without reading and writing."""
    steps, n_particles = case.plan.steps, case.plan.n_particles
    reduced_step = trajectory.number("time_step")
    duration = (steps.n_snapshots - 1) * steps.snapshot_interval
    seconds = undisturbed_seconds(trajectory, round(duration / reduced_step))
    n_modes = int(trajectory.dataset("generalized_coordinates").shape[1])
    return RunTiming(
        model=model.name,
        parameters=point.label,
        n_modes=n_modes,
        full_step=steps.time_step,
        reduced_step=reduced_step,
        memory_length=_number(trajectory, "memory_length"),
        full_seconds=full_seconds,
        reduced_seconds=seconds,
        speed_up=full_seconds / seconds if full_seconds and seconds else None,
        compression_factor=compression_factor(n_particles, n_modes),
        field_compression_factor=field_compression_factor(n_particles, n_modes),
    )


def _number(run: Artifact, name: str) -> float | None:
    """Return an attribute of a run, None where it has none."""
    return run.number(name) if name in run.attributes else None


def is_imported(run: Artifact) -> bool:
    """Whether another program made a full run."""
    return "imported/sha256" in run.attributes


def known_seconds(run: Artifact) -> float | None:
    """Return how long the steps of a run took [s], None where nobody knows, as of imported ones."""
    return _number(run, "timing/integration") or None


def undisturbed_seconds(run: Artifact, n_steps: int) -> float | None:
    """Return how long the steps of a run take undisturbed [s], None where nobody knows."""
    least = _number(run, "timing/least_step")
    return known_seconds(run) if least is None else n_steps * least


def stage_timings(workspace: Workspace) -> Iterator[StageTiming]:
    """Yield the wall-clock of every artifact that the comparison was made from.

    The artifacts that runs were made from, such as packed particles, the end of a spin-up or
    operators, are among them if they are there.
    """
    read = {target.path: target for target in workspace.comparison().parents.values()}
    made_from = {
        parent.path: parent
        for target in read.values()
        if target.stage in ("fom", "rom")
        for parent in target.parents.values()
        if parent.path.exists() and parent.path not in read
    }
    for target in (made_from | read).values():
        with open_artifact(target.path, target.schema, made_by=target.made_by) as artifact:
            seconds, threads = artifact.number("wall_seconds"), int(artifact.number("threads"))
            yield StageTiming(target.path.name, artifact.text("stage"), seconds, threads)


def offline_seconds(
    workspace: Workspace, model: ReducedModelSection, points: Iterable[ParameterPoint]
) -> tuple[float | None, float | None]:
    """Return the cost of making a reduced model [s]: all of it, and the full runs it learns from.

    Spin-ups and packing count; the closures of other models, in the same artifact, don't. None
    where nobody knows, as the cost of an imported run is unknown.
    """
    plan = workspace.case.plan
    names = {plan.basis_for(model, point): None for point in points}
    trained = {point: None for name in names for point in plan.bases[name]}
    runs: dict[Path, Target] = {}
    for point in trained:
        _collect(workspace.full_run(point), runs)
    training = 0.0
    for run in runs.values():
        with workspace.open(run) as artifact:
            seconds = (known_seconds if is_imported(artifact) else _wall_seconds)(artifact)
        if seconds is None:
            return None, None
        training += seconds
    offline = training
    stages = [workspace.mapped(point) for point in trained]
    for stage in (*stages, workspace.basis(), workspace.splines()):
        with workspace.open(stage) as artifact:
            offline += _wall_seconds(artifact)
    if model.from_operators:
        own = [(name, model.size) for name in names if model.projection == "apg"]
        with workspace.open(workspace.operators()) as artifact:
            offline += _wall_seconds(artifact) - sum(
                artifact.number(memory_timing(*closure))
                for closure in plan.memory_models
                if closure not in own
            )
    return offline, training


def _collect(target: Target, found: dict[Path, Target]) -> None:
    """Add a target and all that it is made from."""
    found[target.path] = target
    for parent in target.parents.values():
        _collect(parent, found)


def _wall_seconds(artifact: Artifact) -> float:
    return artifact.number("wall_seconds")


def break_even(once: float | None, full_seconds: float | None, online_seconds: float) -> int | None:
    """Return the least number of runs at which a model that costs `once` [s] to make is cheaper.

    None when it never is, or a cost is unknown.
    """
    if once is None or full_seconds is None or full_seconds <= online_seconds:
        return None
    return max(1, math.ceil(once / (full_seconds - online_seconds)))
