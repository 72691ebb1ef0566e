"""The sections `trade`, `fit` and `training` of a case, and those of its figures."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from sphrom.case.fields import Coordinate, Duration, Flag, Number, SafeName, Section, Whole, key
from sphrom.case.points import Range, ReynoldsValues, viscous

Modes = Annotated[tuple[Annotated[Whole, Field(ge=1, le=10_000)], ...], Field(min_length=1)]
Resolution = Annotated[Whole, Field(ge=8, le=100_000)]


class TradeSection(Section):
    """The models with operators whose speed and accuracy are compared."""

    n_modes: Modes | None = key(
        None,
        "numbers of modes of the models; null means 2, 5, 10, 20 and 50, up to the size of the "
        "basis, and the whole basis",
    )
    full_runs: Flag = key(
        True,
        "whether to make further full runs: at other time steps and resolutions, and with "
        "--extremes at other parameters, Mach numbers and h/dx",
    )
    resolutions: Annotated[tuple[Resolution, ...], Field(min_length=1)] | None = key(
        None, "resolutions of further full runs; null is the case's, and half of it if possible"
    )
    probes: Literal["line", "field"] = key(
        "field", "points of the relative L2 error over points and time that ranks the models"
    )
    measure: SafeName | None = key(
        None,
        "a name of scene.measure: the relative L2 error of this force, flow rate, velocity and "
        "pressure, or frequency and amplitude ranks the models, instead of that of the fields",
    )
    repeats: Whole = key(5, "number of timings of a run; the least time counts", ge=1, le=1000)


LEAST_PERCENT, MOST_PERCENT = 1e-6, 1e3
"""Bounds of the noise, in percent of a history's range."""


class FitSection(Section):
    """The parameters of a reduced model that are fitted to measured histories."""

    model: SafeName | None = key(
        None, "a reduced model with evaluation: operators; null is the first one"
    )
    parameters: Annotated[dict[SafeName, Coordinate | Range], AfterValidator(viscous)] = key(
        {},
        "parameters by name: a range [low, high] for a free parameter, or a fixed value; other "
        "parameters of the case are free in their trained range",
        unit="as the parameter",
    )
    noise: Annotated[Number, Field(ge=LEAST_PERCENT, le=MOST_PERCENT)] | None = key(
        None,
        "standard deviation of the noise over the range of each history, if the measurements have "
        "none",
        unit="%",
    )
    starts: Whole = key(8, "number of starts of the search, spread over the ranges", ge=1, le=1000)


def percentage(text: str | float) -> float:
    """Return the number of a percentage such as `1%`. Raises ValueError for anything else."""
    try:
        value = float(str(text).strip().removesuffix("%"))
    except ValueError:
        value = 0.0
    if not LEAST_PERCENT <= value <= MOST_PERCENT:
        most = f"{LEAST_PERCENT:g}% to {MOST_PERCENT:g}%"
        raise ValueError(f"must be a percentage from {most}, such as 1%")
    return value


# The text is returned, because no percentage is zero.
_valid = AfterValidator(lambda text: percentage(text) and text)
Percentage = Annotated[str, Field(strict=True, examples=["1%"]), _valid]
N_CANDIDATES = 100
"""Points of a region at which training estimates the model's error, besides corners."""


class TrainingSection(Section):
    """A region of the parameters, and the allowed error of a model in all of it."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Range] = Field(init=False)

    tolerance: Percentage = key(
        "1%", "allowed error of the model: root mean square of the error over that of the field"
    )
    quantity: Literal["velocity", "pressure", "both"] = key(
        "velocity", "field whose error is limited"
    )
    budget: Annotated[Whole, Field(ge=2, le=N_CANDIDATES)] = key(
        8, "largest number of training runs, including existing ones"
    )
    model: SafeName | None = key(
        None, "name of a reduced model with evaluation: operators; null is the first one"
    )
    seed: Whole = key(
        0, "seed of the points at which the model's error is estimated", ge=0, le=2**32 - 1
    )

    @model_validator(mode="after")
    def _viscous(self) -> TrainingSection:
        viscous(self.ranges)
        return self

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """The least and the greatest value of each parameter; empty without a region."""
        return {name: (ends[0], ends[1]) for name, ends in (self.__pydantic_extra__ or {}).items()}

    @property
    def fields(self) -> tuple[int, ...]:
        """The indices of the limited fields: 0 for velocity, 1 for pressure."""
        return {"velocity": (0,), "pressure": (1,), "both": (0, 1)}[self.quantity]


FULL = "full"
"""The name of the full model among the runs of a figure."""
Runs = Annotated[tuple[Annotated[tuple[SafeName, ...], Field(min_length=1)], ...],
                 Field(min_length=1)]  # fmt: skip
_RUNS = "rows of panels, each a list of names of reduced models"
_VALUES = "Reynolds numbers; null means all at which the row has runs"


class _Figure(Section):
    """The keys that all figures have."""

    name: SafeName = key(..., "name of its file")
    caption: str = key("", "caption on pages that show it")


class _OfRuns(_Figure):
    """A figure of runs."""

    runs: Runs = key(..., _RUNS)
    reynolds: ReynoldsValues | None = key(None, _VALUES, unit="-")
    quantities: Annotated[tuple[Literal["speed", "pressure"], ...], Field(min_length=1)] = key(
        ("speed", "pressure"), "quantities, with one column of panels each"
    )


class FieldFigure(_OfRuns):
    """Fields at one time, drawn at the particles or the reference points."""

    kind: Literal["fields"] = key(..., "fields at one time")
    runs: Runs = key(((FULL,),), f"{_RUNS}, or full")
    time: Duration = key(..., "time; the nearest snapshot is drawn", unit="s")


class LineFigure(_OfRuns):
    """Profiles along the line of comparison at one time."""

    kind: Literal["lines"] = key(..., "profiles of full, exact and reduced solutions at one time")
    time: Duration = key(..., "time; the nearest snapshot is drawn", unit="s")


class ErrorFigure(_OfRuns):
    """Errors of Eq. 4.1 on the line of comparison, over time."""

    kind: Literal["errors"] = key(..., "errors of Eq. 4.1 on the line, over time")
    range: Literal["line", "field"] = key(
        "line", "range by which errors are divided: on the line, or of the whole field"
    )


class SpectrumFigure(_Figure):
    """Singular values of one basis, and their cumulative shares."""

    kind: Literal["singular-values"] = key(..., "singular values and shares in both spaces")
    basis: SafeName = key("all", "name of the basis")
    modes: Modes = key(..., "numbers of modes whose shares are labelled")


class ModeFigure(_Figure):
    """One field of some modes, with a row for each space."""

    kind: Literal["modes"] = key(..., "modes in both spaces")
    basis: SafeName = key("all", "name of the basis")
    modes: Modes = key(..., "numbers of the modes, counted from 1")
    field: Literal["density", "x-velocity", "y-velocity"] = key("density", "field of the modes")


OfRuns = FieldFigure | LineFigure | ErrorFigure
OfModes = SpectrumFigure | ModeFigure
FigureSection = Annotated[OfRuns | OfModes, Field(discriminator="kind")]
