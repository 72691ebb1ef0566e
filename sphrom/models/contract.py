"""What a reduced model is: a family of models, a model at any parameters, and its runs.

A family makes its models in stages (map, basis, splines, training), and opens them. Users of models
ask for an `Ability`, and `Family.require` refuses by name what a family lacks; nothing outside of a
family's room depends on the kind of a model. The plan of a case names the family of its models.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

from sphrom.arrays import Array
from sphrom.case.hints import beyond_training, extrapolation
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import CaseError, UnstableError
from sphrom.machine import seconds_of
from sphrom.metrics.measures import Probes, Quantities, Samples, shares
from sphrom.sph.fluid import ROUNDING
from sphrom.store.workspace import Target, Workspace

if TYPE_CHECKING:
    from sphrom.artifacts.records.runs import ModelFile
    from sphrom.models.points.error_estimates import ErrorEstimate, Pair
    from sphrom.models.points.sensitivities import Tangents
    from sphrom.models.stored_run import StoredRun

FAMILIES = {
    "points": "sphrom.models.points.family",
    "particles": "sphrom.models.particles.family",
    "surface": "sphrom.models.surface.family",
}
"""The rooms of the families, by the name that a case's plan gives. A room is imported when it is
first used, and has its `FAMILY`."""
N_TIMED = 5
"""Number of timed repetitions of a run."""
SURFACE = "surface"
"""The name of the elevation of a whole surface among measurements."""
Measured = Mapping[str, Quantities]
"""Quantities (n_snapshots, ...) of measurements, by the name of the measurement."""
BEST, ALONE = "best possible", "each field alone"
"""The rows of a comparison for the nearest states of a basis, and for the nearest fields."""
At = TypeVar("At")
"""A model at a parameter point, with its `start` and `output_times`."""


class Ability(Enum):
    """What some families of models can do, and others cannot."""

    RUNS_ALONE = "runs in memory, from coordinates"
    OTHER_TIMES = "runs with other final times"
    EQUATIONS = "equations of its coordinates, with rates and steady states"
    SENSITIVITIES = "derivatives of its runs by parameters"
    TRAINING = "estimates of errors, from which training runs are chosen"
    EXTREMES = "maps of the ranges in which it is stable"
    MEMORY = "closures with a memory length"
    MODE_FIELDS = "modes that are fields on points"


@dataclass(frozen=True)
class Limit:
    """A run that a model is compared with: the nearest states of its basis, or a simpler model."""

    name: str
    samples: Samples
    basis: str | None = None
    n_modes: int | None = None
    measured: Measured | None = None
    status: str = "complete"


def best_name(basis: str, n_modes: int) -> str:
    """Return the name of the projection of full runs onto so many modes of a basis."""
    return f"{BEST}, {basis} M={n_modes}"


class Family(ABC):
    """A family of reduced models: the stages that make them, and the models themselves."""

    lacks: ClassVar[Mapping[Ability, str]]
    """The abilities that its models lack, with the reason, in which {model} is a model's name."""
    kind: ClassVar[str]
    """Its name in maps of the extremes."""
    costs_alike: ClassVar[bool] = False
    """Whether runs at all points cost the same."""

    @property
    def abilities(self) -> frozenset[Ability]:
        """What its models can do."""
        return frozenset(set(Ability).difference(self.lacks))

    def require(self, ability: Ability, asked: str, model: str = "") -> None:
        """Raise CaseError that names what was asked for if the family lacks an ability."""
        if ability in self.lacks:
            raise CaseError(f"{asked}: {self.lacks[ability].format(model=model)}")

    @abstractmethod
    def map_run(self, workspace: Workspace, point: ParameterPoint) -> None:
        """Write the mapped snapshots of a full run."""

    @abstractmethod
    def make_basis(self, workspace: Workspace) -> None:
        """Write the bases of the training runs."""

    @abstractmethod
    def fit_splines(self, workspace: Workspace) -> None:
        """Write the splines of the modes."""

    @abstractmethod
    def project(self, workspace: Workspace) -> None:
        """Write the artifact of operators, from which models are trained."""

    @abstractmethod
    def trained(
        self, workspace: Workspace, section: ReducedModelSection, common: Mapping[str, Any]
    ) -> ModelFile | None:
        """Return the content of a trained model's file, of which `common` is equal in all families.

        None if the model lacks necessary corrections; its runs then report why.
        """

    @abstractmethod
    def model(
        self, workspace: Workspace, section: ReducedModelSection, stored: Any = None
    ) -> Model[Any]:
        """Return a model, from its file if that is `stored`."""

    @abstractmethod
    def run_point(
        self, workspace: Workspace, section: ReducedModelSection, point: ParameterPoint
    ) -> None:
        """Run a model at a parameter point, and write its artifact."""

    @abstractmethod
    def sized(
        self, workspace: Workspace, section: ReducedModelSection, basis: str
    ) -> ReducedModelSection:
        """Return a model with its number of modes in a basis, chosen by training runs if auto."""

    @abstractmethod
    def made_from(self, workspace: Workspace) -> list[Target]:
        """Return the artifacts of all training runs from which models are made."""

    @abstractmethod
    def stored_run(self) -> type[StoredRun]:
        """Return the class of its stored runs."""

    @abstractmethod
    def limits(
        self,
        workspace: Workspace,
        models: Sequence[ReducedModelSection],
        point: ParameterPoint,
        probes: Probes,
    ) -> Iterator[Limit]:
        """Yield what models at a point are compared with, besides the full run."""

    def measured_at(self, workspace: Workspace, point: ParameterPoint) -> Measured:
        """Return measurements of a mapped full run that are not among those of the case."""
        return {}

    def others_seconds(
        self, workspace: Workspace, section: ReducedModelSection, bases: Sequence[str]
    ) -> float:
        """Return the share of other models in the cost of a model's artifacts [s]."""
        return 0.0


def family_of(case: Case, section: ReducedModelSection | None = None) -> Family:
    """Return the family of a model, by default that of the stages of a case."""
    family: Family = import_module(FAMILIES[case.plan.family(section)]).FAMILY
    return family


def model_of(workspace: Workspace, section: ReducedModelSection) -> Model[Any]:
    """Return a model of a case."""
    return family_of(workspace.case, section).model(workspace, section)


def basis_used(
    workspace: Workspace, section: ReducedModelSection, point: ParameterPoint
) -> tuple[str, int]:
    """Return the name of the basis that a model uses at a point, and the number of its modes."""
    name = workspace.case.plan.basis_for(section, point)
    return name, family_of(workspace.case, section).sized(workspace, section, name).size


class Model(ABC, Generic[At]):
    """One reduced model, at any parameters. If training runs choose its size, runs know it."""

    def __init__(self, workspace: Workspace, section: ReducedModelSection) -> None:
        self.workspace = workspace
        self.section = section

    @property
    def family(self) -> Family:
        """The family of the model."""
        return family_of(self.workspace.case, self.section)

    def basis_at(self, point: ParameterPoint) -> str:
        """Return the name of the model's basis at a parameter point."""
        return self.workspace.case.plan.basis_for(self.section, point)

    @abstractmethod
    def at(self, point: ParameterPoint) -> At:
        """Return the model at a parameter point."""

    @abstractmethod
    def run(self, point: ParameterPoint, reduced: At | None = None) -> ModelRun:
        """Run the model at a parameter point; `reduced` may have other output times."""

    def runner(self, point: ParameterPoint) -> Callable[[], object]:
        """Return a function that makes one run at a parameter point, without preparing it."""
        return partial(self.run, point, self.at(point))

    def timed(self, point: ParameterPoint, repeats: int) -> tuple[ModelRun, float]:
        """Return a run, and the least time that some took [s]."""
        run = self.run(point)
        return run, min(seconds_of(self.runner(point)) for _ in range(repeats))

    def timer(self, point: ParameterPoint, step: float) -> Callable[[], float]:
        """Return a function that measures the seconds of a run in steps [s] as in its artifact."""
        return partial(seconds_of, self.runner(point))

    def tangents(
        self, point: ParameterPoint, names: Sequence[str], reduced: At, step_factor: float = 1.0
    ) -> Tangents:
        """Return the derivatives of a run by some parameters, in steps longer by a factor."""
        raise NotImplementedError

    def measures(self, reduced: At, time: Array, coordinates: Array) -> dict[str, Quantities]:
        """Return the measurements of states (n_states, n_modes) at times (n_states,) [s]."""
        raise NotImplementedError

    def trained_differences(
        self, points: Sequence[ParameterPoint]
    ) -> list[tuple[Array, dict[str, Quantities]]]:
        """Return the places and the errors of training runs, for the bases of models at points.

        The errors are measurements of full runs less those of the model. The list is empty if
        there are no estimates of errors.
        """
        return []


@dataclass(frozen=True, kw_only=True)
class ModelRun(ABC):
    """A run of a model, and the model that made it."""

    model: Model[Any]
    """The model at any parameter point."""
    point: ParameterPoint
    reduced: Any
    """The model at the point."""
    time: Array
    """(n_snapshots,) [s]."""
    coordinates: Array
    """(n_snapshots, n_modes)."""
    time_step: float
    """[s]."""
    correction: Array | None = None
    """(n_snapshots, n_modes) part of the coordinates that training runs add, if there is one."""

    @property
    def name(self) -> str:
        """The name of the model and the point in messages."""
        return f"{self.model.section.name}, {self.point.label}"

    @property
    @abstractmethod
    def failure(self) -> UnstableError | None:
        """Why the run ended early; None if it did not."""

    @property
    @abstractmethod
    def kinetic_energy(self) -> Array:
        """The kinetic energy (n_snapshots,) [J/m]."""

    @property
    @abstractmethod
    def largest_speed(self) -> float:
        """The largest speed of all points and snapshots [m/s]."""

    @property
    @abstractmethod
    def measured(self) -> dict[str, Quantities]:
        """All measurements of the case (n_snapshots, ...), by name and quantity."""

    @abstractmethod
    def sampled(self, points: Array) -> Samples:
        """Return velocity and pressure at points (n_points, 2) [m]."""

    @property
    def estimate(self) -> ErrorEstimate | None:
        """The estimated errors of the run; None if there are no estimates."""
        return None

    @property
    def measured_errors(self) -> Mapping[str, Quantities]:
        """The estimated errors of all measurements (n_snapshots, ...); empty without estimates."""
        return {}

    @property
    def measured_sizes(self) -> dict[str, Pair]:
        """Mean squares of these errors, and of the change in the run, by column of a table."""
        return {}

    @property
    def measured_shares(self) -> dict[str, float | None]:
        """The same errors over the changes [%]; None for a column with only noise."""
        pairs = self.measured_sizes.items()
        return shares({n: square for n, (square, _) in pairs}, {n: size for n, (_, size) in pairs})

    @cached_property
    def outside(self) -> tuple[str, ...]:
        """Warnings about a run outside the trained parameters, or longer than training runs."""
        case = self.model.workspace.case
        trained = case.plan.steps.end_time
        is_longer = self.time[-1] > trained * (1.0 + ROUNDING)
        texts = extrapolation(case, self.point), beyond_training(trained) if is_longer else None
        return tuple(text for text in texts if text is not None)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why a completed run may be wrong, as far as is known without a full run."""
        return self.outside
