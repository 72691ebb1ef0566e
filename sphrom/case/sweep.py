"""The section `sweep` of a case: a model, and the parameter values at which it is run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, model_validator

from sphrom.case.fields import (
    LARGEST,
    SMALLEST,
    Coordinate,
    Flag,
    Number,
    Positive,
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
    sampled,
    unit_sample,
)
from sphrom.metrics import draws
from sphrom.metrics.draws import fewest_runs, saltelli_design
from sphrom.text import exact

MOST_VALUES = 100_000
"""Values of one sweep."""
NEVER = 1e-9
"""Probability of impossible values below which no draw is ever among them."""
WHOLE_STEPS_TOLERANCE = 1e-6
"""How far, relatively, a range may be from a whole number of steps."""

Share = Annotated[Number, Field(ge=1e-4, le=1.0 - 1e-4)]
Place = Annotated[tuple[Number, ...], Field(min_length=2, max_length=2)]


class SpreadSection(Section):
    """Values that are spread over a range."""

    low: Positive = key(..., "the least of the range", unit="-")
    high: Positive = key(..., "the greatest of the range", unit="-")
    count: Annotated[Whole, Field(ge=1, le=MOST_VALUES)] | None = key(
        None, "how many values; needed unless a step is given"
    )
    step: Positive | None = key(
        None, "from one value to the next, instead of a count, from low on", unit="-"
    )
    spacing: Literal["linear", "logarithmic", "random", "latin-hypercube"] = key(
        "linear",
        "their spacing: equal steps, equal factors, random draws, or one random draw from each of "
        "count equal parts",
    )
    seed: Whole = key(0, "seed of the random draw", ge=0, le=2**32 - 1)

    @model_validator(mode="after")
    def _consistent(self) -> SpreadSection:
        if self.low > self.high:
            low, high = exact(self.low), exact(self.high)
            raise ValueError(f"low, {low}, must not be above high, {high}")
        if (self.count is None) == (self.step is None):
            raise ValueError("must have either count, how many values, or step between them")
        if self.step is not None and self.spacing != "linear":
            raise ValueError(f"step: is for spacing: linear; got {self.spacing}")
        if self.spacing == "logarithmic" and self.low <= 0.0:
            raise ValueError(f"low: must be above zero for spacing: logarithmic; got {self.low:g}")
        if self.n_values > MOST_VALUES:
            raise ValueError(
                f"step: makes {self.n_values} values; at most {MOST_VALUES} are allowed"
            )
        return self

    @property
    def n_values(self) -> int:
        """How many values there are."""
        steps = (self.high - self.low) / (self.step or math.inf)
        return self.count or 1 + math.floor(steps * (1.0 + WHOLE_STEPS_TOLERANCE))

    @property
    def values(self) -> NDArray[np.float64]:
        """The values (n_values,)."""
        low, high, count = self.low, self.high, self.n_values
        if self.step is not None:
            return np.asarray(low + self.step * np.arange(count))
        if self.spacing in ("linear", "logarithmic"):
            spread = np.linspace if self.spacing == "linear" else np.geomspace
            return np.asarray(spread(low, high, count))
        # The first values are the same however many are drawn, so that a sweep can be extended.
        draws = np.random.default_rng(self.seed).random(count)
        if self.spacing == "latin-hypercube":
            draws = (np.arange(count) + draws) / count
        return np.asarray(low + (high - low) * draws)


class OtherSpreadSection(SpreadSection):
    """Values of a parameter that are spread over a range of any sign."""

    low: Coordinate = key(..., "the least of the range", unit="as the parameter")
    high: Coordinate = key(..., "the greatest of the range", unit="as the parameter")


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
            why = (
                "as reynolds and with it the viscosity must be above zero"
                if parameter == REYNOLDS
                else f"beyond {LARGEST:g} in size"
            )
            raise ValueError(
                f"{parameter}: {name} has {100.0 * share:.2g} % of its values where none is "
                f"possible, {why}; {self._remedy(low)}"
            )

    def _remedy(self, low: float) -> str:
        """Return how to truncate the distribution, or what to replace it with."""
        loc, scale = self.arguments.get("loc", 0.0), self.arguments.get("scale", 1.0)
        if self.distribution == "norm" and loc > low:
            least = math.floor(100.0 * 0.99 * loc / scale) / 100.0
            return (
                f"truncate it: {{distribution: truncnorm, a: {-least:g}, b: {least:g}, "
                f"loc: {loc:g}, scale: {scale:g}}}"
            )
        return (
            "truncate it (truncnorm, truncexpon), or choose one above zero (uniform, lognorm, beta)"
        )

    @property
    def stated(self) -> tuple[str, tuple[tuple[str, float], ...]]:
        """Its name and arguments, as what can be looked up."""
        return self.distribution, tuple(self.arguments.items())


class DrawnSection(Section):
    """Draws of parameters; every other key is a parameter with its range or distribution."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Range | DistributionSection] = Field(init=False)

    count: Whole = key(..., "how many points; of saltelli, a power of two", ge=1, le=MOST_VALUES)
    method: Literal["sobol", "halton", "latin-hypercube", "random", "saltelli"] = key(
        "sobol",
        "a sequence that fills the box evenly (sobol, halton), latin-hypercube, independent draws "
        "(random), or saltelli, which makes count (2 + number of parameters) runs for Sobol "
        "indices; of all but latin-hypercube the first points stay where more are asked for",
    )
    seed: Whole = key(0, "seed of the draws", ge=0, le=2**32 - 1)

    @model_validator(mode="after")
    def _consistent(self) -> DrawnSection:
        if not self.entries:
            raise ValueError("names no parameter: give one, such as reynolds: [50, 200]")
        for name, section in self.distributions.items():
            section.check(name)
        if self.method == "saltelli":
            if len(self.entries) < 2:
                raise ValueError(
                    "method: saltelli compares parameters: name two or more, or choose another "
                    "method"
                )
            if self.count & (self.count - 1):
                below = 2 ** (self.count.bit_length() - 1)
                raise ValueError(
                    "count: must be a power of two for method: saltelli, such as "
                    f"{below} or {2 * below}; got {self.count}"
                )
            if self.n_points > MOST_VALUES:
                raise ValueError(
                    f"count: makes {self.n_points} runs; at most {MOST_VALUES} are allowed"
                )
        return self

    def check_count(self, levels: tuple[float, ...]) -> None:
        """Raise ValueError unless there are draws enough for intervals of some quantiles."""
        per_count = 2 if self.method == "saltelli" else 1
        fewest = fewest_runs(levels)
        if per_count * self.count < fewest:
            least = fewest if per_count == 1 else 2 ** math.ceil(math.log2(fewest / 2))
            raise ValueError(
                "sample.count: is too small for intervals of sweep.quantiles: at least "
                f"{least} are needed; got {self.count}"
            )

    @property
    def entries(self) -> Mapping[str, tuple[float, ...] | DistributionSection]:
        """The range or the distribution of each parameter."""
        return self.__pydantic_extra__ or {}

    @property
    def distributions(self) -> dict[str, DistributionSection]:
        """The parameters that have a distribution."""
        return {k: v for k, v in self.entries.items() if isinstance(v, DistributionSection)}

    @property
    def has_statistics(self) -> bool:
        """Whether its points are draws of random parameters, of which outputs have statistics."""
        return bool(self.distributions) or self.method in ("random", "saltelli")

    @property
    def n_points(self) -> int:
        """How many points there are."""
        return self.count * (len(self.entries) + 2 if self.method == "saltelli" else 1)

    @property
    def rows(self) -> tuple[tuple[float, ...], ...]:
        """The points' values: of random parameters with all digits, else with six."""
        bounds = tuple(v for v in self.entries.values() if not isinstance(v, DistributionSection))
        if not self.has_statistics:
            return sampled(self.method, self.count, self.seed, bounds)
        given = tuple(
            (v.distribution, tuple(v.arguments.items()))
            if isinstance(v, DistributionSection)
            else v
            for v in self.entries.values()
        )
        return _drawn(self.method, self.count, self.seed, given)


@lru_cache(maxsize=8)
def _drawn(
    method: str, count: int, seed: int, entries: tuple[tuple[object, ...], ...]
) -> tuple[tuple[float, ...], ...]:
    """Return points of a design; entries are ranges, or names of distributions with arguments."""
    if method == "saltelli":
        shares = saltelli_design(unit_sample("sobol", count, seed, 2 * len(entries)))
    else:
        shares = unit_sample(method, count, seed, len(entries))
    columns = []
    for entry, column in zip(entries, shares.T, strict=True):
        match entry:
            case (str(name), tuple(arguments)):
                columns.append(draws.quantiles(name, dict(arguments), column))
            case (float(low), float(high)):
                columns.append(low + (high - low) * column)
    return tuple(map(tuple, np.stack(columns, axis=1).tolist()))


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
    parameters: dict[SafeName, OtherValues | OtherSpreadSection] = key(
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
        "parameters; of draws quantiles and other statistics are computed",
    )
    quantiles: Annotated[tuple[Share, ...], Field(min_length=1, max_length=99)] = key(
        (0.05, 0.25, 0.5, 0.75, 0.95), "the quantiles of outputs of draws, rising, such as 0.5"
    )
    sensitivities: Flag = key(
        False,
        "whether to differentiate the kinetic energy, forces, flow rates and probes at the end by "
        "the parameters, for models with operators",
    )
    probes: tuple[Place, ...] = key(
        (), "places [x, y] in the fluid where velocity and pressure are stored over time", unit="m"
    )

    @model_validator(mode="after")
    def _consistent(self) -> SweepSection:
        if any(low >= high for low, high in pairwise(self.quantiles)):
            raise ValueError("quantiles: must rise")
        if bool(self.grid) + bool(self.points) + (self.sample is not None) > 1:
            keys = "reynolds and parameters, points, or sample"
            raise ValueError(f"give values in one way only: {keys}; null leaves one out")
        sizes = [g.n_values if isinstance(g, SpreadSection) else len(g) for g in self.grid.values()]
        if len(sizes) > 1 and (n_points := math.prod(sizes)) > MOST_VALUES:
            raise ValueError(
                f"parameters: makes {n_points} combinations; at most {MOST_VALUES} are allowed"
            )
        if self.sample is not None and self.levels:
            self.sample.check_count(self.levels)
        return self

    @property
    def grid(self) -> dict[str, tuple[float, ...] | SpreadSection]:
        """Lists and ranges by parameter, of which every combination is run."""
        reynolds = {} if self.reynolds is None else {REYNOLDS: self.reynolds}
        return {**reynolds, **self.parameters}

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that are named."""
        drawn = self.sample.entries if self.sample else {}
        listed = (name for point in self.points for name in point)
        return tuple(dict.fromkeys((REYNOLDS, *self.parameters, *listed, *drawn)))

    @property
    def levels(self) -> tuple[float, ...]:
        """The quantiles that are computed, none where points are no draws."""
        return self.quantiles if self.sample and self.sample.has_statistics else ()
