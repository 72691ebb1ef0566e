"""The contract of reduced models: a family, a model at any parameters, and its runs.

A family makes its models in stages (map, basis, splines, training), and opens them. Users of models
ask for an `Ability`, and `Family.require` refuses by name each one that a family lacks; nothing
outside of a family's package depends on the kind of a model. The plan of a case names the family of
its models, and `FAMILIES` is the list of all.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property, partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from sphrom.arrays import Array
from sphrom.case.hints import beyond_training, extrapolation
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError, UnstableError
from sphrom.machine import seconds_of
from sphrom.metrics.measures import (
    Measured,
    Quantities,
    Samples,
    mean_squares,
    shares,
    variations,
)
from sphrom.sph.fluid import ROUNDING
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from sphrom.models.estimates import ErrorEstimate, Pair
    from sphrom.models.points.sensitivities import Tangents

N_TIMED = 5
"""Number of timed repetitions of a run."""
SURFACE = "surface"
"""The name of the elevation of a whole surface among measurements."""
BEST, ALONE = "best possible", "each field alone"
"""The rows of a comparison for the nearest states of a basis, and for the nearest fields."""
At = TypeVar("At")
"""A model at a parameter point, with its `start` and `output_times`."""


class Ability(Enum):
    """An ability of some families of models, which others lack."""

    RUNS_ALONE = "runs in memory, from coordinates"
    OTHER_TIMES = "runs with other final times"
    EQUATIONS = "equations of its coordinates, with rates and steady states"
    SENSITIVITIES = "derivatives of its runs with respect to parameters"
    TRAINING = "estimates of errors, from which training runs are chosen"
    EXTREMES = "maps of the ranges in which it is stable"
    MEMORY = "closures with a memory length"
    MODE_FIELDS = "modes that are fields on points"
    PORTABLE = "files that other programs run"


@dataclass(frozen=True)
class Limit:
    """A run that a model is compared with: the nearest states of its basis, or a simpler model."""

    name: str
    samples: Samples
    basis: str | None = None
    n_modes: int | None = None
    measured: Measured | None = None
    status: str = "complete"
    regime: str | None = None


def best_name(basis: str, n_modes: int) -> str:
    """Return the name of the projection of full runs onto a number of modes of a basis."""
    return f"{BEST}, {basis} M={n_modes}"


@dataclass(frozen=True)
class Family:
    """A family of reduced models, by the functions of its package."""

    kind: str
    """Its name in maps of the extremes."""
    functions: Mapping[str, str]
    """The modules and names of its functions, by their names in `part`."""
    lacks: Mapping[Ability, str]
    """The abilities that its models lack, with the reason, in which {model} is a model's name."""
    costs_alike: bool = False
    """Whether runs at all points cost the same."""

    def part(self, name: str) -> Any:
        """Return a function or class of the family, whose module is imported here.

        - `map_run(workspace, point)` writes the mapped snapshots of a full run.
        - `make_basis(workspace)` writes the bases of the training runs.
        - `fit_splines(workspace)` writes the splines of the modes.
        - `project(workspace)` writes the operators, from which models are trained.
        - `trained(workspace, section, common)` returns the content of a model's file, of which
          `common` is equal in all families; None if the model lacks necessary corrections.
        - `model(workspace, section, stored)` is a `Model`, from its file if that is `stored`.
        - `run_point(workspace, section, point)` runs a model, and writes its artifact.
        - `sized(workspace, section, basis)` returns a section with its number of modes in a basis.
        - `stored_run` is the class of its stored runs, a `StoredRun`.
        - `limits(workspace, sections, point, probes)` yields each `Limit` of the models at a point.
        - `compared(model, point, run, counted)` returns sums of squares (2,) of velocity and
          pressure over space, and over the times of a full run that `counted` chooses: of the
          errors of a run (zero if it is None), of those of the nearest states, and of the fields.
          A fourth result is a function that returns the nearest states' measurements.
        - `portable(model)` returns the arrays of a model for other programs, `mode_samples(model,
          points)` the fields of the constant part of its states and of its modes.
        - `measured_at(workspace, point)` returns measurements of a mapped full run that are not
          among those of the case.
        """
        module, _, function = self.functions[name].partition(":")
        return getattr(import_module(f"sphrom.models.{module}"), function)

    def can(self, ability: Ability) -> bool:
        """Return whether its models have an ability."""
        return ability not in self.lacks

    def require(self, ability: Ability, asked: str, model: str = "") -> None:
        """Raise CaseError that names the request if the family lacks an ability."""
        if ability in self.lacks:
            raise CaseError(f"{asked}: {self.lacks[ability].format(model=model)}")


_REFERENCE = {
    "map_run": "reference.map:map_point",
    "make_basis": "reference.basis:make_basis",
    "fit_splines": "reference.splines:fit_splines",
    "limits": "reference.limits:limits",
    "measured_at": "reference.limits:measured_at",
    "sized": "points.stored:sized",
}
"""The functions of models with modes on the points of a reference space."""
_NO_SYSTEM = (
    "{model} is evaluated on particles, so it has no equations for its coordinates; choose a "
    "model with evaluation: operators"
)
_NO_POLYNOMIAL = "is not for models of a free surface"
_NOT_PORTABLE = (
    "{model} has a free surface; only its own file, model-{model}.h5, holds its equations"
)
FAMILIES: Mapping[str, Family] = {
    "points": Family(
        kind="fast",
        functions={
            **_REFERENCE,
            "project": "points.operators:project",
            "trained": "points.training:trained_model",
            "model": "points.fast_model:FastModel",
            "run_point": "points.runs:run_point",
            "compared": "points.mapped_errors:compared",
            "stored_run": "points.runs:CoordinateRun",
            "portable": "points.portable:parts",
            "mode_samples": "points.portable:mode_samples",
        },
        lacks={},
    ),
    "particles": Family(
        kind="particles",
        functions={
            **_REFERENCE,
            "model": "particles.model:ParticleRuns",
            "run_point": "particles.runs:run_point",
            "stored_run": "stored_run:StoredRun",
        },
        lacks={
            Ability.RUNS_ALONE: _NO_SYSTEM,
            Ability.EQUATIONS: _NO_SYSTEM,
            Ability.SENSITIVITIES: _NO_SYSTEM,
            Ability.OTHER_TIMES: "needs a model on the reference points",
            Ability.TRAINING: "needs a model with evaluation: operators",
            Ability.PORTABLE: _NO_SYSTEM,
        },
        costs_alike=True,
    ),
    "surface": Family(
        kind="surface",
        functions={
            "map_run": "surface.stages:map_point",
            "make_basis": "surface.stages:make_basis",
            "fit_splines": "surface.stages:fit_splines",
            "project": "surface.stages:project",
            "trained": "surface.stages:trained_model",
            "model": "surface.model:SurfaceModel",
            "run_point": "surface.model:run_point",
            "sized": "surface.stored:sized",
            "stored_run": "surface.model:StoredSurfaceRun",
            "limits": "surface.model:limits",
            "measured_at": "surface.stored:measured_at",
            "compared": "surface.errors:compared",
        },
        lacks={
            Ability.EQUATIONS: _NO_POLYNOMIAL,
            Ability.SENSITIVITIES: _NO_POLYNOMIAL,
            Ability.EXTREMES: "has no maps of models of a free surface",
            Ability.MEMORY: "models of a free surface have no memory",
            Ability.MODE_FIELDS: "models of a free surface need no splines of modes",
            Ability.PORTABLE: _NOT_PORTABLE,
        },
    ),
}
"""The families by the name that the plan of a case gives."""


def family_of(case: Case, section: ReducedModelSection | None = None) -> Family:
    """Return the family of a model, by default that of the stages of a case."""
    return FAMILIES[case.plan.family(section)]


def model_of(workspace: Workspace, section: ReducedModelSection) -> Model[Any]:
    """Return a model of a case."""
    model: Model[Any] = family_of(workspace.case, section).part("model")(workspace, section)
    return model


def basis_used(
    workspace: Workspace, section: ReducedModelSection, point: ParameterPoint
) -> tuple[str, int]:
    """Return the name of the basis that a model uses at a point, and the number of its modes."""
    name = workspace.case.plan.basis_for(section, point)
    sized = family_of(workspace.case, section).part("sized")
    return name, sized(workspace, section, name).size


class Model(ABC, Generic[At]):
    """One reduced model, at any parameters. If training runs choose its size, its runs have that
    size."""

    def __init__(
        self, workspace: Workspace, section: ReducedModelSection, stored: Any = None
    ) -> None:
        """Take the model from the content of its file, if that is `stored`."""
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

    def runs(self, points: Sequence[ParameterPoint]) -> Iterator[ModelRun]:
        """Run the model at many points, one after the other."""
        return map(self.run, points)

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
        """Return derivatives with respect to some parameters, in steps longer by a factor.

        Only families with the ability SENSITIVITIES have it.
        """
        raise NotImplementedError

    def regime(self, point: ParameterPoint) -> str | None:
        """Return the regime of the flow at a parameter point, one of REGIMES; None if unknown."""
        return None

    def trained_differences(self, points: Sequence[ParameterPoint]) -> list[TrainedDifferences]:
        """Return the errors of training runs, for the bases of models at points.

        The list is empty if there are no estimates of errors.
        """
        return []


@dataclass(frozen=True)
class TrainedDifferences:
    """The errors of a training run that a model predicts from the others."""

    measured: dict[str, Quantities]
    """(n_snapshots, ...) measurements of the full run minus those of the model."""
    fields: Array
    """(n_snapshots, 2) root mean square errors of velocity [m/s] and pressure [Pa]."""
    missed: dict[str, Quantities]
    """(...) errors of measurements that are due to the basis, relative to the error of their
    field."""


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
    ended: str | None = None
    """The reason why the run ended early; None if it did not."""

    @property
    def name(self) -> str:
        """The name of the model and the point in messages."""
        return f"{self.model.section.name}, {self.point.label}"

    @property
    def failure(self) -> UnstableError | None:
        """The error of a run that ended early; None if it did not."""
        return None if self.ended is None else UnstableError(self.ended)

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

    @cached_property
    def regime(self) -> str | None:
        """The regime of the flow, one of REGIMES; None if the model does not know it."""
        return self.model.regime(self.point)

    @property
    def oscillations(self) -> dict[str, Quantities]:
        """The figures of oscillations (n_snapshots,), by name; NaN where the flow is steady."""
        known = self.model.workspace.case.plan.oscillations
        return known.of(self.time, self.measured, self.regime)

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
    def oscillation_errors(self) -> Mapping[str, Mapping[str, float]]:
        """The estimated errors of oscillations, by name and figure, and of the phase at the end.

        Those of oscillations without an estimate are missing.
        """
        return {}

    @property
    def measured_sizes(self) -> dict[str, Pair]:
        """Mean squares of these errors, and of the change in the run, by column of a table.

        Columns are such as `drag_force_x`, and for vectors `drag_force`. Only times since
        `from_time` are used. The second is zero for components with only noise.
        """
        found: dict[str, Pair] = {}
        plan = self.model.workspace.case.plan
        for name, each in self.measured_errors.items():
            counted = plan.counted(name, self.time)
            for quantity, error in each.items() if counted.any() else ():
                values = self.measured[name][quantity][counted]
                sizes = variations(quantity, values, with_weight=plan.with_weight)
                squares = mean_squares(quantity, error[counted])
                found |= {f"{name}_{part}": (each, sizes[part]) for part, each in squares.items()}
        return found

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
    def unlike_training(self) -> tuple[str, ...]:
        """A sentence on the distance of the run's states from all training states, if known."""
        return ()

    @property
    def doubts(self) -> tuple[str, ...]:
        """Reasons why a completed run may be wrong, as far as known without a full run."""
        return (*self.outside, *self.unlike_training)
