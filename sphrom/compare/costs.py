"""The costs of stages, of full and reduced runs, and of making a reduced model."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact, open_artifact
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.study_sections import FULL
from sphrom.kernels import ask_for_threads, asked_for
from sphrom.metrics.histories import compression_factors
from sphrom.models.contract import basis_used, model_of
from sphrom.models.fom import seconds_of_steps
from sphrom.models.points.stored import memory_timing
from sphrom.setup import particles
from sphrom.store.trajectory import snapshot_fields
from sphrom.store.workspace import Target, Workspace

SECONDS = {"unit": "s"}
N_REPEATS = 5
"""Number of timings of each run, in turns; the least counts, and all give the spread."""


@dataclass(frozen=True)
class RunTiming:
    """The times of a reduced run and of the full run at its largest stable step, without spin-up.

    Seconds are processor time on one thread for the steps only, the least of several repeats in
    which all runs take turns. A run of microseconds is repeated without a break, so its data stay
    in the processor's caches; its steps are chosen before. Speed-ups are ratios of such times. For
    an imported run only the time stated at its import is known, if any. Its threads and machine are
    unknown, so it has no speed-up.
    """

    model: str
    parameters: str
    n_modes: int
    full_step: float | None = field(metadata=SECONDS)
    reduced_step: float = field(metadata=SECONDS)
    memory_length: float | None = field(metadata=SECONDS)
    full_seconds: float | None = field(metadata=SECONDS)
    reduced_seconds: float | None = field(metadata=SECONDS)
    speed_up: float | None
    compression_factor: float
    """Eq. 4.2 as N_d / M, the inverse of the printed ratio."""
    field_compression_factor: float
    least_speed_up: float | None = None
    """The least speed-up of a single repeat; likewise the greatest."""
    greatest_speed_up: float | None = None


@dataclass(frozen=True)
class StageTiming:
    """The wall-clock time to make one artifact."""

    artifact: str
    stage: str
    seconds: float = field(metadata=SECONDS)
    threads: int


def largest_step(case: Case) -> float:
    """Return the largest stable step of the full model [s], or the case's step if it is larger."""
    return max(case.plan.limits.least, case.plan.steps.time_step)


def taking_turns(
    timed: Mapping[Any, Callable[[], float]],
    repeats: int,
    advance: Callable[[int], None] = lambda done: None,
) -> dict[Any, Array]:
    """Return the seconds (n_repeats,) of functions that are called in turns, on one thread.

    A first round is ignored, because it includes compilation.
    """

    def measured(timer: Callable[[], float]) -> float:
        seconds = timer()
        advance(1)
        return seconds

    threads = asked_for()
    ask_for_threads(1)
    try:
        rounds = np.array([[*map(measured, timed.values())] for _ in range(repeats + 1)])
    finally:
        ask_for_threads(threads)
    return dict(zip(timed, rounds[1:].T, strict=True))


def full_run_timer(workspace: Workspace, point: ParameterPoint, step: float) -> Callable[[], float]:
    """Return a function that measures the seconds of a full run with a time step [s].

    It times some of the case's own steps in the middle of a run, because the cost of a step depends
    neither on its length nor on parameters.
    """
    case = workspace.case
    with workspace.open(workspace.full_run(point)) as run:
        position, density, velocity = snapshot_fields(run, run.length("time") // 2)
    state = np.vstack((position.T, density, velocity.T))
    model = particles.functional(case, point)
    return partial(seconds_of_steps, case, model, state, case.plan.steps.time_step, step)


def run_timings(workspace: Workspace) -> Iterator[RunTiming]:
    """Yield the timings of complete reduced runs, with those of full runs.

    Steps on particles cost the same at all points, so they are timed once per model.
    """
    case = workspace.case
    plan = case.plan
    rows: list[tuple[RunTiming, object]] = []
    timers: dict[object, Callable[[], float]] = {}
    models = {section.name: model_of(workspace, section) for section in case.rom}
    for point, model in ((p, m) for p in plan.points for m in plan.compared_at(p)):
        with workspace.open(workspace.full_run(point)) as run:
            imported = is_imported(run)
            stated = known_seconds(run) if imported else None
        with workspace.open(workspace.reduced_run(model, point)) as run:
            if run.text("status") != "complete":
                continue
            step = run.number("time_step")
            memory_length = _number(run, "memory_length")
        n_modes = basis_used(workspace, model, point)[1]
        reduced_model = models[model.name]
        key = (model.name, None if reduced_model.family.costs_alike else point)
        if not imported and FULL not in timers:
            timers[FULL] = full_run_timer(workspace, point, largest_step(case))
        if key not in timers:
            timers[key] = reduced_model.timer(point, step)
        compression, field_compression = compression_factors(plan.n_particles, n_modes)
        row = RunTiming(
            model=model.name,
            parameters=point.label,
            n_modes=n_modes,
            full_step=None if imported else largest_step(case),
            reduced_step=step,
            memory_length=memory_length,
            full_seconds=stated,
            reduced_seconds=None,
            speed_up=None,
            compression_factor=compression,
            field_compression_factor=field_compression,
        )
        rows.append((row, key))
    report = workspace.context.report.details
    with report.progress("timings", max(1, len(timers) * (N_REPEATS + 1))) as advance:
        seconds = taking_turns(timers, N_REPEATS, advance) if rows else {}
    for row, timed in rows:
        reduced = float(seconds[timed].min())
        row = replace(row, reduced_seconds=reduced)
        if row.full_step is not None:
            full = float(seconds[FULL].min())
            gains = seconds[FULL] / seconds[timed]
            row = replace(
                row,
                full_seconds=full,
                speed_up=full / reduced,
                least_speed_up=float(gains.min()),
                greatest_speed_up=float(gains.max()),
            )
        yield row


def _number(run: Artifact, name: str) -> float | None:
    """Return an attribute of a run, or None."""
    return run.number(name) if name in run.attributes else None


def is_imported(run: Artifact) -> bool:
    """Return whether a full run is from another program."""
    return "imported/sha256" in run.attributes


def known_seconds(run: Artifact) -> float | None:
    """Return the time of a run's steps [s]; None if unknown, as for some imported runs."""
    return _number(run, "timing/integration") or None


def stage_timings(workspace: Workspace) -> Iterator[StageTiming]:
    """Yield the wall-clock times of all existing artifacts that the comparison depends on."""
    made: dict[Path, Target] = {}
    left = [workspace.comparison()]
    while left:
        for parent in left.pop().existing_parents.values():
            if made.setdefault(parent.path, parent) is parent:
                left.append(parent)
    for target in made.values():
        with open_artifact(target.path, target.schema, made_by=target.made_by) as artifact:
            yield StageTiming(
                artifact=target.path.name,
                stage=artifact.text("stage"),
                seconds=artifact.number("wall_seconds"),
                threads=int(artifact.number("threads")),
            )


def offline_seconds(
    workspace: Workspace,
    model: ReducedModelSection,
    points: Iterable[ParameterPoint],
    full_seconds: float | None,
) -> tuple[float | None, float | None]:
    """Return the cost of making a reduced model [s], in total and of its training runs.

    The steps of training runs, including the spin-up, count at the cost of those of a full run at
    its largest stable step, which takes `full_seconds`. All else counts with its processor time,
    without compilation. Packing counts, and closures of other models in the same artifact do not.
    Both are None if a cost is unknown, as for imported runs.
    """
    plan = workspace.case.plan
    names = {plan.basis_for(model, point): None for point in points}
    trained = {point: None for name in names for point in plan.bases[name]}
    n_steps = plan.steps.n_steps + plan.steps.n_spin_up_steps
    longer = n_steps * largest_step(workspace.case) / plan.recorded_time
    training = 0.0
    for point in trained:
        with workspace.open(workspace.full_run(point)) as run:
            seconds = (
                known_seconds(run) if is_imported(run) else full_seconds and full_seconds * longer
            )
        if seconds is None:
            return None, None
        training += seconds
    if plan.packed and workspace.packing().path.exists():
        with workspace.open(workspace.packing()) as packing:
            training += _computing_seconds(packing)
    offline = training
    own = {memory_timing(name, model.size) for name in names if model.has_memory}
    closures = {memory_timing(basis, size) for basis, size in plan.memory_models}
    for stage in (*map(workspace.mapped, trained), *workspace.made_from(model)):
        with workspace.open(stage) as artifact:
            offline += _computing_seconds(artifact)
            offline -= sum(_number(artifact, name) or 0.0 for name in closures - own)
    return offline, training


def _computing_seconds(artifact: Artifact) -> float:
    return _number(artifact, "timing/processor") or artifact.number("wall_seconds")


def break_even(once: float | None, full_seconds: float | None, online_seconds: float) -> int | None:
    """Return the number of runs from which a model that costs `once` [s] to make is cheaper.

    Returns None if it never is, or a cost is unknown.
    """
    if once is None or full_seconds is None or full_seconds <= online_seconds:
        return None
    return max(1, math.ceil(once / (full_seconds - online_seconds)))
