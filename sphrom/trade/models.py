"""The artifacts that a trade's reduced models are made from: the case's, or others beside them.

A trade may weigh models that the case has no operators for, or none in that inner product. Their
artifacts lie in the trade's own folder, and are kept there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.compare.timings import is_imported, known_seconds
from sphrom.offline import fit_psi, operators, pod
from sphrom.setup.context import StageContext
from sphrom.store.operators import memory_timing
from sphrom.store.targets import Target
from sphrom.store.workspace import Workspace
from sphrom.trade.full import own_context
from sphrom.trade.report import FOLDER


def prepared(
    context: StageContext, inner_product: str, models: Sequence[ReducedModelSection]
) -> Workspace:
    """Return a workspace whose artifacts reduced models of a case can be made from.

    The workspace's case includes these models. Operators are projected where the case's lack some,
    and bases are made where the inner product is another.

    Raises ArtifactError when artifacts of the case are missing.
    """
    extended = context.case.model_copy(update={"rom": (*context.case.rom, *models)})
    if inner_product != context.case.basis.inner_product:
        return _in_product(context, extended, inner_product)
    workspace = Workspace(context)
    for target in (workspace.basis(), workspace.splines()):
        workspace.require(target)
    wider = replace(context, case=extended)
    if not any(model.on_points for model in models):
        return Workspace(wider)
    if not _same_operators(extended, context.case):
        wider = replace(wider, folders={"operators": context.out / FOLDER})
        operators.run(own_context(wider))
    workspace = Workspace(wider)
    workspace.require(workspace.operators())
    return workspace


def _same_operators(first: Case, second: Case) -> bool:
    return all(
        getattr(first, part) == getattr(second, part)
        for part in ("reference_bases", "memory_models", "taught_bases")
    )


def _in_product(context: StageContext, case: Case, inner_product: str) -> Workspace:
    """Return a workspace with bases, splines and operators in another inner product."""
    section = case.basis.model_copy(update={"inner_product": inner_product})
    case = case.model_copy(update={"basis": section})
    place = context.out / FOLDER / inner_product
    folders: dict[str, Path] = dict.fromkeys(("basis", "spline", "operators"), place)
    context = replace(context, case=case, folders=folders)
    for stage in (pod, fit_psi, operators):
        stage.run(own_context(context))
    return Workspace(context)


def offline_seconds(
    workspace: Workspace, model: ReducedModelSection, points: Iterable[ParameterPoint]
) -> tuple[float | None, float | None]:
    """Return the cost of making a reduced model [s]: all of it, and the full runs it learns from.

    Spin-ups and packing count; the closures of other models, in the same artifact, don't. None
    where nobody knows, as the cost of an imported run is unknown.
    """
    case = workspace.case
    names = {case.basis_for(model, point): None for point in points}
    trained = {point: None for name in names for point in case.bases[name]}
    runs: dict[Path, Target] = {}
    for point in trained:
        _collect(workspace.full_run(point), runs)
    spent = [_full_seconds(workspace, run) for run in runs.values()]
    known = [seconds for seconds in spent if seconds is not None]
    if len(known) < len(spent):
        return None, None
    training = sum(known)
    stages = [workspace.mapped(point) for point in trained]
    stages += [workspace.basis(), workspace.splines()]
    offline = training + sum(_wall_seconds(workspace, stage) for stage in stages)
    if model.on_points:
        offline += _operator_seconds(workspace, model, names)
    return offline, training


def _collect(target: Target, found: dict[Path, Target]) -> None:
    """Add a target and all that it is made from."""
    found[target.path] = target
    for parent in target.parents.values():
        _collect(parent, found)


def _operator_seconds(
    workspace: Workspace, model: ReducedModelSection, names: Iterable[str]
) -> float:
    closures = workspace.case.memory_models
    own = [(name, model.n_modes) for name in names if model.projection == "apg"]
    with workspace.open(workspace.operators()) as artifact:
        others = [
            artifact.number(memory_timing(*closure)) for closure in closures if closure not in own
        ]
        return artifact.number("wall_seconds") - sum(others)


def _full_seconds(workspace: Workspace, target: Target) -> float | None:
    """Return the cost of a full run, or of an artifact it is made from [s]; None if unknown."""
    with workspace.open(target) as artifact:
        if is_imported(artifact):
            return known_seconds(artifact)
        return artifact.number("wall_seconds")


def _wall_seconds(workspace: Workspace, target: Target) -> float:
    with workspace.open(target) as artifact:
        return artifact.number("wall_seconds")
