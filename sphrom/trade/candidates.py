"""The reduced models of a trade, of several sizes.

A trade may include models for which the case has no operators. Their operators are kept in the
trade's own folder.
"""

from __future__ import annotations

from collections.abc import Sequence

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ALL, LOCAL, ReducedModelSection
from sphrom.case.studies import changed
from sphrom.errors import CaseError
from sphrom.offline import operators
from sphrom.setup.context import StageContext
from sphrom.store.variants import Variant
from sphrom.store.workspace import Workspace

FOLDER = "trade"
"""Folder of a trade, within that of the case's artifacts."""
SIZES = (2, 5, 10, 20, 50)
"""Default numbers of modes, up to the size of the basis."""
MOST_CLOSED_MODES = 20
"""Default limit of the modes of APG, whose cost grows with their fourth power."""
OPERATORS = ("operators", "surface-operators")
"""Kinds of artifacts that the models of a trade have of their own."""


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
    if (largest := max(listed or (0,))) > available:
        raise CaseError(f"trade.n_modes: the basis {basis} has {available} modes; got {largest}")
    ends = {"galerkin": available}
    # The closure has operators for the viscosity only.
    if not (case.plan.driving or case.scene.has_surface):
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
            sections.append(ReducedModelSection.model_validate(keys))
    return sections


def prepared(context: StageContext, models: Sequence[ReducedModelSection]) -> Workspace:
    """Return a workspace whose case includes the models, and has their operators.

    Operators that the case lacks are projected. Raises ArtifactError when artifacts are missing.
    """
    case = context.case
    workspace = Workspace(context)
    workspace.require(workspace.basis())
    if not case.scene.has_surface:
        workspace.require(workspace.splines())
    wider = changed(case, rom=(*case.rom, *models))
    parts = ("reference_bases", "memory_models", "corrected_bases", "surface_sizes")
    if any(getattr(wider.plan, part) != getattr(case.plan, part) for part in parts):
        return Variant(context, wider, FOLDER, only=OPERATORS).made([operators.run])
    workspace = Variant(context, wider).workspace
    workspace.require(workspace.operators())
    return workspace
