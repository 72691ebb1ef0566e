"""The family of models of a free surface: stream functions below an elevation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.metrics.measures import Probes
from sphrom.models.contract import SURFACE, Ability, Family, Limit, Measured
from sphrom.store.workspace import Target, Workspace

if TYPE_CHECKING:
    from sphrom.artifacts.records.runs import TrainedSurfaceModel
    from sphrom.models.surface.model import StoredSurfaceRun, SurfaceModel

NO_POLYNOMIAL = "is not for models of a free surface"


class Surface(Family):
    """Models of flows with a free surface."""

    kind = "surface"
    lacks: ClassVar[Mapping[Ability, str]] = {
        Ability.EQUATIONS: NO_POLYNOMIAL,
        Ability.SENSITIVITIES: NO_POLYNOMIAL,
        Ability.TRAINING: "needs estimates of errors, which models of a free surface don't have; "
        "list the runs to train on in parameters.train",
        Ability.EXTREMES: "maps no models of a free surface",
        Ability.MEMORY: "models of a free surface have no memory",
        Ability.MODE_FIELDS: "models of a free surface need no splines of modes",
    }

    def map_run(self, workspace: Workspace, point: ParameterPoint) -> None:
        """Fit stream functions and elevations to the snapshots of a full run."""
        from sphrom.models.surface.stages import map_point

        map_point(workspace, point)

    def make_basis(self, workspace: Workspace) -> None:
        """Write the basis of the training runs."""
        from sphrom.models.surface.stages import make_basis

        make_basis(workspace)

    def fit_splines(self, workspace: Workspace) -> None:
        """Say that there is nothing to do: stream functions are splines."""
        workspace.context.report.info(self.lacks[Ability.MODE_FIELDS])

    def project(self, workspace: Workspace) -> None:
        """Train models of all numbers of modes that the case's models have."""
        from sphrom.models.surface.stages import project

        project(workspace)

    def trained(
        self, workspace: Workspace, section: ReducedModelSection, common: Mapping[str, Any]
    ) -> TrainedSurfaceModel:
        """Return a trained model."""
        from sphrom.artifacts.records.runs import TrainedSurfaceModel

        model = self.model(workspace, section)
        return TrainedSurfaceModel(basis=model.basis, graph=model.trained, **common)

    def model(
        self,
        workspace: Workspace,
        section: ReducedModelSection,
        stored: TrainedSurfaceModel | None = None,
    ) -> SurfaceModel:
        """Return a model, from its file if that is `stored`."""
        from sphrom.models.surface.model import SurfaceModel

        if stored is None:
            workspace.require(workspace.operators())
        return SurfaceModel(workspace, section, stored)

    def run_point(
        self, workspace: Workspace, section: ReducedModelSection, point: ParameterPoint
    ) -> None:
        """Run a model at a parameter point, and write its artifact."""
        from sphrom.models.surface.model import run_point

        run_point(workspace, section, point)

    def sized(
        self, workspace: Workspace, section: ReducedModelSection, basis: str
    ) -> ReducedModelSection:
        """Return a model with its number of modes, those of noise left out."""
        from sphrom.models.surface.stored import trained_size

        size = trained_size(workspace, section).n_modes
        return section.model_copy(update={"n_modes": size})

    def made_from(self, workspace: Workspace) -> list[Target]:
        """Return the artifacts of the modes and of the trained models."""
        return [workspace.basis(), workspace.operators()]

    def stored_run(self) -> type[StoredSurfaceRun]:
        """Return the class of its stored runs."""
        from sphrom.models.surface.model import StoredSurfaceRun

        return StoredSurfaceRun

    def limits(
        self,
        workspace: Workspace,
        models: Sequence[ReducedModelSection],
        point: ParameterPoint,
        probes: Probes,
    ) -> Iterator[Limit]:
        """Yield the nearest states of each basis, and runs of models that are not calibrated."""
        from sphrom.models.surface.model import limits

        return limits(workspace, models, point, probes)

    def measured_at(self, workspace: Workspace, point: ParameterPoint) -> Measured:
        """Return the elevation of the whole surface in a mapped full run."""
        with workspace.open(workspace.mapped(point)) as mapped:
            return {SURFACE: {"elevation": mapped.read("elevation")}}


FAMILY = Surface()
