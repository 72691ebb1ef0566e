"""Parameter points, and the section `parameters` of a case that lists them.

A point has the values of the scene's parameters at which one run is made. Points are a grid of
lists, such as `{reynolds: [50, 200], lid: [0.5, 1]}`, a list of points, or a sample of a box. All
three name parameters freely: `sphrom.case.checks` checks the names.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise, product
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, ConfigDict, Field, model_validator

from sphrom.case.fields import (
    LARGEST,
    SMALLEST,
    Coordinate,
    Place,
    Positive,
    SafeName,
    Section,
    Whole,
    key,
)
from sphrom.text import exact

REYNOLDS = "reynolds"
"""The parameter that every point has: it gives the viscosity."""
Values = float | dict[str, float]
"""The values of a point as a case gives them; a number is a Reynolds number."""


@dataclass(frozen=True, order=True)
class ParameterPoint:
    """The values that tell one run of a case from another."""

    reynolds: float
    others: tuple[tuple[str, float], ...] = ()
    """Name and value of what varies beside the viscosity, in the case's order."""

    @property
    def label(self) -> str:
        """How a person reads it, such as `reynolds=100, lid=0.8`: no two points have the same."""
        return ", ".join(f"{name}={exact(value)}" for name, value in self.as_dict().items())

    @property
    def file_label(self) -> str:
        """How file names spell it, such as `reynolds100-lid0.8`: no two points have the same."""
        return "-".join(f"{name}{exact(value)}" for name, value in self.as_dict().items())

    @property
    def factors(self) -> dict[str, float]:
        """The values by name of what varies beside the viscosity."""
        return dict(self.others)

    def as_dict(self) -> dict[str, float]:
        """Return the values by name."""
        return {REYNOLDS: self.reynolds, **self.factors}


def nearest_point(point: ParameterPoint, known: Iterable[ParameterPoint]) -> ParameterPoint:
    """Return the known point nearest to a point; each parameter counts over its largest value."""
    rows = {other: other.as_dict().values() for other in known}
    sizes = [max(map(abs, column)) or 1.0 for column in zip(*rows.values(), strict=True)]

    def distance(other: ParameterPoint) -> float:
        parts = zip(rows[other], point.as_dict().values(), sizes, strict=True)
        return math.hypot(*((a - b) / size for a, b, size in parts))

    return min(rows, key=distance)


def outside(point: ParameterPoint, trained: Iterable[ParameterPoint]) -> dict[str, str]:
    """Return the parameters of a point that are beyond the trained values, with their ranges."""
    points, found = [other.as_dict() for other in trained], {}
    for name, value in point.as_dict().items():
        low, high = min(p[name] for p in points), max(p[name] for p in points)
        if not low <= value <= high:
            found[name] = exact(low) if low == high else f"{exact(low)} to {exact(high)}"
    return found


MAX_RUNS = 1000
"""Full runs of one case, and values of one reduced model; sweeps have more."""
DIGITS = 6
"""Of sampled values: they name files."""

ReynoldsValues = Annotated[tuple[Positive, ...], Field(min_length=1)]
REYNOLDS_WORDS = (
    "Reynolds numbers U_max L / nu, L the scene's length, of the open cavity its cavity's"
)
OtherValues = Annotated[tuple[Coordinate, ...], Field(min_length=1)]


def ordered(values: Sequence[float], *, strict: bool = False) -> Sequence[float]:
    """Return some values. Raises ValueError where they fall, or don't rise and have to."""
    if any(low > high or (strict and low == high) for low, high in pairwise(values)):
        raise ValueError(f"must rise; got {', '.join(map(exact, values))}")
    return values


rising = partial(ordered, strict=True)


def viscous(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return numbers, or lists of them, by parameter.

    Raises ValueError unless each Reynolds number is positive: the viscosity has to be.
    """
    for value in np.ravel(values.get(REYNOLDS, 1.0)):
        if not SMALLEST <= value <= LARGEST:
            allowed = f"above zero ({SMALLEST:g} to {LARGEST:g})"
            raise ValueError(f"{REYNOLDS}: must be {allowed}; got {exact(value)}")
    return values


Interval = Annotated[Place, AfterValidator(ordered)]
"""The least and the greatest value, which may be one."""
Range = Annotated[Place, AfterValidator(rising), Field(description="a range [low, high]")]
"""The least value, and a greater one."""

PointValues = Annotated[dict[SafeName, Coordinate], AfterValidator(viscous)]
"""The values of one point by name; one that isn't named has the scene's own value."""
Listed = Annotated[tuple[Positive | PointValues, ...], Field(min_length=1, max_length=MAX_RUNS)]
"""Points one by one; a number is a Reynolds number."""


class SampleSection(Section):
    """Points that fill a box; every other key is a parameter with its least and greatest value."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Range] = Field(init=False)

    count: Whole = key(..., "how many points", ge=1, le=100_000)
    method: Literal["sobol", "halton", "latin-hypercube"] = key(
        "sobol", "the sequence; of sobol and halton the first points stay where more are asked for"
    )
    seed: Whole = key(0, "seed of its random shifts", ge=0, le=2**32 - 1)

    @model_validator(mode="after")
    def _of_a_parameter(self) -> SampleSection:
        if not self.entries:
            raise ValueError("names no parameter: give one, such as reynolds: [50, 200]")
        viscous({name: entry for name, entry in self.entries.items() if isinstance(entry, tuple)})
        return self

    @property
    def entries(self) -> Mapping[str, Any]:
        """What is given of each parameter, such as its least and greatest value."""
        return self.__pydantic_extra__ or {}

    @cached_property
    def points(self) -> list[dict[str, float]]:
        """The sampled points, to six digits."""
        shares = unit_sample(self.method, self.count, self.seed, len(self.entries))
        return [
            {
                name: float(f"{low + (high - low) * share:.{DIGITS}g}")
                for share, (name, (low, high)) in zip(row, self.entries.items(), strict=True)
            }
            for row in shares.tolist()
        ]


def unit_sample(method: str, count: int, seed: int, n_parameters: int) -> NDArray[np.float64]:
    """Return points (count, n_parameters) of a unit cube."""
    if method == "random":
        return np.random.default_rng(seed).random((count, n_parameters))
    from scipy.stats import qmc  # it takes long to load

    kinds = {"sobol": qmc.Sobol, "halton": qmc.Halton, "latin-hypercube": qmc.LatinHypercube}
    with warnings.catch_warnings():
        # Counts other than powers of two are less balanced, which is no harm here.
        warnings.simplefilter("ignore", UserWarning)
        return np.asarray(kinds[method](n_parameters, rng=seed).random(count))


class GivenPoints(Section):
    """Points: a grid of lists by parameter, or `points`, or `sample`."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, OtherValues] = Field(init=False)

    reynolds: tuple[Positive, ...] = key((), REYNOLDS_WORDS, unit="-")
    points: tuple[PointValues, ...] = key(
        (), "points one by one, each its values by name, in place of a grid of lists by name"
    )
    sample: SampleSection | None = key(None, "points that fill a box, in place of a grid")

    @model_validator(mode="after")
    def _one_way(self) -> GivenPoints:
        if self.points and self.sample is not None:
            raise ValueError("sample: is in place of points; give one of the two")
        if (self.points or self.sample) and self.__pydantic_extra__:
            other = next(iter(self.__pydantic_extra__))
            raise ValueError(f"{other}: is a list of a grid; leave out points and sample, or it")
        return self

    @property
    def lists(self) -> dict[str, tuple[float, ...]]:
        """The lists of a grid by parameter, the Reynolds numbers first."""
        return {REYNOLDS: self.reynolds, **(self.__pydantic_extra__ or {})}

    @property
    def named(self) -> list[list[str]]:
        """The parameters that each point, or all of a sample or a grid, name."""
        if self.sample is not None:
            return [list(self.sample.entries)]
        grid = [name for name, values in self.lists.items() if values]
        return [list(point) for point in self.points] or ([grid] if grid else [])

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that are named, in order."""
        return tuple(dict.fromkeys(name for names in self.named for name in names))

    def values(self, reynolds: tuple[float, ...]) -> list[dict[str, float]]:
        """Return the values of all points; a grid without Reynolds numbers has those given."""
        if self.sample is not None:
            return self.sample.points
        if self.points:
            return list(self.points)
        lists = self.lists
        if len(lists) > 1 and not lists[REYNOLDS]:
            lists[REYNOLDS] = reynolds
        return [dict(zip(lists, row, strict=True)) for row in product(*lists.values())]

    @property
    def n_points(self) -> int:
        """How many points there are, without listing them."""
        if self.sample is not None:
            return self.sample.count
        lists = self.lists
        return len(self.points) or math.prod(len(v) or len(lists) > 1 for v in lists.values())


class TrainValues(GivenPoints):
    """Where the full model is run to learn from."""

    reynolds: ReynoldsValues = key((100.0,), REYNOLDS_WORDS, unit="-")


class TestValues(GivenPoints):
    """Where the full model is run only to check predictions."""

    __test__ = False  # pytest would take it for a test


class ParameterSection(Section):
    """The values of the parameters to learn from and to predict."""

    train: TrainValues = key(
        TrainValues(), "values to learn from; every other key is a parameter with its values"
    )
    test: TestValues = key(
        TestValues(),
        "values to predict, with a full run to compare with; every other key is a parameter with "
        "its values",
    )

    @model_validator(mode="after")
    def _not_too_many(self) -> ParameterSection:
        if self.train.n_points + self.test.n_points > MAX_RUNS:
            raise ValueError(f"at most {MAX_RUNS} values in all")
        return self
