"""The family of models from operators: polynomials of the coordinates, without particles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.models.contract import Ability
from sphrom.models.reference.family import OnReference
from sphrom.store.workspace import Target, Workspace

if TYPE_CHECKING:
    from sphrom.artifacts.records.reduced_models import TrainedModel
    from sphrom.models.points.fast_model import FastModel
    from sphrom.models.points.runs import CoordinateRun


class Points(OnReference):
    """Models from operators on the reference points."""

    kind = "fast"
    lacks: ClassVar[Mapping[Ability, str]] = {}

    def project(self, workspace: Workspace) -> None:
        """Project the operators onto every basis."""
        from sphrom.models.points.operators import project

        project(workspace)

    def trained(
        self, workspace: Workspace, section: ReducedModelSection, common: Mapping[str, Any]
    ) -> TrainedModel | None:
        """Return a model trained with all its bases."""
        from sphrom.models.points.training import trained_model

        return trained_model(workspace, section, common)

    def model(
        self,
        workspace: Workspace,
        section: ReducedModelSection,
        stored: TrainedModel | None = None,
    ) -> FastModel:
        """Return a model, from its file if that is `stored`."""
        from sphrom.models.points.fast_model import FastModel

        if stored is None:
            workspace.require(workspace.operators())
        return FastModel(workspace, section, stored)

    def run_point(
        self, workspace: Workspace, section: ReducedModelSection, point: ParameterPoint
    ) -> None:
        """Run a model at a parameter point, and write its artifact."""
        from sphrom.models.points.runs import run_point

        run_point(workspace, section, point)

    def sized(
        self, workspace: Workspace, section: ReducedModelSection, basis: str
    ) -> ReducedModelSection:
        """Return a model with its number of modes in a basis."""
        from sphrom.models.points.stored import sized

        return sized(workspace, section, basis)

    def made_from(self, workspace: Workspace) -> list[Target]:
        """Return the artifacts of the modes, and the operators."""
        return [*super().made_from(workspace), workspace.operators()]

    def stored_run(self) -> type[CoordinateRun]:
        """Return the class of its stored runs."""
        from sphrom.models.points.runs import CoordinateRun

        return CoordinateRun

    def others_seconds(
        self, workspace: Workspace, section: ReducedModelSection, bases: Sequence[str]
    ) -> float:
        """Return the time that closures of other models took [s]."""
        from sphrom.models.points.stored import memory_timing

        own = [(name, section.size) for name in bases if section.projection == "apg"]
        with workspace.open(workspace.operators()) as artifact:
            return sum(
                artifact.number(memory_timing(*closure))
                for closure in workspace.case.plan.memory_models
                if closure not in own
            )


FAMILY = Points()
