"""The models of a trade: reduced ones of some sizes and steps, and the full one otherwise.

A trade may weigh models that the case has no operators for. Their operators, and further full runs,
lie in the trade's own folder, and are kept there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from typing import Any, Literal

from sphrom.case.checks import coarser_resolution
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint, ParameterSection, TestValues, TrainValues
from sphrom.case.sections import ALL, LOCAL, ReducedModelSection
from sphrom.case.studies import at_resolution
from sphrom.case.study_sections import TradeSection
from sphrom.errors import CaseError, UnstableError
from sphrom.metrics.samples import Probes, Samples
from sphrom.offline import fom, operators
from sphrom.setup import particles
from sphrom.setup.context import StageContext
from sphrom.sph.time_loop import Clock, TimeSteps, march
from sphrom.store.measured_quantities import read_quantities
from sphrom.store.sampling import sample_run
from sphrom.store.workspace import Workspace
from sphrom.text import exact

Projection = Literal["galerkin", "apg"]

FOLDER = "trade"
"""Of a trade, below that of the case's artifacts."""
N_TIMED_STEPS = 10
"""Steps of the full model that are timed at once."""
SIZES = (2, 5, 10, 20, 50)
"""Default numbers of modes, as far as the basis has as many."""
MOST_CLOSED_MODES = 20
"""The most modes of APG by default: its cost grows with their fourth power."""
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
class Candidate:
    """A reduced model to weigh, of some time step."""

    model: ReducedModelSection
    step_factor: float
    """Its time step over the automatic one."""

    @property
    def family(self) -> str:
        """How tables call models of all sizes and steps."""
        return "APG" if self.model.projection == "apg" else "Galerkin, calibrated"

    @property
    def label(self) -> str:
        """How tables call it."""
        step = "" if self.step_factor == 1.0 else f", {exact(self.step_factor)} dt"
        return f"{self.family}, M = {self.model.size}{step}"


def trade_points(case: Case) -> tuple[ParameterPoint, ...]:
    """Return the values at which models are weighed: test values, if there are any."""
    return case.plan.test_points or case.plan.train_points


def candidates(case: Case, points: Sequence[ParameterPoint]) -> list[Candidate]:
    """Return the reduced models that a case lists, at parameter points.

    Raises CaseError when the basis has fewer modes than are listed, or there is no local one.
    """
    basis = case.rom[0].basis if case.rom else ALL
    asked = ReducedModelSection(name=basis, basis=basis)
    available = min(case.plan.basis_size(case.plan.basis_for(asked, point)) for point in points)
    if (most := max(case.trade.n_modes or (0,))) > available:
        raise CaseError(f"trade.n_modes: the basis {basis} has {available} modes; got {most}")
    return [
        Candidate(model, factor)
        for projection in projections(case)
        for model in models_of_sizes(case, projection, basis, available, SIZES)
        for factor in dict.fromkeys(case.trade.step_factors)
    ]


def projections(case: Case) -> tuple[Projection, ...]:
    """Return the projections that a case lists; flows that are driven have no closure."""
    default: tuple[Projection, ...] = ("galerkin",) if case.plan.driving else ("galerkin", "apg")
    return tuple(dict.fromkeys(case.trade.projections or default))


def models_of_sizes(
    case: Case,
    projection: Projection,
    basis: str,
    available: int,
    sizes: Sequence[int],
    *,
    calibrated: bool = True,
    **keys: Any,
) -> list[ReducedModelSection]:
    """Return models of the sizes that a case lists; by default of some, as far as the basis goes.

    The last of them then has all `available` modes. Only Galerkin models are calibrated.
    """
    closed = projection == "apg"
    if case.trade.n_modes is None:
        most = min(available, MOST_CLOSED_MODES) if closed else available
        sizes = (*(size for size in sizes if size < most), most)
    else:
        sizes = case.trade.n_modes
    return [
        ReducedModelSection(
            name=f"weighed-{basis}-{projection}-m{size}",
            evaluation="operators",
            projection=projection,
            n_modes=size,
            basis=basis,
            calibrated=calibrated and not closed,
            **keys,
        )
        for size in dict.fromkeys(sizes)
    ]


def global_basis(case: Case) -> str:
    """Return the basis that models of a case have at any value: that of the first, or all."""
    first = case.rom[0].basis if case.rom else ALL
    return ALL if first == LOCAL else first


def extreme_points(case: Case) -> tuple[ParameterPoint, ...]:
    """Return the values at which stability is mapped, from the least Reynolds number on.

    Other parameters are those of the training value with the greatest Reynolds number.
    """
    trained = case.plan.bases[global_basis(case)]
    low, high = min(trained).reynolds, max(trained)
    products = (
        f * (low if f < 1.0 else high.reynolds) for f in case.trade.extremes.reynolds_factors
    )
    # Without their rounding errors, which names would show: 220 of 1.1 * 200.
    values = {float(f"{value:.12g}") for value in products}
    return tuple(replace(high, reynolds=value) for value in sorted(values))


def prepared(context: StageContext, models: Sequence[ReducedModelSection]) -> Workspace:
    """Return a workspace with operators of models, whose case includes them.

    Operators are projected where the case's lack some.

    Raises ArtifactError when artifacts of the case are missing.
    """
    own, workspace = context.case, Workspace(context)
    for target in (workspace.basis(), workspace.splines()):
        workspace.require(target)
    wider = replace(context, case=own.model_copy(update={"rom": (*own.rom, *models)}))
    parts = ("reference_bases", "memory_models", "taught_bases")
    if any(getattr(wider.case.plan, part) != getattr(own.plan, part) for part in parts):
        wider = replace(wider, folders={"operators": context.out / FOLDER})
        operators.run(own_context(wider))
    workspace = Workspace(wider)
    workspace.require(workspace.operators())
    return workspace


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


def variants(case: Case) -> dict[str, Case]:
    """Return the full model at every listed resolution and Courant number, less the case's own.

    They are by their labels, which differ by as few digits as possible.
    """
    own = case.discretization.resolution
    resolutions = case.trade.resolutions or (own, coarser_resolution(case) or own)
    found: dict[tuple[int, int], Case] = {}
    for resolution, courant in product(resolutions, case.trade.courant_numbers):
        variant = with_steps(case, resolution, courant)
        found.setdefault((resolution, variant.plan.steps.every), variant)
    found.pop((own, case.plan.steps.every), None)
    for digits in range(FEWEST_DIGITS, MOST_DIGITS + 1):
        labelled = {_label(variant, digits): variant for variant in found.values()}
        if len(labelled) == len(found):
            break
    return labelled


def _label(case: Case, digits: int) -> str:
    return f"full, {across(case)}, C = {courant_number(case):.{digits}g}"


def across(case: Case) -> str:
    """Return the resolution of a case in words."""
    return f"{case.discretization.resolution} across"


def courant_number(case: Case) -> float:
    """Return c0 dt / h of a case."""
    return case.plan.steps.time_step * case.plan.sound_speed / case.plan.smoothing_length


def with_steps(
    case: Case, resolution: int, courant: float, snapshots: TimeSteps | None = None
) -> Case:
    """Return the full model at a resolution and about a Courant number, of the same snapshots.

    Steps are shortened to make a whole number between snapshots; they are never longer than that.
    Pass `snapshots` to use another case's snapshot times.
    """
    plan = snapshots or case.plan.steps
    time = case.time.model_copy(update={"step": "auto", "courant_number": courant})
    coarser = at_resolution(case, resolution).model_copy(update={"time": time})
    # The spin-up must be a whole number of steps too.
    unit = Fraction(plan.n_spin_up_steps, plan.every).denominator
    fitting = plan.snapshot_interval / coarser.plan.step_target * (1.0 - SAME_STEP)
    every = unit * math.ceil(fitting / unit)
    changes = {
        "time": case.time.model_copy(update={"step": plan.snapshot_interval / every}),
        "snapshots": case.snapshots.model_copy(update={"every": every}),
        "name": f"full-{resolution}-{every}",
        "rom": (),
        "trade": TradeSection(),
    }
    return coarser.model_copy(update=changes)


def varied_models(
    case: Case, models: Sequence[ReducedModelSection]
) -> dict[tuple[str, float], Case]:
    """Return the full model at every Mach number and smoothing length that a case lists.

    `models` are the reduced ones to be made of each, which learns at the trained points.
    """
    asked, points = case.trade.extremes, case.plan.bases[global_basis(case)]
    listed = {MACH: asked.mach_numbers, SMOOTHING: asked.smoothing_length_ratios}
    found = {}
    for what, values in listed.items():
        section, key, folder = VARIED[what]
        for value in sorted(set(values)):
            changed = {section: getattr(case, section).model_copy(update={key: value})}
            variant = coarser(case, points, f"{folder}{exact(value)}", changed)
            found[what, value] = variant.model_copy(update={"rom": tuple(models)})
    return found


def coarser(
    case: Case, points: Sequence[ParameterPoint], name: str, changed: dict[str, Any]
) -> Case:
    """Return the full model at half the resolution where the case fits that, with other sections.

    It has runs at some points and no others, one basis, and the case's snapshots.
    """
    if len(case.plan.parameter_names) == 1:
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
    variant = with_steps(other, resolution, case.time.courant_number, case.plan.steps)
    return variant.model_copy(update={"name": f"extreme-{resolution}-{name}"})


def workspace_of(workspace: Workspace, variant: Case) -> Workspace:
    """Return the folder of a variant, below that of the case."""
    out = workspace.out / FOLDER / variant.name
    context = replace(workspace.context, case=variant, out=out, folders={})
    return Workspace(own_context(context))


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
    case, plan = workspace.case, workspace.case.plan.steps
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
        found = sample_run(case, trajectory, probes.all, advance)
        if measured is None:
            return found
        return replace(found, measured=read_quantities(trajectory, measured))
