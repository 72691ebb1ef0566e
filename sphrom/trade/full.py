"""Full runs of a trade: at other steps, resolutions, Mach numbers and h/dx, timed and sampled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from typing import Any

from sphrom.case.checks import coarser_resolution
from sphrom.case.models import Case
from sphrom.case.parameters import ParameterSection, TestValues, TrainValues
from sphrom.case.plan import step_plan, step_target
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.case.studies import at_resolution
from sphrom.case.trade import TradeSection
from sphrom.errors import UnstableError
from sphrom.metrics.samples import Probes, Samples
from sphrom.offline import fom
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.setup.measured_fields import sampler
from sphrom.sph.time_loop import Clock, TimeSteps, march
from sphrom.store.measured_quantities import read_quantities
from sphrom.store.sampling import sample_run
from sphrom.store.workspace import Workspace
from sphrom.text import exact
from sphrom.trade.candidates import global_basis
from sphrom.trade.report import FOLDER, N_TIMED_STEPS

SAME_STEP = 1e-9
"""Steps that differ by less, relatively, are one."""
FEWEST_DIGITS, MOST_DIGITS = 2, 17
"""Of a Courant number in a label; with the most of them no two numbers have the same text."""
MACH, SMOOTHING = "Mach number", "h/dx"
VARIED = {
    MACH: ("fluid", "mach_number", "mach"),
    SMOOTHING: ("discretization", "smoothing_length_ratio", "hdx"),
}
"""Section and key of each property of the full model, and how names of its folders begin."""


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
    def across(self) -> str:
        """The resolution in words."""
        return f"{self.case.discretization.resolution} across"

    @property
    def label(self) -> str:
        """How tables call it."""
        return f"full, {self.across}, C = {self.courant_number:.{self.digits}g}"


def variants(case: Case) -> list[Variant]:
    """Return the full model at every listed resolution and Courant number, less the case's own.

    Their labels differ, by as few digits as possible.
    """
    own = case.discretization.resolution
    resolutions = case.trade.resolutions or (own, coarser_resolution(case) or own)
    found: dict[tuple[int, int], Variant] = {}
    for resolution, courant in product(resolutions, case.trade.courant_numbers):
        variant = with_steps(case, resolution, courant)
        found.setdefault((resolution, step_plan(variant.case).every), variant)
    found.pop((own, step_plan(case).every), None)
    for digits in range(FEWEST_DIGITS, MOST_DIGITS + 1):
        labelled = [replace(variant, digits=digits) for variant in found.values()]
        if len({variant.label for variant in labelled}) == len(found):
            break
    return labelled


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
    name = f"full-{resolution}-{every}"
    changes = {
        "time": case.time.model_copy(update={"step": plan.snapshot_interval / every}),
        "snapshots": case.snapshots.model_copy(update={"every": every}),
        "name": name,
        "rom": (),
        "trade": TradeSection(),
    }
    return Variant(name, coarser.model_copy(update=changes))


def varied_models(
    case: Case, models: Sequence[ReducedModelSection]
) -> dict[tuple[str, float], Variant]:
    """Return the full model at every Mach number and smoothing length that a case lists.

    `models` are the reduced ones to be made of each.
    """
    asked = case.trade.extremes
    listed = {MACH: asked.mach_numbers, SMOOTHING: asked.smoothing_length_ratios}
    return {
        (what, value): variant_of(case, models, what, value)
        for what, values in listed.items()
        for value in sorted(set(values))
    }


def variant_of(
    case: Case, models: Sequence[ReducedModelSection], what: str, value: float
) -> Variant:
    """Return the full model with another value of a property, at the trained points."""
    section, key, folder = VARIED[what]
    changed = getattr(case, section).model_copy(update={key: value})
    points = case.bases[global_basis(case)]
    found = coarser(case, points, f"{folder}{exact(value)}", {section: changed})
    return replace(found, case=found.case.model_copy(update={"rom": tuple(models)}))


def coarser(
    case: Case, points: Sequence[ParameterPoint], name: str, changed: dict[str, Any]
) -> Variant:
    """Return the full model at half the resolution where the case fits that, with other sections.

    It has runs at some points and no others, one basis, and the case's snapshots.
    """
    if len(case.parameter_names) == 1:
        train = TrainValues(reynolds=tuple(point.reynolds for point in points))
    else:
        train = TrainValues(points=tuple(point.as_dict() for point in points))
    changes: dict[str, Any] = {
        "parameters": ParameterSection(train=train, test=TestValues()),
        "basis": case.basis.model_copy(update={"subsets": {}, "lagrangian": False}),
        "operators": case.operators.model_copy(update={"error_estimate": False}),
    }
    other = case.model_copy(update=changes | changed)
    resolution = coarser_resolution(case) or case.discretization.resolution
    courant, snapshots = case.time.courant_number, step_plan(case)
    variant = with_steps(other, resolution, courant, snapshots)
    return replace(variant, name=f"extreme-{resolution}-{name}")


def workspace_of(workspace: Workspace, variant: Variant) -> Workspace:
    """Return the folder of a variant, below that of the case."""
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
        report=context.report.brief(progress=True),
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
    case, report, text = workspace.case, workspace.context.report, f"sample full run, {point.label}"
    with (
        workspace.open(workspace.full_run(point)) as trajectory,
        report.progress(text, len(trajectory.dataset("time"))) as advance,
    ):
        found = sample_run(case, trajectory, sampler(case, probes.all), advance)
        if measured is None:
            return found
        return replace(found, measured=read_quantities(trajectory, measured))
