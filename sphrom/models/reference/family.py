"""The part of families that models on particles and from operators share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.metrics.measures import Probes
from sphrom.models.contract import Family, Limit
from sphrom.store.workspace import Target, Workspace


class OnReference(Family):
    """Models with modes on the points of a reference space."""

    def map_run(self, workspace: Workspace, point: ParameterPoint) -> None:
        """Map the snapshots of a full run onto the points."""
        from sphrom.models.reference.map import map_point

        map_point(workspace, point)

    def make_basis(self, workspace: Workspace) -> None:
        """Decompose the mapped snapshots."""
        from sphrom.models.reference.basis import make_basis

        make_basis(workspace)

    def fit_splines(self, workspace: Workspace) -> None:
        """Fit splines to the modes."""
        from sphrom.models.reference.splines import fit_splines

        fit_splines(workspace)

    def made_from(self, workspace: Workspace) -> list[Target]:
        """Return the artifacts of the modes."""
        return [workspace.basis(), workspace.splines()]

    def limits(
        self,
        workspace: Workspace,
        models: Sequence[ReducedModelSection],
        point: ParameterPoint,
        probes: Probes,
    ) -> Iterator[Limit]:
        """Yield the mapped snapshots, and the best states in each basis."""
        from sphrom.models.reference.limits import limits

        return limits(workspace, models, point, probes)
