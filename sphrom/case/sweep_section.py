"""The section `sweep` of a case: a model, and the parameter values at which it is run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, ConfigDict, Field, model_validator

from sphrom.case.fields import (
    LARGEST,
    SMALLEST,
    Coordinate,
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

MOST_VALUES = 100_000
"""Values of one sweep."""
NEVER = 1e-9
"""Probability of impossible values below which no draw is ever among them."""

Share = Annotated[Number, Field(ge=1e-4, le=1.0 - 1e-4)]


class SpreadSection(Section):
    """Values that are spread over a range."""

    low: Coordinate = key(..., "the least of the range", unit="as the parameter")
    high: Coordinate = key(..., "the greatest of the range", unit="as the parameter")
    count: Whole = key(..., "how many values", ge=1, le=MOST_VALUES)
    spacing: Literal["linear", "logarithmic"] = key(
        "linear", "their spacing: equal steps, or equal factors"
    )

    @model_validator(mode="after")
    def _rising(self) -> SpreadSection:
        if self.low > self.high or (self.spacing == "logarithmic" and self.low <= 0.0):
            raise ValueError("low: must not be above high, and above zero for spacing: logarithmic")
        return self

    @property
    def values(self) -> NDArray[np.float64]:
        """The values (n_values,)."""
        spread = np.linspace if self.spacing == "linear" else np.geomspace
        return np.asarray(spread(self.low, self.high, self.count))


class DistributionSection(Section):
    """The distribution of a parameter; every other key is an argument of scipy's."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Coordinate] = Field(init=False)

    distribution: SafeName = key(
        ...,
        "its name in scipy.stats, such as norm, uniform, truncnorm, lognorm, triang or beta; every "
        "other key is one of its arguments, such as loc and scale",
    )

    @property
    def arguments(self) -> dict[str, float]:
        """The arguments that are given."""
        return dict(self.__pydantic_extra__ or {})

    def check(self, parameter: str) -> None:
        """Raise ValueError unless a parameter's values can be drawn from it."""
        name, arguments = self.distribution, self.arguments
        if (problem := draws.problem(name, arguments)) is not None:
            raise ValueError(f"{parameter}: {problem}")
        low = SMALLEST if parameter == REYNOLDS else -LARGEST
        share = draws.share_outside(name, arguments, low, LARGEST)
        if share > NEVER:
            raise ValueError(
                f"{parameter}: {name} has {100.0 * share:.2g} % of its values where none is "
                f"possible, below {low:g} or above {LARGEST:g}; truncate it (truncnorm, "
                "truncexpon), or choose one above zero (uniform, lognorm, beta)"
            )


class DrawnSection(SampleSection):
    """Draws of parameters; every other key is a parameter with its range or distribution."""

    __pydantic_extra__: dict[str, Range | DistributionSection]  # type: ignore[assignment]

    count: Whole = key(..., "how many points; of saltelli, a power of two", ge=1, le=MOST_VALUES)
    method: Literal["sobol", "halton", "latin-hypercube", "random", "saltelli"] = key(  # type: ignore[assignment]
        "sobol",
        "a sequence that fills the box evenly (sobol, halton), latin-hypercube, independent draws "
        "(random), or saltelli, which makes count (2 + number of parameters) runs for Sobol "
        "indices; of all but latin-hypercube the first points stay where more are asked for",
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
        """Whether its points are draws rather than a sequence that fills a box of ranges."""
        drawn = any(isinstance(entry, DistributionSection) for entry in self.entries.values())
        return drawn or self.method in ("random", "saltelli")

    @cached_property
    def points(self) -> list[dict[str, float]]:
        """The points: draws with all digits, else with six."""
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

    name: SafeName | None = key(None, "the name of its files; null is the model's name")
    model: SafeName | None = key(
        None,
        "full, or the name of a reduced model; null is the first that isn't evaluated on "
        "particles, or full where there is none",
    )
    reynolds: ReynoldsValues | SpreadSection | None = key(
        None,
        "Reynolds numbers: a list, or a range such as {low: 100, high: 200, count: 1000}; a sweep "
        "needs some",
        unit="-",
    )
    parameters: dict[SafeName, OtherValues | SpreadSection] = key(
        {},
        "further parameters by name, each a list or a range, of which with the Reynolds numbers "
        "every combination is run",
    )
    points: tuple[PointValues, ...] = key(
        (), "points one by one, each its values by name, in place of reynolds and parameters"
    )
    sample: DrawnSection | None = key(
        None,
        "points that fill a box or are drawn from distributions, in place of reynolds and "
        "parameters; quantiles and other statistics of outputs are computed",
    )
    quantiles: Annotated[
        tuple[Share, ...], Field(min_length=1, max_length=99), AfterValidator(rising)
    ] = key((0.05, 0.25, 0.5, 0.75, 0.95), "quantiles of a sample's outputs, rising, such as 0.5")
    sensitivities: Flag = key(
        False,
        "whether to differentiate the kinetic energy, forces, flow rates and probes at the end by "
        "the parameters, for models with operators",
    )

    @model_validator(mode="after")
    def _consistent(self) -> SweepSection:
        if bool(self.grid) + bool(self.points) + (self.sample is not None) > 1:
            keys = "reynolds and parameters, points, or sample"
            raise ValueError(f"give values in one way only: {keys}; null leaves one out")
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
        """The same without its values, which say nothing of a single run."""
        values = ("reynolds", "parameters", "points", "sample", "quantiles")
        return SweepSection(**{name: each for name, each in self if name not in values})

    @property
    def grid(self) -> Mapping[str, tuple[float, ...]]:
        """The values of each parameter, of which every combination is run."""
        reynolds = {} if self.reynolds is None else {REYNOLDS: self.reynolds}
        return {
            name: tuple(given.values.tolist()) if isinstance(given, SpreadSection) else given
            for name, given in {**reynolds, **self.parameters}.items()
        }

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that are named."""
        drawn = self.sample.entries if self.sample else {}
        listed = (name for point in self.points for name in point)
        return tuple(dict.fromkeys((REYNOLDS, *self.parameters, *listed, *drawn)))

    @property
    def levels(self) -> tuple[float, ...]:
        """The quantiles that are computed: of draws, and of a box with runs enough for them."""
        sample = self.sample
        some = sample and (sample.is_random or sample.count >= fewest_runs(self.quantiles))
        return self.quantiles if some else ()
