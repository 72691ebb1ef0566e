"""The family of models on moving particles, whose rates are sums over them (Alg. 3.4-3.5)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.models.contract import Ability
from sphrom.models.reference.family import OnReference
from sphrom.models.stored_run import StoredRun
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from sphrom.models.particles.model import ParticleRuns

NO_SYSTEM = (
    "{model} is evaluated on particles, so it is no system of equations for its coordinates; "
    "choose a model with evaluation: operators"
)


class Particles(OnReference):
    """Models on moving particles."""

    kind = "particles"
    lacks: ClassVar[Mapping[Ability, str]] = {
        Ability.RUNS_ALONE: NO_SYSTEM,
        Ability.EQUATIONS: NO_SYSTEM,
        Ability.SENSITIVITIES: NO_SYSTEM,
        Ability.OTHER_TIMES: "needs a model on the reference points",
        Ability.TRAINING: "needs a model with evaluation: operators",
    }
    costs_alike = True

    def project(self, workspace: Workspace) -> None:
        """Do nothing: sums over particles are their rates."""

    def trained(
        self, workspace: Workspace, section: ReducedModelSection, common: Mapping[str, Any]
    ) -> None:
        """Return nothing: a model needs its particles."""

    def model(
        self, workspace: Workspace, section: ReducedModelSection, stored: None = None
    ) -> ParticleRuns:
        """Return a model."""
        from sphrom.models.particles.model import ParticleRuns

        return ParticleRuns(workspace, section)

    def run_point(
        self, workspace: Workspace, section: ReducedModelSection, point: ParameterPoint
    ) -> None:
        """Run a model at a parameter point, and write its artifact."""
        from sphrom.models.particles.runs import run_point

        run_point(workspace, section, point)

    def sized(
        self, workspace: Workspace, section: ReducedModelSection, basis: str
    ) -> ReducedModelSection:
        """Return the model, which always has a number of modes."""
        return section

    def stored_run(self) -> type[StoredRun]:
        """Return the class of its stored runs, which have particles."""
        return StoredRun


FAMILY = Particles()
