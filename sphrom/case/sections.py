"""The sections of a case file on bases, reduced models and their comparison.

`sphrom.case.full_model_sections` holds those of the full model, `sphrom.case.study_sections` and
`sphrom.case.sweep_section` those of studies, `sphrom.case.scenes` the scenes and the defaults that
differ for other kinds of scene than a periodic flow.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field, model_validator

from sphrom.case.fields import (
    Coordinate,
    Duration,
    Flag,
    Number,
    Positive,
    SafeName,
    Section,
    Whole,
    key,
)
from sphrom.case.points import REYNOLDS, Interval, Listed, ReynoldsValues
from sphrom.case.study_sections import FigureSection
from sphrom.text import exact, repeated

ProjectionName = Literal["galerkin", "apg"]

_ONLY_FOR = {
    ("projection", "galerkin"): ("calibrated",),
    ("projection", "apg"): ("memory_length",),
    ("evaluation", "particles"): ("advection",),
    ("evaluation", "operators"): (
        "output", "calibrated", "corrected", "integrated_modes", "until", "steady",
    ),
}  # fmt: skip
"""Keys of a reduced model that mean something for one projection or evaluation alone."""
ALL = "all"
"""The name of the basis that is trained on every training value."""
AUTO: Final = "auto"
"""What a value is called that is chosen."""
LOCAL = "local"
"""What a reduced model calls the basis in whose interval its parameter point lies."""
ROWS = ("full", "map", "exact")
"""Names of rows of the comparison that no reduced model may have."""
BEST = "best"
"""How the names of other such rows begin."""


class ReferenceSection(Section):
    """The reference space that snapshots are mapped onto (Eq. 3.13-3.15)."""

    points: Literal["initial", "relaxed", "lattice"] = key("initial", "where its points are")
    method: Literal["mls", "shepard"] = key(
        "mls", "second-order moving least squares, or the Shepard filter of Eq. 3.15"
    )
    smoothing_length_ratio: Annotated[Number, Field(ge=1.2, le=8.0)] | None = key(
        None,
        "smoothing length of the map over the spacing; null is 2 for mls, "
        "and the discretization's for shepard",
        unit="-",
    )


class SubsetSection(Section):
    """A basis that learns from some of the training values only."""

    reynolds: ReynoldsValues | None = key(
        None, "those of the training values it learns from; needed without a box", unit="-"
    )
    interval: Interval | None = key(
        None,
        "Reynolds numbers that it is the local basis of: from the first up to, without, the "
        "second; null is the range that it learns from, and one of no width is never local",
        unit="-",
    )
    box: dict[SafeName, Interval] | None = key(
        None,
        "ranges of parameters, in place of reynolds and interval: it learns from the training "
        "values in them, and is the local basis there",
    )

    @model_validator(mode="after")
    def _one_way(self) -> SubsetSection:
        if (self.reynolds is None) == (self.box is None):
            raise ValueError("give either reynolds, the values that it learns from, or a box")
        if self.box is not None and self.interval is not None:
            raise ValueError("interval: is for reynolds; a box has its own ranges")
        for label in repeated(map(exact, self.reynolds or ())):
            raise ValueError(f"reynolds: reynolds={label} stands more than once")
        return self

    @property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """The ends of its intervals by parameter; a parameter without any is not bounded."""
        if self.box is not None:
            return {name: (low, high) for name, (low, high) in self.box.items()}
        values = self.interval or self.reynolds or (0.0,)
        return {REYNOLDS: (min(values), max(values))}


class BasisSection(Section):
    """The trial basis (Eq. 3.16)."""

    n_modes: Annotated[Whole, Field(ge=1, le=10_000)] | None = key(
        None, "modes to keep; null keeps what the reduced models ask for"
    )
    inner_product: Literal["acoustic", "raw"] = key(
        "acoustic", "acoustic energy, in which the reduced model is stable, or raw stacked values"
    )
    mean_density: Literal["auto", "in-modes", "separate"] = key(
        "auto",
        "whether modes hold the spatial mean of the density, or it is subtracted and carried as a "
        "variable of its own; auto separates it in the acoustic product where the fluid's volume "
        "is fixed or walls close it in",
    )
    lagrangian: Flag = key(False, "whether singular values of unmapped snapshots are kept too")
    subsets: dict[SafeName, SubsetSection] = key(
        {}, "further bases by name, each from some training values; all is always there"
    )


class SplineSection(Section):
    """Splines of the modes (Eq. 3.17-3.20)."""

    kind: Literal["auto", "polyharmonic", "b-spline"] = key(
        "auto",
        "local polyharmonic splines, or tensor-product cubic B-splines, which are faster; auto is "
        "b-spline where the reference points are a lattice and fluid fills the scene's box, and "
        "polyharmonic elsewhere",
    )
    order: Whole = key(3, "k of Eq. 3.18, for kind: polyharmonic", ge=1, le=7)
    polynomial_degree: Whole = key(
        1, "degree of the polynomial part, for kind: polyharmonic", ge=0, le=3
    )


class ReducedModelSection(Section):
    """One reduced model (Alg. 3.4 and 3.5)."""

    name: SafeName = key(..., "what its files and tables call it")
    evaluation: Literal["particles", "operators"] = key(
        "particles",
        "how its rates are computed: on moving particles, which costs as much as a full run; or "
        "from operators that are projected once, on the fixed points of the reference space",
    )
    projection: ProjectionName = key(
        "galerkin", "Galerkin (Alg. 3.4) or adjoint Petrov-Galerkin (Alg. 3.5)"
    )
    n_modes: Annotated[Whole, Field(ge=1, le=10_000)] | Literal["auto"] = key(
        5,
        "modes it uses; auto, for evaluation: operators, takes the fewest that are as good between "
        "training runs as any, of basis.n_modes or else 20",
    )
    basis: SafeName = key(
        ALL,
        "which basis: all, one of basis.subsets, or local: at each of its values the subset in "
        "whose interval it lies",
    )
    advection: Literal["consistent", "paper"] = key(
        "consistent",
        "whether shifting advects the modes too, or as in Eq. 3.5-3.6, for evaluation: particles",
    )
    memory_length: Duration | Literal["auto"] = key(
        "auto", "tau of Eq. 3.22, for projection: apg", unit="s"
    )
    time_step: Positive | Literal["auto", "fom"] = key(
        "auto",
        "its time step; fom takes the full model's; auto does so too on particles, and on "
        "reference points takes exponential steps, which sound doesn't limit, so fine that they "
        "add little to what the basis leaves out",
        unit="s",
    )
    calibrated: Flag | Literal["auto", "cycle"] = key(
        "auto",
        "whether a constant and a linear part are added to its rates that are fitted to the "
        "training runs, for projection: galerkin and evaluation: operators; auto does so where "
        "training runs have three snapshots or more; cycle fits them to periodic training runs, "
        "so that it settles on their amplitude and frequency, and on what lies between them",
    )
    corrected: Flag | Literal["auto"] = key(
        "auto",
        "whether what projected training runs differ by from the model's own is added to its "
        "coordinates, as far as training runs predict that of each other, for evaluation: "
        "operators; auto does so where its basis learns from two runs or more",
    )
    integrated_modes: Annotated[Whole, Field(ge=1, le=10_000)] | Literal["auto"] = key(
        "auto",
        "how many of its modes are integrated, the first ones, as long as training runs are; these "
        "predict the others, for evaluation: operators, where it is corrected; auto takes as many "
        "as are best between training runs, all where it isn't calibrated",
    )
    output: Literal["none", "snapshots"] = key(
        "none",
        "fields to keep beside the coordinates, unless evaluated on particles: none, or those of "
        "every snapshot at all reference points",
    )
    until: Positive | None = key(
        None,
        "time at which its runs end, for evaluation: operators; null is time.final_time. Runs that "
        "end at another time are not compared; after time.final_time they are beyond training",
        unit="s",
    )
    steady: Flag = key(
        False,
        "whether a steady state is looked for from where a run ended, for evaluation: operators "
        "and scenes that no force drives",
    )
    parameters: Literal["all", "train", "test"] | Listed = key(
        "all",
        "which of the case's values it is run at, Reynolds numbers or points such as {reynolds: "
        "100, lid: 0.8}; unless evaluated on particles others too, that have no full run",
        unit="-",
    )

    @model_validator(mode="after")
    def _consistent(self) -> ReducedModelSection:
        """Refuse names of the comparison's own rows, and keys of another kind of model."""
        name = self.name.casefold()
        if name in ROWS or name.startswith(BEST):
            raise ValueError(
                f"name: {self.name} is a row of the comparison, as are {', '.join(ROWS)} and names "
                f"that begin with {BEST}; choose another"
            )
        for (kind, value), keys in _ONLY_FOR.items():
            for one in keys:
                given, usual = getattr(self, one), type(self).model_fields[one].default
                # A key that is off asks for nothing, whatever its default.
                if given is not False and given != usual and getattr(self, kind) != value:
                    raise ValueError(f"{one}: is only for {kind}: {value}")
        self._check_modes()
        return self

    def _check_modes(self) -> None:
        """Raise ValueError for modes that training runs can neither choose nor predict."""
        n_modes, integrated = self.n_modes, self.integrated_modes
        if n_modes == AUTO and not (self.from_operators and self.is_calibrated):
            reason = "auto is for models with evaluation: operators that are calibrated"
            raise ValueError(f"n_modes: {reason}; give a number")
        if self.settles_on_cycles and (n_modes == AUTO or self.corrected is True):
            raise ValueError(
                "calibrated: cycle is for a given n_modes and without corrected: training runs at "
                "other phases neither choose modes nor correct runs"
            )
        if integrated == AUTO:
            return
        if n_modes == AUTO or integrated > n_modes:
            raise ValueError(
                f"integrated_modes: is at most n_modes, and auto where that is; got {integrated}"
            )
        if integrated < n_modes and self.has_memory:
            raise ValueError("integrated_modes: projection: apg integrates all modes")

    @property
    def size(self) -> int:
        """The number of modes it uses.

        Raises ValueError while training runs have yet to choose it.
        """
        return int(self.n_modes)

    @property
    def from_operators(self) -> bool:
        """Whether its rates are polynomials, from operators that are projected once.

        Else they are evaluated on moving particles.
        """
        return self.evaluation == "operators"

    @property
    def is_calibrated(self) -> bool:
        """Whether its rates are fitted to the training runs, if these have snapshots enough."""
        if self.calibrated == "auto":
            return self.from_operators and not self.has_memory
        return bool(self.calibrated)

    @property
    def settles_on_cycles(self) -> bool:
        """Whether its closure has the limit cycles of training runs."""
        return self.calibrated == "cycle"

    @property
    def has_memory(self) -> bool:
        """Whether its closure has a memory length, and projected operators of its own."""
        return self.projection == "apg"


class OperatorSection(Section):
    """The projected operators of models on the reference points."""

    error_estimate: Flag | Literal["auto"] = key(
        "auto",
        "whether what estimates of errors need is kept too; auto keeps it for bases of at most 30 "
        "modes",
    )


class CompareSection(Section):
    """How reduced and full runs are compared (Eq. 4.1-4.3)."""

    line: Coordinate | None = key(
        None,
        "x of the vertical line that runs are compared along; null is the scene's: its middle, or "
        "five eighths along the open cavity",
        unit="m",
    )
    line_points: Whole = key(101, "points along that line", ge=2, le=100_000)
    grid: Whole = key(
        50, "points along the longer side of the scene's box, for whole fields", ge=2, le=2_000
    )
    exact: Flag = key(True, "whether to compare with the exact solution, for scenes that have one")
    plots: Flag = key(True, "whether to draw figures")
    from_time: Duration = key(0.0, "time before which errors are left out", unit="s")
    figures: tuple[FigureSection, ...] = key(
        (), "what `sphrom figures` draws beside the pictures that `sphrom compare` makes itself"
    )
