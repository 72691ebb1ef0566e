"""`trade --extremes`: where models on the reference points are stable, and accurate.

Time steps are varied at Reynolds numbers in and out of training. At the greatest trained one the
memory length of models with the closure is varied too, and so are the full model's Mach number and
smoothing length, each value with artifacts of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from sphrom.case.models import Case
from sphrom.case.plan import basis_size, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ALL, ReducedModelSection
from sphrom.case.trade_checks import coarser_resolution
from sphrom.errors import CaseError, ResourceError, SphromError, UnstableError
from sphrom.setup.context import StageContext
from sphrom.store.sampling import Probes, probes_of
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
from sphrom.trade.full import Variant
from sphrom.trade.models import prepared
from sphrom.trade.runs import ReducedRuns
from sphrom.trade.stability import FULL_UNSTABLE, REFUSED, ExtremeRow, publish
from sphrom.trade.sweeps import Sweep, Truth
from sphrom.trade.variants import Varied, describe, learnt, varied_models

SIZES = (2, 3, 5, 8, 12, 20, 30, 50)
"""Modes that are tried where a case doesn't say, as far as the basis goes."""


def run(context: StageContext) -> None:
    """Run models over their extremes, and write a table and a picture of how they fared."""
    case = context.case
    if "operators" not in case.trade.evaluations:
        raise CaseError(
            "trade.evaluations: stability is mapped of models with operators; list operators"
        )
    models = _Models.of(case)
    workspace = prepared(context, case.basis.inner_product, [*models.varied, *models.closed])
    points = context.chosen(extreme_points(case))
    rows = _in_the_case(workspace, models, points)
    notes: list[str] = []
    if _top(case) in points:
        further, notes = _further(workspace, models)
        rows += further
    publish(workspace, rows, notes)


@dataclass(frozen=True)
class _Models:
    """The reduced models whose stability is mapped."""

    varied: tuple[ReducedModelSection, ...]
    """Galerkin, of all sizes."""
    closed: tuple[ReducedModelSection, ...]
    """With the closure, where its memory length is varied."""

    @classmethod
    def of(cls, case: Case) -> _Models:
        """Return those of a case."""
        available = basis_size(case, global_basis(case))
        sizes = case.trade.extremes.n_modes or default_sizes(available, SIZES)
        closed = [n for n in sizes if n <= MOST_CLOSED_MODES and case.trade.extremes.memory_factors]
        return cls(
            tuple(_model(case, n, "galerkin") for n in sizes),
            tuple(_model(case, n, "apg") for n in closed),
        )


def _model(case: Case, n_modes: int, projection: Projection) -> ReducedModelSection:
    asked = case.trade.extremes.calibrated
    calibrated = has_calibrated(case) if asked is None else asked
    return ReducedModelSection(
        name=f"extreme-{projection}-{n_modes}",
        evaluation="operators",
        projection=projection,
        n_modes=n_modes,
        basis=global_basis(case),
        calibrated=calibrated and projection == "galerkin",
    )


def _top(case: Case) -> ParameterPoint:
    """Return where more than steps is varied: the greatest trained value."""
    return max(case.bases[global_basis(case)], key=lambda point: point.reynolds)


def _in_the_case(
    workspace: Workspace, models: _Models, points: Sequence[ParameterPoint]
) -> list[ExtremeRow]:
    """Return the rows of models that are made from the case's artifacts."""
    case = workspace.case
    probes, runs = probes_of(case), ReducedRuns(workspace, probes_of(case))
    truths = _truths(workspace, points, probes)
    rows: list[ExtremeRow] = []
    total = len(points) * len(models.varied)
    with workspace.context.report.progress("extremes", total) as advance:
        for point in points:
            sweep = Sweep(workspace, runs, probes, truths[point], point, case.trade)
            for model in models.varied:
                rows += sweep.steps(model)
                advance(1)
            if point == _top(case):
                rows += [row for model in models.closed for row in sweep.memory_lengths(model)]
    return rows


def _truths(
    workspace: Workspace, points: Sequence[ParameterPoint], probes: Probes
) -> dict[ParameterPoint, Truth]:
    """Return what to hold runs against: the case's full runs, coarser ones, or nothing."""
    case = workspace.case
    missing = [point for point in points if point not in case.points]
    truths = {
        point: Truth("full run", trade_full.sampled(workspace, point, probes))
        for point in points
        if point in case.points
    }
    if not missing or case.time.spin_up > 0.0 or not case.trade.extremes.full_runs:
        return truths | {point: Truth("", None) for point in missing}
    resolution = coarser_resolution(case) or case.discretization.resolution
    for point in missing:
        truths[point] = _coarse_truth(workspace, point, resolution, probes)
    return truths


def _coarse_truth(
    workspace: Workspace, point: ParameterPoint, resolution: int, probes: Probes
) -> Truth:
    """Make a full run at a value that the case doesn't have."""
    case = workspace.case
    # Its own step: viscosity may allow less than at the case's values.
    train = case.parameters.train.model_copy(update={"reynolds": (point.reynolds,)})
    test = case.parameters.test.model_copy(update={"reynolds": ()})
    alone = case.parameters.model_copy(update={"train": train, "test": test})
    basis = case.basis.model_copy(update={"subsets": {}})
    other = case.model_copy(update={"parameters": alone, "basis": basis})
    variant = trade_full.with_steps(other, resolution, case.time.courant_number, step_plan(case))
    variant = Variant(f"extreme-{resolution}-{point.file_label}", variant.case)
    made = trade_full.workspace_of(workspace, variant)
    problem = trade_full.make(made, [point])[point]
    if problem is not None:
        workspace.context.report.warn(f"{variant.label}, {point.label}: {problem}")
        return Truth("", None)
    return Truth(f"full run, {resolution} across", trade_full.sampled(made, point, probes))


def _further(workspace: Workspace, models: _Models) -> tuple[list[ExtremeRow], list[str]]:
    """Return the rows of models of varied full ones, and what there is to say of them."""
    case = workspace.case
    variants = varied_models(case, [_of_all(model) for model in models.varied])
    if not variants:
        return [], []
    if case.time.spin_up > 0.0 or not case.trade.extremes.full_runs:
        why = "a spin-up" if case.time.spin_up > 0.0 else "trade.extremes.full_runs: false"
        return [], [f"with {why}, Mach number and h/dx are not varied: they need full runs"]
    rows: list[ExtremeRow] = []
    text = "Mach numbers and smoothing lengths"
    with workspace.context.report.progress(text, len(variants)) as advance:
        for varied in variants:
            rows += _of_variant(workspace, varied)
            advance(1)
    return rows, [describe(variants)]


def _of_all(model: ReducedModelSection) -> ReducedModelSection:
    """Return a model as a variant has it, whose runs are those that its basis learns from."""
    return model.model_copy(update={"basis": ALL})


def _of_variant(workspace: Workspace, varied: Varied) -> list[ExtremeRow]:
    """Return the rows of the models of a varied full model; that there are none stops nothing."""
    case, other = workspace.case, varied.variant.case
    point = _top(case)
    try:
        own = learnt(workspace, varied)
        probes = probes_of(other)
        name = f"full run, {other.discretization.resolution} across"
        truth = Truth(name, trade_full.sampled(own, point, probes))
        sweep = Sweep(own, ReducedRuns(own, probes), probes, truth, point, case.trade)
        return [sweep.variant(model, varied.what, varied.value) for model in other.rom]
    except (UnstableError, CaseError, ResourceError) as error:
        return [_failed(point, model, varied, error) for model in other.rom]


def _failed(
    point: ParameterPoint, model: ReducedModelSection, varied: Varied, error: SphromError
) -> ExtremeRow:
    """Return the row of a model that there is none of."""
    return ExtremeRow(
        parameters=point.label,
        varied=varied.what,
        value=varied.value,
        n_modes=model.n_modes,
        projection=model.projection,
        calibrated=model.calibrated,
        state=FULL_UNSTABLE if isinstance(error, UnstableError) else REFUSED,
        detail=str(error),
    )
