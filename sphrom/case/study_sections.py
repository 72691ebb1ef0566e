"""The sections `trade`, `fit` and `training` of a case, and the figures that it asks for."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from sphrom.case.fields import Coordinate, Duration, Flag, Number, SafeName, Section, Whole, key
from sphrom.case.points import Range, ReynoldsValues, viscous

Modes = Annotated[tuple[Annotated[Whole, Field(ge=1, le=10_000)], ...], Field(min_length=1)]
Resolution = Annotated[Whole, Field(ge=8, le=100_000)]


class TradeSection(Section):
    """The models with operators that are weighed."""

    n_modes: Modes | None = key(
        None, "their modes; null is 2, 5, 10, 20, 50, as far as the basis goes, and all it has"
    )
    full_runs: Flag = key(
        True,
        "whether full runs are made that the case doesn't have: at other steps and resolutions, "
        "and with --extremes at other parameters, Mach numbers and h/dx",
    )
    resolutions: Annotated[tuple[Resolution, ...], Field(min_length=1)] | None = key(
        None, "resolutions of further full runs; null is the case's, and half of it where it fits"
    )
    probes: Literal["line", "field"] = key(
        "field", "place of the relative L2 error over points and time by which models are judged"
    )
    measure: SafeName | None = key(
        None,
        "a name of scene.measure: models are judged by the relative L2 error of this force, flow "
        "rate, velocity and pressure, or frequency and amplitude, instead of the fields'",
    )
    repeats: Whole = key(5, "how often a run is timed; the least time counts", ge=1, le=1000)


LEAST_PERCENT, MOST_PERCENT = 1e-6, 1e3
"""Noise over a history's range."""


class FitSection(Section):
    """Parameters of a reduced model from measured histories."""

    model: SafeName | None = key(
        None, "a reduced model with evaluation: operators; null is the first"
    )
    parameters: Annotated[dict[SafeName, Coordinate | Range], AfterValidator(viscous)] = key(
        {},
        "by name the range [low, high] to look for a parameter in, or its known value; others that "
        "vary in the case are looked for in their trained range",
        unit="as the parameter",
    )
    noise: Annotated[Number, Field(ge=LEAST_PERCENT, le=MOST_PERCENT)] | None = key(
        None,
        "standard deviation of the noise over the range of each history, where the measurements "
        "say none",
        unit="%",
    )
    starts: Whole = key(8, "how many starts the search has, spread over the ranges", ge=1, le=1000)


def percentage(given: str | float) -> float:
    """Return the number of a percentage such as `1%`. Raises ValueError for anything else."""
    try:
        value = float(str(given).strip().removesuffix("%"))
    except ValueError:
        value = 0.0
    if not LEAST_PERCENT <= value <= MOST_PERCENT:
        most = f"{LEAST_PERCENT:g}% to {MOST_PERCENT:g}%"
        raise ValueError(f"must be a percentage from {most}, such as 1%")
    return value


# No percentage is zero, so that the text is returned.
_valid = AfterValidator(lambda text: percentage(text) and text)
Percentage = Annotated[str, Field(strict=True, examples=["1%"]), _valid]
N_CANDIDATES = 100
"""Points of a region at which training estimates the model's error, beside corners."""


class TrainingSection(Section):
    """A region of the parameters, and the error allowed of a model anywhere in it."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Range] = Field(init=False)

    tolerance: Percentage = key(
        "1%", "error allowed of the model, over the field's size, root mean squares over a run"
    )
    quantity: Literal["velocity", "pressure", "both"] = key("velocity", "whose error is meant")
    budget: Annotated[Whole, Field(ge=2, le=N_CANDIDATES)] = key(
        8, "most full runs to learn from, those that are there already too"
    )
    model: SafeName | None = key(
        None,
        "the model by its name, of those with evaluation: operators; null is the first of these",
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
        """The least and the greatest value of each parameter, none where there is no region."""
        return {name: (ends[0], ends[1]) for name, ends in (self.__pydantic_extra__ or {}).items()}

    @property
    def fields(self) -> tuple[int, ...]:
        """Which of velocity, 0, and pressure, 1, count."""
        return {"velocity": (0,), "pressure": (1,), "both": (0, 1)}[self.quantity]


FULL = "full"
"""What the full model is called among the runs of a figure."""
Runs = Annotated[tuple[Annotated[tuple[SafeName, ...], Field(min_length=1)], ...],
                 Field(min_length=1)]  # fmt: skip
_RUNS = "rows of panels, each a list of reduced models by name"
_VALUES = "Reynolds numbers; null is all at which the row's runs are made"


class _Figure(Section):
    """What all figures have."""

    name: SafeName = key(..., "name of its file")
    caption: str = key("", "what a page says below it")


class _OfRuns(_Figure):
    """A figure of runs."""

    runs: Runs = key(..., _RUNS)
    reynolds: ReynoldsValues | None = key(None, _VALUES, unit="-")
    quantities: Annotated[tuple[Literal["speed", "pressure"], ...], Field(min_length=1)] = key(
        ("speed", "pressure"), "a column of panels each"
    )


class FieldFigure(_OfRuns):
    """Fields at one instant: particles, or reference points, as they are."""

    kind: Literal["fields"] = key(..., "fields at an instant")
    runs: Runs = key(((FULL,),), f"{_RUNS}, or full")
    time: Duration = key(..., "the instant; the nearest snapshot is drawn", unit="s")


class LineFigure(_OfRuns):
    """Profiles along the line of comparison at one instant."""

    kind: Literal["lines"] = key(..., "profiles at an instant: full, exact and reduced together")
    time: Duration = key(..., "the instant; the nearest snapshot is drawn", unit="s")


class ErrorFigure(_OfRuns):
    """Errors over time by Eq. 4.1, on the line of comparison."""

    kind: Literal["errors"] = key(..., "Eq. 4.1 on the line, over time")
    range: Literal["line", "field"] = key(
        "line", "whether errors are over the range on the line or of the whole field"
    )


class SpectrumFigure(_Figure):
    """Singular values of one basis, and their shares."""

    kind: Literal["singular-values"] = key(..., "singular values and shares in both spaces")
    basis: SafeName = key("all", "which basis")
    modes: Modes = key(..., "numbers of modes whose shares are told")


class ModeFigure(_Figure):
    """One field of some modes, a row for each space."""

    kind: Literal["modes"] = key(..., "modes in both spaces")
    basis: SafeName = key("all", "which basis")
    modes: Modes = key(..., "which modes, from 1")
    field: Literal["density", "x-velocity", "y-velocity"] = key("density", "which part of them")


OfRuns = FieldFigure | LineFigure | ErrorFigure
OfModes = SpectrumFigure | ModeFigure
FigureSection = Annotated[OfRuns | OfModes, Field(discriminator="kind")]
