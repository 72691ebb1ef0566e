"""The families of reduced models, one section class each, with only the keys that apply to it.

`MODELS` lists all families. `evaluation` chooses one, and so does a free surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from sphrom.case.fields import (
    Duration,
    Flag,
    OneOf,
    Positive,
    SafeName,
    Section,
    Whole,
    key,
)
from sphrom.case.points import Listed

ProjectionName = Literal["galerkin", "apg"]
PROJECTIONS: dict[str, str] = {"galerkin": "Galerkin", "apg": "APG"}
"""The names of projections in tables and pictures."""

ALL = "all"
"""The name of the basis of all training runs."""
AUTO: Final = "auto"
"""The value of keys that the program chooses."""
LOCAL = "local"
"""The name, in a reduced model, of the basis whose interval contains the parameter point."""
ROWS = ("full", "map", "exact")
"""Rows of the comparison, whose names reduced models can't have."""
BEST = "best"
"""Prefix of the names of further such rows."""


class ReducedModelSection(Section):
    """One reduced model; the base class of all families.

    A family has the keys that apply to it. The values of all other keys are constants of its class.
    """

    # Built when a case first has one.
    model_config = ConfigDict(defer_build=True)

    family: ClassVar[Literal["particles", "points", "surface"]]
    refusal: ClassVar[str]
    """Why it has no key of other families."""

    name: SafeName = key(..., "name of the model in files and tables")
    n_modes: Annotated[Whole, Field(ge=1, le=10_000)] | Literal["auto"] = key(
        5,
        "number of modes; auto, for evaluation: operators, chooses the fewest that predict "
        "held-out training runs best, up to basis.n_modes, by default 20",
    )
    basis: SafeName = key(
        ALL,
        "its basis: all, one of basis.subsets, or local, the subset whose interval contains the "
        "parameter value",
    )
    parameters: Literal["all", "train", "test"] | Listed = key(
        "all",
        "parameter values of its runs: all, train or test values of the case, or a list of "
        "Reynolds numbers or points such as {reynolds: 100, lid: 0.8}. With evaluation: operators, "
        "the list may have values without a full run",
        unit="-",
    )

    if TYPE_CHECKING:  # keys of some families, constants of the others

        @property
        def evaluation(self) -> Any: ...

        @property
        def projection(self) -> Any: ...

        @property
        def advection(self) -> Any: ...

        @property
        def memory_length(self) -> Any: ...

        @property
        def time_step(self) -> Any: ...

        @property
        def calibrated(self) -> Any: ...

        @property
        def corrected(self) -> Any: ...

        @property
        def integrated_modes(self) -> Any: ...

        @property
        def output(self) -> Any: ...

        @property
        def until(self) -> Any: ...

        @property
        def steady(self) -> Any: ...

    @model_validator(mode="after")
    def _valid_name_and_size(self) -> Self:
        """Refuse names of rows of the comparison, and automatic sizes of uncalibrated models."""
        name = self.name.casefold()
        if name in ROWS or name.startswith(BEST):
            raise ValueError(
                f"name: {self.name} is a row of the comparison, as are {', '.join(ROWS)} and names "
                f"that begin with {BEST}; choose another name"
            )
        if self.memory_length != AUTO and not self.has_memory:
            raise ValueError("memory_length: is only for projection: apg")
        if self.n_modes == AUTO and not self.is_calibrated:
            reason = "auto needs evaluation: operators and a calibrated model"
            raise ValueError(f"n_modes: {reason}; give a number")
        return self

    @property
    def size(self) -> int:
        """The number of modes.

        Raises ValueError before training runs have chosen an automatic number.
        """
        return int(self.n_modes)

    @property
    def from_operators(self) -> bool:
        """Whether its rates are polynomials from projected operators, not sums over particles."""
        return self.family != "particles"

    @property
    def is_calibrated(self) -> bool:
        """Whether its rates are fitted to the training runs, if these have enough snapshots."""
        if self.calibrated == AUTO:
            return not self.has_memory
        return bool(self.calibrated)

    @property
    def settles_on_cycles(self) -> bool:
        """Whether its closure reproduces the limit cycles of training runs."""
        return self.calibrated == "cycle"

    @property
    def has_memory(self) -> bool:
        """Whether its closure has a memory length, with projected operators of its own."""
        return self.projection == "apg"


_EVALUATION = (
    "evaluation of its rates: on moving particles, at the cost of a full run; or from operators "
    "that are projected once on the fixed points of the reference space"
)
_UNTIL = (
    "time at which its runs end, for evaluation: operators; null is time.final_time. Runs that end "
    "at another time are not compared; after time.final_time they extrapolate"
)


class ProjectedModelSection(ReducedModelSection):
    """The keys of models whose equations are projected (Alg. 3.4 and 3.5)."""

    projection: ProjectionName = key(
        "galerkin", "Galerkin (Alg. 3.4) or adjoint Petrov-Galerkin (Alg. 3.5)"
    )
    memory_length: Duration | Literal["auto"] = key(
        AUTO, "tau of Eq. 3.22, for projection: apg", unit="s"
    )
    time_step: Positive | Literal["auto", "fom"] = key(
        AUTO,
        "time step; fom means the step of the full model. auto means the same on particles; with "
        "operators it takes exponential steps, which sound doesn't limit, fine enough to add "
        "little to the error of the basis",
        unit="s",
    )


class ParticleModelSection(ProjectedModelSection):
    """A reduced model on moving particles (Alg. 3.4 and 3.5)."""

    family: ClassVar[Literal["particles"]] = "particles"
    refusal: ClassVar[str] = "is only for evaluation: operators"
    calibrated: ClassVar[bool] = False
    corrected: ClassVar[bool] = False
    integrated_modes: ClassVar[str] = AUTO
    output: ClassVar[str] = "none"
    until: ClassVar[None] = None
    steady: ClassVar[bool] = False

    evaluation: Literal["particles"] = key("particles", _EVALUATION)
    advection: Literal["consistent", "paper"] = key(
        "consistent",
        "advection of modes, for evaluation: particles: consistent (with the shifting "
        "velocity too), or as in Eq. 3.5-3.6",
    )


class PointModelSection(ProjectedModelSection):
    """A reduced model from operators that are projected on fixed points."""

    family: ClassVar[Literal["points"]] = "points"
    refusal: ClassVar[str] = "is only for evaluation: particles"

    evaluation: Literal["operators"] = key(..., _EVALUATION)
    calibrated: Flag | Literal["auto", "cycle"] = key(
        AUTO,
        "whether to add to its rates a constant and a linear part that are fitted to the training "
        "runs, for projection: galerkin and evaluation: operators; auto does so if training runs "
        "have three or more snapshots. cycle fits them to periodic training runs, so that "
        "the model settles on a cycle whose amplitude and frequency are interpolated between them",
    )
    corrected: Flag | Literal["auto"] = key(
        AUTO,
        "whether to correct its coordinates by its errors in training runs, which are interpolated "
        "as far as they predict the errors of held-out runs, for evaluation: operators; auto does "
        "so if its basis has two or more training runs",
    )
    integrated_modes: Annotated[Whole, Field(ge=1, le=10_000)] | Literal["auto"] = key(
        AUTO,
        "number of leading modes to integrate; training runs predict the other modes during the "
        "trained time, for corrected models with evaluation: operators. auto chooses the number "
        "with the best predictions of held-out runs, and all modes without calibration",
    )
    output: Literal["none", "snapshots"] = key(
        "none",
        "fields to store beside the coordinates, for evaluation: operators: none, or those of all "
        "snapshots at all reference points",
    )
    until: Positive | None = key(None, _UNTIL, unit="s")
    steady: Flag = key(
        False,
        "whether to search for a steady state, starting from the end of a run, for evaluation: "
        "operators and scenes without a body force",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        """Refuse closures and numbers of modes that exclude each other."""
        n_modes = self.n_modes
        integrated = self.integrated_modes
        if self.has_memory and self.is_calibrated:
            raise ValueError("calibrated: is only for projection: galerkin")
        if self.settles_on_cycles and (n_modes == AUTO or self.corrected is True):
            raise ValueError(
                "calibrated: cycle needs a number for n_modes and corrected: false, because "
                "training runs at other phases can't choose modes or correct runs"
            )
        if integrated == AUTO:
            return self
        if n_modes == AUTO or integrated > n_modes:
            raise ValueError(
                f"integrated_modes: must be at most n_modes, and auto if n_modes is auto; got "
                f"{integrated}"
            )
        if integrated < n_modes and self.has_memory:
            raise ValueError("integrated_modes: must be auto, as projection: apg integrates all")
        return self

    @property
    def on_particles(self) -> ParticleModelSection:
        """The model with the same basis and projection on moving particles."""
        shared = self.model_fields_set & ParticleModelSection.model_fields.keys() - {"evaluation"}
        return ParticleModelSection(**{name: getattr(self, name) for name in shared})


class SurfaceModelSection(ReducedModelSection):
    """A reduced model of fluid with a free surface."""

    family: ClassVar[Literal["surface"]] = "surface"
    refusal: ClassVar[str] = "is not for reduced models of a free surface; leave it out"
    projection: ClassVar[str] = "galerkin"
    memory_length: ClassVar[str] = AUTO
    time_step: ClassVar[str] = AUTO
    corrected: ClassVar[str] = AUTO
    integrated_modes: ClassVar[str] = AUTO
    output: ClassVar[str] = "none"
    steady: ClassVar[bool] = False

    evaluation: Literal["operators"] = key(..., _EVALUATION)
    calibrated: Flag | Literal["auto"] = key(
        AUTO, "whether to fit its rates to the training runs; auto does so"
    )
    until: Positive | None = key(None, _UNTIL, unit="s")


class ReducedModels(OneOf[ReducedModelSection]):
    """The families of reduced models: `evaluation` chooses one, and so does a free surface."""

    def choose(
        self, given: Mapping[str, Any], earlier: Mapping[str, Any]
    ) -> type[ReducedModelSection]:
        scene = earlier.get("scene")
        evaluation = given.get("evaluation", "particles")
        if scene is not None and scene.has_surface:
            if evaluation != "operators":
                reason = "must be operators for reduced models of a free surface"
                raise ValueError(f"evaluation: {reason}; got {evaluation}")
            return self.kinds["surface"]
        return self.kinds["points" if evaluation == "operators" else "particles"]

    def refusal(self, name: str, kind: type[ReducedModelSection]) -> str:
        return kind.refusal


MODELS = ReducedModels(
    particles=ParticleModelSection, points=PointModelSection, surface=SurfaceModelSection
)
"""All families of reduced models."""
AnyModel = Annotated[ReducedModelSection, MODELS]
