"""Reasons to doubt that an imported run belongs to the case, from some of its snapshots.

The first snapshot is compared with the initial conditions of the scene. Then the case's own full
model follows the last part of the run. It reproduces its own runs exactly, and runs of other
schemes within their errors. Wrong walls are clearest in the change at first, a wrong viscosity in
the difference at the end.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from sphrom.arrays import Array
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import UnstableError
from sphrom.plots.tables import format_figure
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.sph.functional import Functional
from sphrom.sph.time_loop import Clock, Snapshot, TimeSteps, march

FOLLOWED = 0.5
"""Time for which the case's own model follows an imported run, relative to that of crossing the
scene."""
MODEL_OFF, PER_SPACING, START_OFF = 3.0, 240.0, 20.0
"""Limits of differences in velocity [%]: the least limit of an imported run, the limit over spacing
per length, and that of its start. A finite-volume solution of the cavity departs by 4.2 and 8.2 %
(50 and 25 spacings) and is slowed by 4.6 and 8.9 %, with a wrong lid by 28 and 23 %. At 20 spacings
it is slowed by 16 %, more than the limit of 12 %."""
LEAST_SPEED = 0.05
"""Speed relative to that of the scene; errors of slower flows are relative to it."""
MODEL = "the case's own full model"


@dataclass(frozen=True)
class Followed:
    """The snapshots of a run from which doubts follow, by their numbers."""

    begin: int
    """Where the case's model begins."""
    early: int
    """Where the change at first is compared."""
    last: int
    kept: dict[int, tuple[float, Snapshot]] = field(default_factory=dict)
    """The snapshots with their times [s], including the first one of the run."""

    @classmethod
    def of(cls, case: Case, interpolated: Sequence[bool]) -> Followed:
        """Return the snapshots for a run, some of which may be interpolated in time."""
        last = len(interpolated) - 1
        n_followed = int(FOLLOWED * crossing_time(case) / case.plan.steps.snapshot_interval)
        begin = max(0, last - max(1, n_followed))
        # Interpolation is too inexact for a change over one interval.
        return cls(begin, last if any(interpolated[begin : begin + 2]) else begin + 1, last)

    def keep(self, index: int, time: float, snapshot: Snapshot) -> None:
        """Keep a snapshot if doubts depend on it."""
        if index in (0, self.begin, self.early, self.last):
            self.kept[index] = time, snapshot


def crossing_time(case: Case) -> float:
    """Return the time in which the fastest fluid crosses the scene [s]."""
    return case.scene.length_scale / case.plan.max_speed


def doubts_about(
    context: StageContext, point: ParameterPoint, model: Functional, run: Followed
) -> Iterator[str]:
    """Yield the doubts about an imported run at a parameter point."""
    case = context.case
    least_speed = LEAST_SPEED * case.plan.max_speed
    first = run.kept[0][1]
    initial = case.plan.flow(point).initial_velocity(first.position.T)
    start, _ = _difference(initial, first.velocity.T, least_speed)
    if start > START_OFF:
        yield (
            f"its first velocities differ by {format_figure(start, 2)} % from the initial "
            "velocities of the scene; check --origin, --start, --units and the scene"
        )
    try:
        departed, slowed = _departures(context, point, model, run)
    except (UnstableError, ValueError) as error:
        begin = run.kept[run.begin][0]
        yield f"from t = {begin:.4g} s on, {MODEL} can't follow the files: {error}"
        return
    most = max(MODEL_OFF, PER_SPACING * case.plan.particle_spacing / case.scene.length_scale)
    if max(departed, abs(slowed)) > most:
        yield _described(case, run, departed, slowed, most)


def _difference(model: Array, files: Array, least_speed: float) -> tuple[float, float]:
    """Return the difference of velocities (n, 2) [m/s], and its part along them [%]."""
    scale = max(np.sum(files**2), np.sum(model**2), len(files) * least_speed**2)
    along = np.sum((model - files) * files) / scale
    return 100.0 * math.sqrt(np.sum((model - files) ** 2) / scale), 100.0 * float(along)


def _departures(
    context: StageContext, point: ParameterPoint, model: Functional, run: Followed
) -> tuple[float, float]:
    """Return the difference of the model from the last snapshot, and its change at first [%].

    The change is along the flow, per time in which the flow crosses the scene.
    """
    case = context.case
    plan = case.plan
    time, begin = run.kept[run.begin]
    every = plan.steps.every
    steps = TimeSteps(plan.steps.time_step, (run.last - run.begin) * every, every, time)
    state = np.vstack((begin.position, begin.density_fluctuation, begin.velocity))
    density = case.fluid.reference_density
    least_speed = LEAST_SPEED * plan.max_speed
    to = particles.map_onto(case, case.scene.domain.fill(plan.particle_spacing))

    def on_points(snapshot: Snapshot) -> Array:
        return to(snapshot.position.T, snapshot.density_fluctuation, snapshot.velocity.T)[1]

    found = {}
    with context.report.progress(f"{MODEL}, {point.label}", steps.n_steps) as advance:
        for step, full in march(model, state, steps, density, Clock(), advance):
            index = run.begin + step // every
            if index in (run.early, run.last):
                in_files = on_points(run.kept[index][1])
                found[index] = _difference(on_points(model.snapshot(full)), in_files, least_speed)
    seconds = (run.early - run.begin) * plan.steps.snapshot_interval
    return found[run.last][0], found[run.early][1] * crossing_time(case) / seconds


def _described(case: Case, run: Followed, departed: float, slowed: float, most: float) -> str:
    """Return the doubt about a run from which the case's own model departs."""
    walls = "scene.lid, " * hasattr(case.scene, "lid") or "walls, " * case.scene.domain.has_walls
    return (
        f"from t = {run.kept[run.begin][0]:.4g} to {run.kept[run.last][0]:.4g} s, velocities of "
        f"{MODEL} come to differ from the files by {format_figure(departed, 2)} %, and at first "
        f"its flow becomes {format_figure(abs(slowed), 2)} % "
        f"{'slower' if slowed < 0.0 else 'faster'} per {crossing_time(case):.3g} s; for other "
        f"schemes both are within {most:.2g} %. Check {walls}the Reynolds number, the body force, "
        "--units and --zero-mean-pressure"
    )
