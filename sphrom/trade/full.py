"""Full runs of a trade: at other steps and resolutions, timed and sampled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

from sphrom.case.checks import coarser_resolution
from sphrom.case.models import Case
from sphrom.case.plan import step_plan, step_target
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import at_resolution
from sphrom.case.trade import TradeSection
from sphrom.errors import UnstableError
from sphrom.metrics.samples import Probes, Samples
from sphrom.offline import fom
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.setup.measured_fields import sampler
from sphrom.setup.reporters import BriefReporter
from sphrom.sph.time_loop import Clock, TimeSteps, march
from sphrom.store.measures import read_quantities
from sphrom.store.sampling import sample_run
from sphrom.store.workspace import Workspace
from sphrom.trade.report import FOLDER, N_TIMED_STEPS

SAME_STEP = 1e-9
"""Steps that differ by less, relatively, are one."""
FEWEST_DIGITS, MOST_DIGITS = 2, 17
"""Of a Courant number in a label; with the most of them no two numbers have the same text."""


@dataclass(frozen=True)
class Variant:
    """The full model at a resolution and a step of its own."""

    name: str
    """Of its folder."""
    case: Case
    digits: int = FEWEST_DIGITS
    """Of the Courant number in its label: enough to tell it from other variants."""

    @property
    def time_step(self) -> float:
        """[s]."""
        return step_plan(self.case).time_step

    @property
    def courant_number(self) -> float:
        """c0 dt / h."""
        return self.time_step * self.case.sound_speed / self.case.smoothing_length

    @property
    def label(self) -> str:
        """How tables call it."""
        resolution = self.case.discretization.resolution
        return f"full, {resolution} across, C = {self.courant_number:.{self.digits}g}"


def variants(case: Case) -> list[Variant]:
    """Return the full model at every listed resolution and Courant number, less the case's own."""
    own = case.discretization.resolution
    resolutions = case.trade.resolutions or (own, coarser_resolution(case) or own)
    found: dict[tuple[int, int], Variant] = {(own, step_plan(case).every): own_run(case)}
    for resolution in resolutions:
        for courant in case.trade.courant_numbers:
            variant = with_steps(case, resolution, courant)
            found.setdefault((resolution, step_plan(variant.case).every), variant)
    return _told_apart(list(found.values())[1:])


def _told_apart(found: list[Variant]) -> list[Variant]:
    """Return the variants with labels that differ, by as few digits as possible."""
    for digits in range(FEWEST_DIGITS, MOST_DIGITS + 1):
        found = [replace(variant, digits=digits) for variant in found]
        if len({variant.label for variant in found}) == len(found):
            break
    return found


def own_run(case: Case) -> Variant:
    """Return the full model as the case has it."""
    return Variant("", case)


def with_steps(
    case: Case, resolution: int, courant: float, snapshots: TimeSteps | None = None
) -> Variant:
    """Return the full model at a resolution and about a Courant number, of the same snapshots.

    Steps are shortened to make a whole number between snapshots; they are never longer than that.
    Pass `snapshots` to use another case's snapshot times.
    """
    plan = snapshots or step_plan(case)
    time = case.time.model_copy(update={"step": "auto", "courant_number": courant})
    coarser = at_resolution(case, resolution).model_copy(update={"time": time})
    # The spin-up must be a whole number of steps too.
    unit = Fraction(plan.n_spin_up_steps, plan.every).denominator
    fitting = plan.snapshot_interval / step_target(coarser) * (1.0 - SAME_STEP)
    every = unit * math.ceil(fitting / unit)
    changes = {
        "name": f"full-{resolution}-{every}",
        "time": case.time.model_copy(update={"step": plan.snapshot_interval / every}),
        "snapshots": case.snapshots.model_copy(update={"every": every}),
        "rom": (),
        "trade": TradeSection(),
    }
    return Variant(str(changes["name"]), coarser.model_copy(update=changes))


def workspace_of(workspace: Workspace, variant: Variant) -> Workspace:
    """Return the folder of a variant, below that of the case."""
    if not variant.name:
        return workspace
    out = workspace.out / FOLDER / variant.name
    context = replace(workspace.context, case=variant.case, out=out, folders={})
    return Workspace(own_context(context))


def own_context(context: StageContext) -> StageContext:
    """Return a context for the trade's own artifacts.

    Those that are there may be made again, and are with --force; a stopped run goes on.
    """
    return replace(
        context,
        force=True,
        keep_valid=not context.force,
        resume=not context.force,
        bitwise=True,
        report=BriefReporter(context.report, progress=True),
    )


def make(variant: Workspace, points: Sequence[ParameterPoint]) -> dict[ParameterPoint, str]:
    """Make the full runs of a variant that are not there, and return why some became unstable."""
    problems: dict[ParameterPoint, str] = {}
    for point in points:
        try:
            fom.run(replace(variant.context, only=(point,)))
        except UnstableError as error:
            problems[point] = str(error)
    return problems


def seconds_of_run(workspace: Workspace, point: ParameterPoint, repeats: int) -> float:
    """Return how long a full run takes on this machine now [s].

    Some steps are timed several times, from the run's start, and the least counts for all.
    """
    case, plan = workspace.case, step_plan(workspace.case)
    state = fom.start(workspace, point).state
    n_steps = min(N_TIMED_STEPS, plan.n_steps)
    steps = TimeSteps(plan.time_step, n_steps, n_steps, plan.start_time, check_every=n_steps)
    model = fom.FullModel(particles.functional(case, point))
    each = []
    for _ in range(repeats):
        clock = Clock()
        density = case.fluid.reference_density
        for _ in march(model, state, steps, density, clock, lambda done: None):
            pass
        each.append(clock.seconds / n_steps)
    return min(each) * plan.n_steps


def sampled(
    workspace: Workspace, point: ParameterPoint, probes: Probes, measured: str | None = None
) -> Samples:
    """Sample a full run at the probes, with a measurement by its name."""
    with (
        workspace.open(workspace.full_run(point)) as trajectory,
        workspace.context.report.progress(
            f"sample full run, {point.label}", len(trajectory.dataset("time"))
        ) as advance,
    ):
        case = workspace.case
        found = sample_run(case, trajectory, sampler(case, probes.all), advance)
        if measured is None:
            return found
        return replace(found, measured=read_quantities(trajectory, measured))
