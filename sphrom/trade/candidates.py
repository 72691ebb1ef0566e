"""The models of a trade: reduced models of several sizes, and variants of the full model.

A trade may include models for which the case has no operators. Their operators, and further full
runs, are kept in the trade's own folder.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import product
from pathlib import Path
from types import MappingProxyType

from sphrom.case.checks import coarser_resolution
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ALL, LOCAL, ReducedModelSection
from sphrom.case.studies import at_resolution
from sphrom.case.study_sections import TradeSection
from sphrom.errors import CaseError, UnstableError
from sphrom.metrics.measures import Probes, Samples
from sphrom.models import fom, stages
from sphrom.models.contract import Ability, family_of
from sphrom.models.stored_run import StoredRun
from sphrom.setup.context import StageContext
from sphrom.sph.time_loop import TimeSteps
from sphrom.store.workspace import Workspace

FOLDER = "trade"
"""Folder of a trade, within that of the case's artifacts."""
SIZES = (2, 5, 10, 20, 50)
"""Default numbers of modes, up to the size of the basis."""
MOST_CLOSED_MODES = 20
"""Default limit of the modes of APG, whose cost grows with their fourth power."""
COURANT_NUMBERS = (0.75, 1.5)
"""Approximate c0 dt / h of further full runs (Eq. 2.19)."""
SAME_STEP = 1e-9
"""Relative difference below which time steps are equal."""


def trade_points(case: Case) -> tuple[ParameterPoint, ...]:
    """Return the points at which models are compared: test points, or else training points."""
    return case.plan.test_points or case.plan.train_points


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
    sections = []
    if (largest := max(listed or (0,))) > available:
        raise CaseError(f"trade.n_modes: the basis {basis} has {available} modes; got {largest}")
    ends = {"galerkin": available}
    # The closure has operators for the viscosity only.
    if family_of(case).can(Ability.MEMORY) and not case.plan.driving:
        own = also if first.projection == "apg" else ()
        ends["apg"] = min(available, max((MOST_CLOSED_MODES, *own)))
    for projection, end in ends.items():
        for size in sorted(
            {*(listed or (*filter(end.__gt__, SIZES), end)), *filter(end.__ge__, also)}
        ):
            name = f"weighed-{basis}-{projection}-m{size}"
            keys = {"evaluation": "operators", "projection": projection, "basis": basis}
            if first.settles_on_cycles and projection == "galerkin":
                keys["calibrated"] = "cycle"
            named = {**keys, "name": name, "n_modes": size}
            sections.append(ReducedModelSection.model_validate(named))
    return sections


def prepared(context: StageContext, models: Sequence[ReducedModelSection]) -> Workspace:
    """Return a workspace whose case includes the models, and has their operators.

    Operators that the case lacks are projected. Raises ArtifactError when artifacts are missing.
    """
    own = context.case
    workspace = Workspace(context)
    for target in workspace.bases():
        workspace.require(target)
    wider = replace(context, case=own.model_copy(update={"rom": (*own.rom, *models)}))
    parts = ("reference_bases", "memory_models", "corrected_bases", "surface_sizes")
    kinds = "operators", "surface-operators"
    if any(getattr(wider.case.plan, part) != getattr(own.plan, part) for part in parts):
        wider = replace(wider, folders=dict.fromkeys(kinds, context.out / FOLDER))
        stages.project(_own_context(wider))
    workspace = Workspace(wider)
    workspace.require(workspace.operators())
    return workspace


def _own_context(context: StageContext) -> StageContext:
    """Return a context for the trade's own artifacts.

    Artifacts that are out of date are overwritten; with --force all are. Stopped runs continue.
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
    """Return the full model at other resolutions and Courant numbers, by label."""
    own = case.discretization.resolution
    resolutions = case.trade.resolutions or (own, coarser_resolution(case) or own)
    cases: dict[tuple[int, int], Case] = {}
    courant_numbers = COURANT_NUMBERS if case.trade.full_runs else ()
    for resolution, courant in product(resolutions, courant_numbers):
        variant = with_steps(case, resolution, courant)
        cases.setdefault((resolution, variant.plan.steps.every), variant)
    usual = case.plan.steps.every
    cases.pop((own, usual), None)
    return {f"full, {n} across, {usual / every:.2g} dt": v for (n, every), v in cases.items()}


def with_steps(
    case: Case, resolution: int, courant: float, snapshots: TimeSteps | None = None
) -> Case:
    """Return the full model at a resolution and at most a Courant number, with equal snapshots.

    Steps are shortened so that whole ones fit between snapshots: `snapshots`, or the case's.
    """
    plan = snapshots or case.plan.steps
    time = case.time.model_copy(update={"step": "auto", "courant_number": courant})
    coarser = at_resolution(case, resolution).model_copy(update={"time": time})
    # The spin-up must be a whole number of steps, too.
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


def workspace_of(
    workspace: Workspace, variant: Case, folders: Mapping[str, Path] = MappingProxyType({})
) -> Workspace:
    """Return the workspace of a variant, in a folder within that of the case.

    `folders` are the folders of kinds of artifacts that are kept elsewhere.
    """
    out = workspace.out / FOLDER / variant.name
    context = replace(workspace.context, case=variant, out=out, folders=folders)
    return Workspace(_own_context(context))


def make(variant: Workspace, label: str, points: Sequence[ParameterPoint]) -> list[ParameterPoint]:
    """Make the missing full runs of a variant; return and warn of unstable points."""
    unstable = []
    for point in points:
        try:
            fom.run(replace(variant.context, only=(point,)))
        except UnstableError as error:
            variant.context.report.warn(f"{label}, {point.label}: {error}")
            unstable.append(point)
    return unstable


def sampled(
    workspace: Workspace, point: ParameterPoint, probes: Probes, measured: str | None = None
) -> Samples:
    """Sample a full run at the probes, with the measurement named `measured`."""
    report = workspace.context.report
    text = f"sample full run, {point.label}"
    with StoredRun.opened(workspace, point) as run, report.progress(text, len(run.time)) as advance:
        samples = run.sampled(probes.all, advance=advance)
        return samples if measured is None else replace(samples, measured=run.measured(measured))
