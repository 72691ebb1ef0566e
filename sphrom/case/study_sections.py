"""The sections `sweep`, `trade`, `fit` and `training` of a case, and those of its figures."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, ConfigDict, Field, model_validator

from sphrom.case.fields import (
    LARGEST,
    SMALLEST,
    Coordinate,
    Duration,
    Flag,
    Number,
    SafeName,
    Section,
    Whole,
    key,
)
from sphrom.case.points import (
    REYNOLDS,
    OtherValues,
    PointValues,
    Range,
    ReynoldsValues,
    SampleSection,
    rising,
    unit_sample,
    viscous,
)
from sphrom.metrics import draws
from sphrom.metrics.draws import fewest_runs, saltelli_design

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
        "field", "points at which the error that ranks the models is computed, a relative L2 norm"
    )
    measure: SafeName | None = key(
        None,
        "a name of scene.measure: its relative L2 error (of a force, a flow rate, velocity "
        "and pressure, or frequency and amplitude) ranks the models instead of the error of "
        "the fields",
    )
    repeats: Whole = key(
        5, "number of timings of a run, of which the shortest is used", ge=1, le=1000
    )


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
        "parameters that vary in training are free in their trained range",
        unit="as the parameter",
    )
    noise: Annotated[Number, Field(ge=LEAST_PERCENT, le=MOST_PERCENT)] | None = key(
        None,
        "standard deviation of the noise, as a share of the range of each history, if the "
        "measurements have none",
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
        "1%",
        "allowed error of the model: root mean square of the error, relative to that of the field",
    )
    quantity: Literal["auto", "velocity", "pressure", "both", "oscillation"] = key(
        "auto",
        "field whose error is limited, or the frequency and the amplitude of measured oscillations;"
        " auto is oscillation for a model with calibrated: cycle if one is measured, else velocity",
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
        """The indices of the limited errors: 0 for velocity, 1 for pressure, 2 for oscillations."""
        return {"pressure": (1,), "both": (0, 1), "oscillation": (2,)}.get(self.quantity, (0,))


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
        "line",
        "range of values by which errors are divided: that on the line, or that of the whole field",
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
    field: Literal["density", "x-velocity", "y-velocity", "z-velocity"] = key(
        "density", "field of the modes; z-velocity in three dimensions"
    )


OfRuns = FieldFigure | LineFigure | ErrorFigure
OfModes = SpectrumFigure | ModeFigure
FigureSection = Annotated[OfRuns | OfModes, Field(discriminator="kind")]


MOST_VALUES = 100_000
"""Largest number of points of one sweep."""
NEVER = 1e-9
"""Probability of impossible values, below which they are ignored."""

Share = Annotated[Number, Field(ge=1e-4, le=1.0 - 1e-4)]


class SpreadSection(Section):
    """Values that are spread over a range."""

    low: Coordinate = key(..., "least value", unit="as the parameter")
    high: Coordinate = key(..., "greatest value", unit="as the parameter")
    count: Whole = key(..., "number of values", ge=1, le=MOST_VALUES)
    spacing: Literal["linear", "logarithmic"] = key(
        "linear", "spacing of the values: equal steps, or equal factors"
    )

    @model_validator(mode="after")
    def _rising(self) -> SpreadSection:
        if self.low > self.high or (self.spacing == "logarithmic" and self.low <= 0.0):
            raise ValueError("low: must be at most high, and above zero for spacing: logarithmic")
        return self

    @property
    def values(self) -> NDArray[np.float64]:
        """The spread values (n_values,); those between the ends have at most 12 digits."""
        spread = np.linspace if self.spacing == "linear" else np.geomspace
        values = np.asarray(spread(self.low, self.high, self.count))
        values[1:-1] = [float(f"{value:.12g}") for value in values[1:-1]]
        return values


class DistributionSection(Section):
    """The distribution of a parameter; every other key is one of its arguments in scipy."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Coordinate] = Field(init=False)

    distribution: SafeName = key(
        ...,
        "name in scipy.stats, such as norm, uniform, truncnorm, lognorm, triang or beta; every "
        "other key is one of its arguments, such as loc and scale",
    )

    @property
    def arguments(self) -> dict[str, float]:
        """The arguments of the distribution."""
        return dict(self.__pydantic_extra__ or {})

    def check(self, parameter: str) -> None:
        """Raise ValueError unless a parameter's values can be drawn from it."""
        name = self.distribution
        arguments = self.arguments
        if (problem := draws.problem(name, arguments)) is not None:
            raise ValueError(f"{parameter}: {problem}")
        low = SMALLEST if parameter == REYNOLDS else -LARGEST
        share = draws.share_outside(name, arguments, low, LARGEST)
        if share > NEVER:
            raise ValueError(
                f"{parameter}: {100.0 * share:.2g} % of the values of {name} are below {low:g} or "
                f"above {LARGEST:g}, which is impossible; truncate it (truncnorm, truncexpon), or "
                "choose a distribution above zero (uniform, lognorm, beta)"
            )


class DrawnSection(SampleSection):
    """Draws of parameters; every other key is a parameter with its range or distribution."""

    __pydantic_extra__: dict[str, Range | DistributionSection]  # type: ignore[assignment]

    count: Whole = key(..., "number of points; for saltelli, a power of 2", ge=1, le=MOST_VALUES)
    method: Literal["sobol", "halton", "latin-hypercube", "random", "saltelli"] = key(  # type: ignore[assignment]
        "sobol",
        "a sequence that fills the box evenly (sobol, halton), latin-hypercube, independent draws "
        "(random), or saltelli, which makes count (2 + number of parameters) runs for Sobol "
        "indices; except with latin-hypercube, a larger count keeps the earlier points",
    )

    @model_validator(mode="after")
    def _consistent(self) -> DrawnSection:
        for name, entry in self.entries.items():
            if isinstance(entry, DistributionSection):
                entry.check(name)
        if self.method == "saltelli":
            if len(self.entries) < 2:
                raise ValueError("method: saltelli compares parameters: name two or more")
            if self.count & (self.count - 1):
                raise ValueError("count: must be a power of two for method: saltelli")
            if self.count * (len(self.entries) + 2) > MOST_VALUES:
                raise ValueError(f"count: makes more than {MOST_VALUES} runs")
        return self

    @property
    def is_random(self) -> bool:
        """Whether its points are random draws rather than a sequence that fills a box."""
        drawn = any(isinstance(entry, DistributionSection) for entry in self.entries.values())
        return drawn or self.method in ("random", "saltelli")

    @cached_property
    def points(self) -> list[dict[str, float]]:
        """The points: random draws with all digits, others with six."""
        if not self.is_random:
            return super().points
        n_parameters = len(self.entries)
        if self.method == "saltelli":
            pairs = unit_sample("sobol", self.count, self.seed, 2 * n_parameters)
            shares = saltelli_design(pairs)
        else:
            shares = unit_sample(self.method, self.count, self.seed, n_parameters)
        columns = []
        for entry, column in zip(self.entries.values(), shares.T, strict=True):
            if isinstance(entry, DistributionSection):
                columns.append(draws.quantiles(entry.distribution, entry.arguments, column))
            else:
                low, high = entry
                columns.append(low + (high - low) * column)
        rows = np.stack(columns, axis=1).tolist()
        return [dict(zip(self.entries, row, strict=True)) for row in rows]


class SweepSection(Section):
    """One model, run at many parameter values."""

    name: SafeName | None = key(None, "name of its files; null is the name of the model")
    model: SafeName | None = key(
        None,
        "full, or the name of a reduced model; null is the first with evaluation: operators, or "
        "full if there is none",
    )
    reynolds: ReynoldsValues | SpreadSection | None = key(
        None,
        "Reynolds numbers: a list, or a range such as {low: 100, high: 200, count: 1000}",
        unit="-",
    )
    parameters: dict[SafeName, OtherValues | SpreadSection] = key(
        {},
        "further parameters by name, each a list or a range; all combinations with the Reynolds "
        "numbers are run",
    )
    points: tuple[PointValues, ...] = key(
        (), "list of points, each with its values by name, instead of reynolds and parameters"
    )
    sample: DrawnSection | None = key(
        None,
        "points that fill a box or are drawn from distributions, instead of reynolds and "
        "parameters; the sweep then computes quantiles and other statistics of the outputs",
    )
    quantiles: Annotated[
        tuple[Share, ...], Field(min_length=1, max_length=99), AfterValidator(rising)
    ] = key(
        (0.05, 0.25, 0.5, 0.75, 0.95),
        "levels of the quantiles of a sample's outputs, in ascending order",
    )
    sensitivities: Flag = key(
        False,
        "whether to compute derivatives of the final kinetic energy, forces, flow rates and probes "
        "by the parameters, for models with operators",
    )

    @model_validator(mode="after")
    def _consistent(self) -> SweepSection:
        if bool(self.grid) + bool(self.points) + (self.sample is not None) > 1:
            keys = "reynolds and parameters, points, or sample"
            raise ValueError(f"give values in one way only: {keys}; null removes a key")
        if math.prod(map(len, self.grid.values())) > MOST_VALUES:
            raise ValueError(f"parameters: makes more than {MOST_VALUES} combinations")
        viscous(self.grid)
        if self.sample is not None and self.levels:
            runs = self.sample.count * (2 if self.sample.method == "saltelli" else 1)
            if runs < (least := fewest_runs(self.levels)):
                reason = f"is too small for intervals of sweep.quantiles: {least} runs are needed"
                raise ValueError(f"sample.count: {reason}; got {runs}")
        return self

    @property
    def of_any_values(self) -> SweepSection:
        """The section without its values, on which a single run does not depend."""
        values = ("reynolds", "parameters", "points", "sample", "quantiles")
        return SweepSection(**{name: each for name, each in self if name not in values})

    @property
    def grid(self) -> Mapping[str, tuple[float, ...]]:
        """The values of each parameter; all their combinations are run."""
        reynolds = {} if self.reynolds is None else {REYNOLDS: self.reynolds}
        return {
            name: tuple(entry.values.tolist()) if isinstance(entry, SpreadSection) else entry
            for name, entry in {**reynolds, **self.parameters}.items()
        }

    @property
    def named(self) -> list[Collection[str]]:
        """The names of parameters of each point; a sample or a grid is one entry."""
        drawn = self.sample.entries if self.sample else {}
        return [*self.points, *filter(None, (drawn, self.grid))]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all parameters."""
        return tuple(dict.fromkeys(name for names in self.named for name in names))

    @property
    def levels(self) -> tuple[float, ...]:
        """The levels of quantiles to compute; none for a box with too few runs."""
        sample = self.sample
        some = sample and (sample.is_random or sample.count >= fewest_runs(self.quantiles))
        return self.quantiles if some else ()
