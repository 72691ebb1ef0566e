"""Stage `trade --extremes`: where models on the reference points are stable, and accurate.

Time steps are varied at Reynolds numbers in and out of training. At the greatest trained one the
memory length of models with the closure is varied too, and so are the full model's Mach number and
smoothing length, each value with artifacts of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from sphrom.case.checks import coarser_resolution
from sphrom.case.models import Case
from sphrom.case.plan import basis_size, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ALL, ReducedModelSection
from sphrom.errors import CaseError, ResourceError, UnstableError
from sphrom.metrics.samples import Probes, Samples
from sphrom.setup.context import StageContext
from sphrom.store.sampling import probes_of
from sphrom.store.workspace import Workspace
from sphrom.trade import full as trade_full
from sphrom.trade.candidates import (
    MOST_CLOSED_MODES,
    Projection,
    default_sizes,
    extreme_points,
    global_basis,
    has_calibrated,
)
from sphrom.trade.extreme_rows import FULL_UNSTABLE, REFUSED, ExtremeRow, publish
from sphrom.trade.extreme_runs import ExtremeRuns
from sphrom.trade.full import Variant
from sphrom.trade.models import prepared
from sphrom.trade.runs import ReducedRuns
from sphrom.trade.variants import Varied, learning_from, learnt, varied_models

SIZES = (2, 3, 5, 8, 12, 20, 30, 50)
"""Default numbers of modes, as far as the basis has as many."""


def run(context: StageContext) -> None:
    """Run models at their extremes, and write a table and a map of their stability.

    Raises
    ------
    CaseError
        When the case has no reduced models, or none with operators are listed.
    ArtifactError
        When the basis, its splines or the operators are missing.
    """
    case = context.case
    if not case.rom:
        raise CaseError("rom: the case has no reduced models, so there is nothing to weigh")
    if "operators" not in case.trade.evaluations:
        raise CaseError(
            "trade.evaluations: stability is mapped of models with operators; list operators"
        )
    models, closed = _models(case, "galerkin"), _models(case, "apg")
    workspace = prepared(context, case.basis.inner_product, [*models, *closed])
    points, notes = context.chosen(extreme_points(case)), []
    rows = list(_of_case(workspace, points, models, closed))
    asked = [_of_all(model) for model in models]
    if _top(case) in points and (variants := varied_models(case, asked)):
        if _may_run(case):
            rows += _of_variants(workspace, variants)
        else:
            why = "a spin-up" if case.time.spin_up > 0.0 else "trade.extremes.full_runs: false"
            notes = [f"with {why}, Mach number and h/dx are not varied: they need full runs"]
    publish(workspace, rows, notes)


def _of_case(
    workspace: Workspace,
    points: Sequence[ParameterPoint],
    models: Sequence[ReducedModelSection],
    closed: Sequence[ReducedModelSection],
) -> Iterator[ExtremeRow]:
    """Yield the rows of models that are made from the case's artifacts."""
    case, probes = workspace.case, probes_of(workspace.case)
    reduced = ReducedRuns(workspace, probes)
    with workspace.context.report.progress("extremes", len(points) * len(models)) as advance:
        for point in points:
            full = _full_run(workspace, point, probes)
            runs = ExtremeRuns(workspace, reduced, probes, *full, point, case.trade)
            for model in models:
                yield from runs.time_steps(model)
                advance(1)
            for model in closed if point == _top(case) else ():
                yield from runs.memory_lengths(model)


def _models(case: Case, projection: Projection) -> list[ReducedModelSection]:
    """Return models of all sizes: Galerkin, or with the closure if memory lengths are varied."""
    asked = case.trade.extremes
    sizes = asked.n_modes or default_sizes(basis_size(case, global_basis(case)), SIZES)
    if projection == "apg":
        sizes = tuple(n for n in sizes if n <= MOST_CLOSED_MODES and asked.memory_factors)
        sizes = () if case.driving else sizes
    calibrated = has_calibrated(case) if asked.calibrated is None else asked.calibrated
    return [
        ReducedModelSection(
            name=f"extreme-{projection}-{n_modes}",
            evaluation="operators",
            projection=projection,
            n_modes=n_modes,
            basis=global_basis(case),
            calibrated=calibrated and projection == "galerkin",
            corrected=False,
        )
        for n_modes in sizes
    ]


def _of_all(model: ReducedModelSection) -> ReducedModelSection:
    """Return a model as a variant has it, whose only basis learns from all of its runs."""
    return model.model_copy(update={"basis": ALL})


def _top(case: Case) -> ParameterPoint:
    """Return where more than steps is varied: the greatest trained value."""
    return max(case.bases[global_basis(case)], key=lambda point: point.reynolds)


def _may_run(case: Case) -> bool:
    """Whether full runs may be made that the case doesn't have."""
    return case.time.spin_up == 0.0 and case.trade.extremes.full_runs


def _full_run(
    workspace: Workspace, point: ParameterPoint, probes: Probes
) -> tuple[str, Samples | None]:
    """Return the name and the samples of a full run to compare with: the case's, or a coarser one.

    No name and no samples where there is none.
    """
    case = workspace.case
    if point in case.points:
        return "full run", trade_full.sampled(workspace, point, probes)
    if not _may_run(case):
        return "", None
    resolution = coarser_resolution(case) or case.discretization.resolution
    # Its own step: viscosity may allow less than at the case's values.
    other = learning_from(case, (point,))
    variant = trade_full.with_steps(other, resolution, case.time.courant_number, step_plan(case))
    variant = Variant(f"extreme-{resolution}-{point.file_label}", variant.case)
    made = trade_full.workspace_of(workspace, variant)
    if (problem := trade_full.make(made, [point]).get(point)) is not None:
        workspace.context.report.warn(f"{variant.label}, {point.label}: {problem}")
        return "", None
    return f"full run, {resolution} across", trade_full.sampled(made, point, probes)


def _of_variants(workspace: Workspace, variants: Sequence[Varied]) -> Iterator[ExtremeRow]:
    """Yield the rows of the models of varied full models; a variant that fails stops nothing."""
    text = "Mach numbers and smoothing lengths"
    point = _top(workspace.case)
    with workspace.context.report.progress(text, len(variants)) as advance:
        for varied in variants:
            what, value, other = varied.what, varied.value, varied.variant.case
            try:
                own = learnt(workspace, varied)
                probes = probes_of(other)
                full = varied.full_run, trade_full.sampled(own, point, probes)
                reduced = ReducedRuns(own, probes)
                runs = ExtremeRuns(own, reduced, probes, *full, point, workspace.case.trade)
                found = [runs.variant(model, what, value) for model in other.rom]
            except (UnstableError, CaseError, ResourceError) as error:
                state = FULL_UNSTABLE if isinstance(error, UnstableError) else REFUSED
                found = [
                    ExtremeRow.of(model, point, what, value, state=state, detail=str(error))
                    for model in other.rom
                ]
            yield from found
            advance(1)
