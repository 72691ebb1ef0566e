"""What the reduced models of a trade are made from: the case's artifacts, or others beside them.

A trade may weigh models that the case has no operators for, or none in that inner product. What
they need lies in its own folder, and is kept there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.compare.timings import known_seconds
from sphrom.exchange.import_ import STAGE as IMPORT
from sphrom.offline import fit_psi, operators, pod
from sphrom.setup.context import StageContext
from sphrom.store.operators import memory_timing
from sphrom.store.workspace import Target, Workspace
from sphrom.trade.full import own_context

FOLDER = "trade"
"""Of a trade, below that of the case's artifacts."""


def prepared(
    context: StageContext, inner_product: str, models: Sequence[ReducedModelSection]
) -> Workspace:
    """Return a workspace whose artifacts reduced models of a case can be made from.

    Its case has those models too. Operators are projected where the case's lack some, and bases
    made where they are in another inner product.

    Raises ArtifactError when artifacts of the case are missing.
    """
    extended = with_models(context.case, models)
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


def with_models(case: Case, models: Sequence[ReducedModelSection]) -> Case:
    """Return a case that has further reduced models."""
    return case.model_copy(update={"rom": (*case.rom, *models)})


def _same_operators(first: Case, second: Case) -> bool:
    def held(case: Case) -> tuple[object, ...]:
        return case.reference_bases, case.memory_models, case.calibrated_bases

    return held(first) == held(second)


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
    """Return what a reduced model costs once [s]: all of it, and the full runs it learns from.

    Spin-ups and packing count; the closures of other models, in the same artifact, don't. None
    where nobody knows, as an imported run doesn't tell what it cost.
    """
    case = workspace.case
    names = {case.basis_for(model, point): None for point in points}
    trained = {point: None for name in names for point in case.bases[name]}
    runs: dict[Path, Target] = {}
    for point in trained:
        _collect(workspace.full_run(point), runs)
    spent = [_training_seconds(workspace, run) for run in runs.values()]
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


def _training_seconds(workspace: Workspace, target: Target) -> float | None:
    """Return what a full run cost, or what it is made from [s]; None where nobody knows."""
    with workspace.open(target) as artifact:
        imported = artifact.text("stage") == IMPORT
        return known_seconds(artifact) if imported else artifact.number("wall_seconds")


def _wall_seconds(workspace: Workspace, target: Target) -> float:
    with workspace.open(target) as artifact:
        return artifact.number("wall_seconds")
