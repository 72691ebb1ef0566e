"""The artifacts that a trade's reduced models are made from: the case's, or others beside them.

A trade may weigh models that the case has no operators for, or none in that inner product. Their
artifacts lie in the trade's own folder, and are kept there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from sphrom.case.models import Case
from sphrom.case.sections import ReducedModelSection
from sphrom.offline import fit_psi, operators, pod
from sphrom.setup.context import StageContext
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
    if not any(model.from_operators for model in models):
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
