"""The sections of a case file for the full model, bases, reduced models and their comparison.

`sphrom.case.study_sections` has those of studies, `sphrom.case.scenes` the scenes and defaults.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Final, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from sphrom.case.fields import (
    Coordinate,
    Duration,
    Flag,
    Number,
    OneOf,
    Positive,
    SafeName,
    Section,
    Whole,
    key,
)
from sphrom.case.points import REYNOLDS, Interval, Listed, ReynoldsValues
from sphrom.case.study_sections import FigureSection
from sphrom.text import exact, repeated


class FluidSection(Section):
    """The fluid, and the scales of its weak compressibility."""

    reference_density: Positive = key(1000.0, "density at zero pressure", unit="kg/m3")
    reference_speed: Positive = key(1.0, "largest speed of the flow, U_max", unit="m/s")
    mach_number: Number = key(
        0.1,
        "U_max over the speed of sound; a large body force or friction raises the speed of sound "
        "above this ratio. A flow is weakly compressible up to 0.3",
        unit="-",
        ge=1e-3,
        le=0.3,
    )


class PackingSection(Section):
    """The packing of particles before the run."""

    seed: Whole = key(0, "seed of the random start", ge=0, le=2**32 - 1)
    tolerance: Number = key(
        1e-3, "unevenness of particles at which packing stops", unit="-", ge=1e-12, le=1.0
    )


class ShiftingSection(Section):
    """Particle shifting inside the equations (Eq. 2.13-2.14)."""

    enabled: Flag = key(True, "whether to shift particles")
    amplitude: Number = key(
        1.0, "chi of Eq. 2.14; the paper uses 0.2, with more noise", unit="-", ge=0.0, le=10.0
    )
    form: Literal["sun", "paper"] = key(
        "sun", "bracket of Eq. 2.14, with xi = 4: as in Sun et al. 2017, or as printed"
    )
    transport: Literal["advective", "paper"] = key(
        "advective",
        "advection by shifting in Eq. 2.6-2.7: differences to neighbours with a particle's own "
        "shifting velocity, or the terms as printed",
    )


class WallSection(Section):
    """The fields of the ghost particles of walls (Eq. 2.15-2.16)."""

    no_slip: Literal["linear", "whole", "paper"] = key(
        "linear",
        "velocity of ghosts: linear, extrapolated from each particle through the wall (Morris et "
        "al. 1997); whole, 2 U_wall - u of the interpolated velocity u (Adami et al. 2012); paper, "
        "u with its tangential part reversed, as printed",
    )
    continuity: Literal["adjoint", "normal", "paper"] = key(
        "adjoint",
        "walls in continuity: adjoint, minus the transpose of their pressure force; normal, the "
        "normal part of ghosts' velocities only; paper, ghosts count like fluid",
    )
    layers: Annotated[Whole, Field(ge=1, le=32)] | None = key(
        None, "layers of ghosts; null means as many as the kernel reaches"
    )


class DiscretizationSection(Section):
    """The discretisation of the fluid into particles."""

    resolution: Whole = key(
        100,
        "particles along the scene's length, for the open cavity the length of the channel",
        ge=8,
        le=100_000,
    )
    smoothing_length_ratio: Number = key(
        4.0, "smoothing length over particle spacing, h/dx", unit="-", ge=1.2, le=8.0
    )
    diffusion_coefficient: Number = key(
        0.1, "delta of the density diffusion (Eq. 2.6)", unit="-", ge=0.0, le=1.0
    )
    acoustic_damping: Number = key(
        1.0,
        "alpha of the acoustic damper, a bulk viscosity of alpha h c0 (Sun et al. 2023); the paper "
        "has none, 0",
        unit="-",
        ge=0.0,
        le=10.0,
    )
    viscosity: Literal["laplacian", "paper"] = key(
        "laplacian", "viscous operator: the Laplacian of the velocity, or Eq. 2.12 as printed"
    )
    initial_particles: Literal["auto", "packed", "lattice"] = key(
        "auto",
        "initial positions: packed, or on a lattice, which fits walls along the axes but breaks up "
        "with noise; auto means lattice in scenes with walls along the axes only, else packed",
    )
    packing: PackingSection = key(PackingSection(), "packing of particles before the run")
    fixed_volume: Flag = key(
        True, "whether to subtract the mean of continuity, so that the total volume is conserved"
    )
    shifting: ShiftingSection = key(ShiftingSection(), "particle shifting (Eq. 2.13-2.14)")
    walls: WallSection = key(WallSection(), "ghost particles, where the scene has walls")


class TimeSection(Section):
    """The duration and the time step of full runs."""

    spin_up: Duration = key(
        0.0, "time at which recording starts, after the flow has developed", unit="s"
    )
    final_time: Positive = key(1.0, "time at which runs end", unit="s")
    step: Positive | Literal["auto"] = key(
        "auto", "time step; auto derives it from the Courant number and the other limits", unit="s"
    )
    # Up to the limit, errors against exact and independent solutions hardly depend on it.
    courant_number: Number = key(
        1.2,
        "c0 dt / h of the automatic step, at most 1.5 (Eq. 2.19); the step uses the same share of "
        "the other limits",
        unit="-",
        ge=1e-6,
        le=1.5,
    )

    @model_validator(mode="after")
    def _rising(self) -> TimeSection:
        if self.spin_up >= self.final_time:
            begin = exact(self.spin_up)
            end = exact(self.final_time)
            raise ValueError(f"final_time: must be after time.spin_up, {begin} s; got {end}")
        return self


class SnapshotSection(Section):
    """The snapshots to store."""

    every: Whole = key(10, "number of steps between snapshots", ge=1, le=1_000_000_000)


ProjectionName = Literal["galerkin", "apg"]

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


class ReferenceSection(Section):
    """The reference space that snapshots are mapped onto (Eq. 3.13-3.15)."""

    points: Literal["initial", "relaxed", "lattice"] = key(
        "initial", "reference points: the initial particles, relaxed ones, or a lattice"
    )
    method: Literal["mls", "shepard"] = key(
        "mls", "second-order moving least squares, or the Shepard filter of Eq. 3.15"
    )
    smoothing_length_ratio: Annotated[Number, Field(ge=1.2, le=8.0)] | None = key(
        None,
        "smoothing length of the map over the spacing; null is 2 for mls, and that of the "
        "discretization for shepard",
        unit="-",
    )


class SubsetSection(Section):
    """A basis of some of the training runs."""

    reynolds: ReynoldsValues | None = key(
        None, "Reynolds numbers of its training runs; required without a box", unit="-"
    )
    interval: Interval | None = key(
        None,
        "half-open interval [low, high) of Reynolds numbers in which it is the local basis; null "
        "is the range of its training runs. With equal ends, it is never local",
        unit="-",
    )
    box: dict[SafeName, Interval] | None = key(
        None,
        "ranges of parameters, instead of reynolds and interval: its training runs are those in "
        "the box, in which it is the local basis",
    )

    @model_validator(mode="after")
    def _one_way(self) -> SubsetSection:
        if (self.reynolds is None) == (self.box is None):
            raise ValueError("give either reynolds, the values of training runs, or a box")
        if self.box is not None and self.interval is not None:
            raise ValueError("interval: can't be combined with a box, which has its own ranges")
        for label in repeated(map(exact, self.reynolds or ())):
            raise ValueError(f"reynolds: reynolds={label} is listed more than once")
        return self

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """The ends of its intervals by parameter; other parameters are not bounded."""
        if self.box is not None:
            return {name: (low, high) for name, (low, high) in self.box.items()}
        values = self.interval or self.reynolds or (0.0,)
        return {REYNOLDS: (min(values), max(values))}


class BasisSection(Section):
    """The trial basis (Eq. 3.16)."""

    n_modes: Annotated[Whole, Field(ge=1, le=10_000)] | None = key(
        None, "number of modes to keep; null means as many as the reduced models use"
    )
    inner_product: Literal["acoustic", "raw"] = key(
        "acoustic",
        "inner product of states: acoustic energy, in which the reduced model is stable, or the "
        "dot product of raw values",
    )
    mean_density: Literal["auto", "in-modes", "separate"] = key(
        "auto",
        "the spatial mean of the density: part of the modes, or a variable of its own; auto means "
        "separate with the acoustic product if the volume is fixed or walls enclose the fluid",
    )
    lagrangian: Flag = key(False, "whether to store also the singular values of unmapped snapshots")
    subsets: dict[SafeName, SubsetSection] = key(
        {}, "further bases by name, each of some training runs; the basis `all` always exists"
    )


class SplineSection(Section):
    """Splines of the modes (Eq. 3.17-3.20)."""

    kind: Literal["auto", "polyharmonic", "b-spline"] = key(
        "auto",
        "local polyharmonic splines, or tensor-product cubic B-splines, which are faster; auto "
        "means b-spline if the reference points are a lattice and fluid fills the scene's box, "
        "else polyharmonic",
    )
    order: Whole = key(3, "k of Eq. 3.18, for kind: polyharmonic", ge=1, le=7)
    polynomial_degree: Whole = key(
        1, "degree of the polynomial part, for kind: polyharmonic", ge=0, le=3
    )


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
_PROJECTION = "Galerkin (Alg. 3.4) or adjoint Petrov-Galerkin (Alg. 3.5)"
_MEMORY_LENGTH = "tau of Eq. 3.22, for projection: apg"
_TIME_STEP = (
    "time step; fom means the step of the full model. auto means the same on particles; with "
    "operators it takes exponential steps, which sound doesn't limit, fine enough to add little to "
    "the error of the basis"
)
_UNTIL = (
    "time at which its runs end, for evaluation: operators; null is time.final_time. Runs that end "
    "at another time are not compared; after time.final_time they extrapolate"
)


class ParticleModelSection(ReducedModelSection):
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
    projection: ProjectionName = key("galerkin", _PROJECTION)
    advection: Literal["consistent", "paper"] = key(
        "consistent",
        "advection of modes, for evaluation: particles: consistent, also by shifting, or as in "
        "Eq. 3.5-3.6",
    )
    memory_length: Duration | Literal["auto"] = key(AUTO, _MEMORY_LENGTH, unit="s")
    time_step: Positive | Literal["auto", "fom"] = key(AUTO, _TIME_STEP, unit="s")


class PointModelSection(ReducedModelSection):
    """A reduced model from operators that are projected on fixed points."""

    family: ClassVar[Literal["points"]] = "points"
    refusal: ClassVar[str] = "is only for evaluation: particles"

    evaluation: Literal["operators"] = key(..., _EVALUATION)
    projection: ProjectionName = key("galerkin", _PROJECTION)
    memory_length: Duration | Literal["auto"] = key(AUTO, _MEMORY_LENGTH, unit="s")
    time_step: Positive | Literal["auto", "fom"] = key(AUTO, _TIME_STEP, unit="s")
    calibrated: Flag | Literal["auto", "cycle"] = key(
        AUTO,
        "whether to add to its rates a constant and a linear part that are fitted to the training "
        "runs, for projection: galerkin and evaluation: operators; auto does so if training runs "
        "have three or more snapshots. cycle fits them to periodic training runs, so that the "
        "model settles on a cycle with their interpolated amplitude and frequency",
    )
    corrected: Flag | Literal["auto"] = key(
        AUTO,
        "whether to add to its coordinates the interpolated errors of the model at its training "
        "runs, as far as they predict the errors of held-out training runs, for evaluation: "
        "operators; auto does so if its basis has two or more training runs",
    )
    integrated_modes: Annotated[Whole, Field(ge=1, le=10_000)] | Literal["auto"] = key(
        AUTO,
        "number of leading modes to integrate; these predict the other modes during the trained "
        "time, for corrected models with evaluation: operators. auto chooses the number that "
        "predicts held-out training runs best, and all modes without calibration",
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


class OperatorSection(Section):
    """The projected operators of models on the reference points."""

    error_estimate: Flag | Literal["auto"] = key(
        "auto",
        "whether to store the data for error estimates; auto stores them for bases of at most 30 "
        "modes",
    )


class CompareSection(Section):
    """The comparison of reduced and full runs (Eq. 4.1-4.3)."""

    line: Coordinate | None = key(
        None,
        "x of the vertical line on which runs are compared; null is the middle of the scene, or "
        "five eighths of the open cavity's channel",
        unit="m",
    )
    line_points: Whole = key(101, "number of points on that line", ge=2, le=100_000)
    grid: Whole = key(
        50, "grid points along the longer side of the scene's box, for fields", ge=2, le=2_000
    )
    exact: Flag = key(True, "whether to compare with the exact solution, in scenes that have one")
    plots: Flag = key(True, "whether to draw figures")
    from_time: Duration = key(0.0, "time from which errors count", unit="s")
    figures: tuple[FigureSection, ...] = key(
        (), "figures that `sphrom figures` draws, besides those of `sphrom compare`"
    )
