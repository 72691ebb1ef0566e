"""The models of a trade: reduced models of several sizes, and variants of the full model.

A trade may include models for which the case has no operators. Their operators, and further full
runs with the models that are trained on them, are kept in the trade's own folder.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import product

from sphrom.case.discretization_checks import coarser_resolution
from sphrom.case.model_sections import ALL, LOCAL, MODELS, ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint, TestValues
from sphrom.case.studies import at_resolution, changed, values_at
from sphrom.case.study_sections import FitSection, SweepSection, TradeSection, TrainingSection
from sphrom.console import Reporter
from sphrom.errors import CaseError
from sphrom.metrics.measures import Probes, Samples
from sphrom.metrics.series import BELOW_ONSET, STEADY
from sphrom.models import fom, stages
from sphrom.models.contract import Ability, family_of, model_of
from sphrom.models.stored_run import StoredRun
from sphrom.setup.context import StageContext
from sphrom.sph.time_loop import TimeSteps
from sphrom.store.variants import Variant
from sphrom.store.workspace import Workspace
from sphrom.text import exact

FOLDER = "trade"
"""Folder of a trade, within that of the case's artifacts."""
SIZES = (2, 5, 10, 20, 50)
"""Default numbers of modes, up to the size of the basis."""
MOST_CLOSED_MODES = 20
"""Default limit of the modes of APG, whose cost grows with their fourth power."""
KINDS = ("operators", "surface-operators")
"""Kinds of artifacts that the models of a trade have of their own."""
OPERATORS, REDUCED, PICTURE_OF_ALL = "operators", "reduced models", "picture"
"""The parts of a trade; the variants of the full model come second."""
COURANT_NUMBERS = (0.75, 1.5)
"""Approximate c0 dt / h of further full runs (Eq. 2.19)."""
SAME_STEP = 1e-9
"""Relative difference below which time steps are equal."""
RESOLUTION = "resolution"
FULL_MODEL: dict[str, tuple[str, str, tuple[float, ...]]] = {
    "Mach number": ("fluid", "mach_number", (0.05, 0.1, 0.2, 0.3, 0.4)),
    "h/dx": ("discretization", "smoothing_length_ratio", (1.2, 1.5, 2.0, 3.0, 4.0)),
    RESOLUTION: ("discretization", "resolution", (10, 14, 20, 28, 40)),
}
"""Properties of the full model, with their section, key and values at extremes."""


def trade_points(case: Case) -> tuple[ParameterPoint, ...]:
    """Return the points at which models are compared: test points, or else training points."""
    return case.plan.test_points or case.plan.train_points


def oscillating_points(
    workspace: Workspace, points: Sequence[ParameterPoint], report: Reporter
) -> tuple[ParameterPoint, ...]:
    """Return the points where the first reduced model is not steady; the others do not count.

    Raises CaseError if it is steady at all points.
    """
    case = workspace.case
    model = model_of(workspace, first_model(case))
    beyond = tuple(point for point in points if model.regime(point) != STEADY)
    steady = ", ".join(point.label for point in points if point not in beyond)
    if not beyond:
        raise CaseError(f"trade.measure: {case.trade.measure}: {steady}: {BELOW_ONSET}")
    if steady:
        report.info(f"{steady} does not count: {BELOW_ONSET}")
    return beyond


def global_basis(case: Case) -> str:
    """Return the basis of the first model, or the basis of all training runs if it is local."""
    first = first_model(case).basis
    return ALL if first == LOCAL else first


def first_model(case: Case) -> ReducedModelSection:
    """Return the first reduced model of a case. Raises CaseError if there is none."""
    if not case.rom:
        raise CaseError("rom: the case has no reduced models to compare; add one")
    return case.rom[0]


def candidates(
    case: Case, points: Sequence[ParameterPoint], basis: str, *also: int
) -> list[ReducedModelSection]:
    """Return the reduced models in a basis, to compare or map at parameter points.

    Their numbers of modes are `also` and `trade.n_modes`. By default, the latter is SIZES as far as
    the basis has so many modes.

    Raises CaseError when `trade.n_modes` exceeds the basis, or a point has no local basis.
    """
    first = first_model(case).model_copy(update={"basis": basis})
    available = min(case.plan.basis_size(case.plan.basis_for(first, point)) for point in points)
    listed = case.trade.n_modes
    if (largest := max(listed or (0,))) > available:
        raise CaseError(f"trade.n_modes: the basis {basis} has {available} modes; got {largest}")
    ends = {"galerkin": available}
    # The closure has operators for the viscosity only.
    if family_of(case).can(Ability.MEMORY) and not case.plan.driving:
        wanted = also if first.projection == "apg" else ()
        ends["apg"] = min(available, max((MOST_CLOSED_MODES, *wanted)))
    sections = []
    for projection, end in ends.items():
        usual = listed or (*(size for size in SIZES if size < end), end)
        for size in sorted({*usual, *(size for size in also if size <= end)}):
            keys = {
                "name": f"weighed-{basis}-{projection}-m{size}",
                "evaluation": "operators",
                "projection": projection,
                "basis": basis,
                "n_modes": size,
            }
            if first.settles_on_cycles and projection == "galerkin":
                keys["calibrated"] = "cycle"
            sections.append(MODELS.section(keys, {"scene": case.scene}))
    return sections


def prepared(context: StageContext, models: Sequence[ReducedModelSection]) -> Workspace:
    """Return a workspace whose case includes the models, and has their operators.

    Operators that the case lacks are projected. Raises ArtifactError when artifacts are missing.
    """
    case = context.case
    workspace = Workspace(context)
    for target in workspace.bases():
        workspace.require(target)
    wider = changed(case, rom=(*case.rom, *models))
    parts = ("reference_bases", "memory_models", "corrected_bases", "surface_sizes")
    if any(getattr(wider.plan, part) != getattr(case.plan, part) for part in parts):
        with context.report.stage(OPERATORS):
            return Variant(context, wider, FOLDER, only=KINDS).made([stages.project])
    workspace = Variant(context, wider).workspace
    workspace.require(workspace.operators())
    return workspace


def variants(case: Case) -> dict[str, Case]:
    """Return the full model at other resolutions and Courant numbers, by label."""
    resolution = case.discretization.resolution
    resolutions = case.trade.resolutions or (resolution, coarser_resolution(case) or resolution)
    cases: dict[tuple[int, int], Case] = {}
    courant_numbers = COURANT_NUMBERS if case.trade.full_runs else ()
    for number, courant in product(resolutions, courant_numbers):
        variant = with_steps(case, number, courant)
        cases.setdefault((number, variant.plan.steps.every), variant)
    usual = case.plan.steps.every
    cases.pop((resolution, usual), None)
    return {f"full, {n} across, {usual / every:.2g} dt": v for (n, every), v in cases.items()}


def with_steps(
    case: Case, resolution: int, courant: float, snapshots: TimeSteps | None = None
) -> Case:
    """Return the full model at a resolution and at most a Courant number.

    Steps are shortened so that whole ones fit between snapshots: `snapshots`, or the case's.
    """
    plan = snapshots or case.plan.steps
    coarser = at_resolution(case, resolution)
    automatic = changed(coarser, time={"step": "auto", "courant_number": courant})
    # The spin-up must be a whole number of steps, too.
    unit = Fraction(plan.n_spin_up_steps, plan.every).denominator
    fitting = plan.snapshot_interval / automatic.plan.step_target * (1.0 - SAME_STEP)
    every = unit * math.ceil(fitting / unit)
    return changed(
        coarser,
        time={"step": plan.snapshot_interval / every},
        snapshots={"every": every},
        name=f"full-{resolution}-{every}",
        rom=(),
        trade=TradeSection(),
    )


def varied_models(
    case: Case,
    points: tuple[Sequence[ParameterPoint], ParameterPoint],
    sections: Sequence[ReducedModelSection],
) -> Iterator[tuple[str, float, Case]]:
    """Yield the full model at half resolution for all values of its properties, with models.

    `points` are the training points, and the point at which models are judged.
    """
    trained, judged = points
    for varied, (section, key, values) in FULL_MODEL.items():
        for value in values:
            resolution = coarser_resolution(case) or case.discretization.resolution
            changes = {section: {key: value}}
            if varied == RESOLUTION:
                resolution = int(value)
                changes = {}
                if value >= case.discretization.resolution:
                    continue
            other = changed(of_full_model(case, trained, [judged]), **changes)
            variant = extreme(other, f"{key}-{exact(value)}", resolution, case.plan.steps)
            yield varied, value, changed(variant, rom=in_all(sections))


def of_full_model(
    case: Case, points: Sequence[ParameterPoint], tested: Sequence[ParameterPoint] = ()
) -> Case:
    """Return the full model at training points, with one basis of them, and at others to test."""
    others = [point for point in tested if point not in points]
    test = values_at(others) if others else TestValues()
    return changed(
        case,
        parameters={"train": values_at(points), "test": test},
        basis={"subsets": {}, "lagrangian": False},
        compare={"figures": ()},
        # Sections of other studies may name models that the variant does not have.
        sweep=SweepSection(),
        fit=FitSection(),
        training=TrainingSection(),
    )


def extreme(case: Case, name: str, resolution: int, snapshots: TimeSteps) -> Case:
    """Return a variant at a resolution, with the snapshots of other steps."""
    variant = with_steps(case, resolution, case.time.courant_number, snapshots)
    return changed(variant, name=f"extreme-{resolution}-{name}")


def in_all(models: Sequence[ReducedModelSection]) -> tuple[ReducedModelSection, ...]:
    """Return models in the basis of all training runs."""
    return tuple(model.model_copy(update={"basis": ALL}) for model in models)


def variant_of(context: StageContext, case: Case, shared: tuple[str, ...] = ()) -> Variant:
    """Return the variant with its artifacts, except `shared` kinds, in a folder of the trade."""
    return Variant(context, case, f"{FOLDER}/{case.name}", shared)


def make_runs(
    variant: Variant, label: str, points: Sequence[ParameterPoint]
) -> list[ParameterPoint]:
    """Make the missing full runs of a variant; return and warn of unstable points."""
    problems = fom.run_each(variant.context, points)
    for point, problem in problems.items():
        variant.context.report.warn(f"{label}, {point.label}: {problem}")
    return [*problems]


def sampled(
    workspace: Workspace, point: ParameterPoint, probes: Probes, measured: str | None = None
) -> Samples:
    """Sample a full run at the probes, with the measurement named `measured`."""
    report = workspace.context.report
    text = f"sample full run, {point.label}"
    with StoredRun.opened(workspace, point) as run, report.progress(text, len(run.time)) as advance:
        samples = run.sampled(probes.all, advance=advance)
        return samples if measured is None else replace(samples, measured=run.measured(measured))
