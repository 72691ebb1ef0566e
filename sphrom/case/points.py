"""Parameter points, and the section `parameters` of a case that lists them.

A point has the parameter values of one run. Points are a grid of lists, such as
`{reynolds: [50, 200], lid: [0.5, 1]}`, a list of points, or a sample of a box. All three accept any
names of parameters; `sphrom.case.checks` checks them.
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
"""The parameter that every point has; it determines the viscosity."""
Values = float | dict[str, float]
"""The values of a point in a case file; a number is a Reynolds number."""


@dataclass(frozen=True, order=True)
class ParameterPoint:
    """The parameter values of one run of a case."""

    reynolds: float
    others: tuple[tuple[str, float], ...] = ()
    """Names and values of the parameters other than the Reynolds number, in the case's order."""

    @property
    def label(self) -> str:
        """The unique label in messages, such as `reynolds=100, lid=0.8`."""
        return self.label_of(self.as_dict())

    def label_of(self, names: Iterable[str]) -> str:
        """Return the values of some parameters in words."""
        values = self.as_dict()
        return ", ".join(f"{name}={exact(values[name])}" for name in names)

    @property
    def file_label(self) -> str:
        """The unique label in file names, such as `reynolds100-lid0.8`."""
        return "-".join(f"{name}{exact(value)}" for name, value in self.as_dict().items())

    @property
    def factors(self) -> dict[str, float]:
        """The values of the parameters other than the Reynolds number, by name."""
        return dict(self.others)

    @property
    def rounded(self) -> ParameterPoint:
        """The point with 12 digits, which is the same for values that differ by rounding."""
        others = tuple((name, float(f"{value:.12g}")) for name, value in self.others)
        return ParameterPoint(float(f"{self.reynolds:.12g}"), others)

    def as_dict(self) -> dict[str, float]:
        """Return the values by name."""
        return {REYNOLDS: self.reynolds, **self.factors}


def nearest_point(point: ParameterPoint, known: Iterable[ParameterPoint]) -> ParameterPoint:
    """Return the known point nearest to a point, with parameters over their largest values."""
    points = list(known)
    rows = np.array([[*other.as_dict().values()] for other in points])
    largest = np.abs(rows).max(axis=0)
    offset = (rows - [*point.as_dict().values()]) / np.where(largest > 0.0, largest, 1.0)
    return points[int(np.argmin(np.linalg.norm(offset, axis=1)))]


def outside(point: ParameterPoint, trained: Iterable[ParameterPoint]) -> dict[str, str]:
    """Return the trained ranges that a point is outside of."""
    points, ranges = [other.as_dict() for other in trained], {}
    for name, value in point.as_dict().items():
        low = min(p[name] for p in points)
        high = max(p[name] for p in points)
        if not low <= value <= high:
            ranges[name] = exact(low) if low == high else f"{exact(low)} to {exact(high)}"
    return ranges


MAX_RUNS = 1000
"""Largest numbers of full runs of a case and of points of a reduced model; sweeps allow more."""
DIGITS = 6
"""Digits of sampled values, which are part of file names."""

ReynoldsValues = Annotated[tuple[Positive, ...], Field(min_length=1)]
REYNOLDS_WORDS = (
    "Reynolds numbers U_max L / nu, with the scene's length L, for the open cavity the cavity's"
)
OtherValues = Annotated[tuple[Coordinate, ...], Field(min_length=1)]


def ordered(values: Sequence[float], *, strict: bool = False) -> Sequence[float]:
    """Return the values. Raises ValueError where they fall or, if `strict`, are equal."""
    if any(low > high or (strict and low == high) for low, high in pairwise(values)):
        raise ValueError(f"must rise; got {', '.join(map(exact, values))}")
    return values


rising = partial(ordered, strict=True)


def viscous(values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return numbers, or lists of them, by parameter, unchanged.

    Raises ValueError unless all Reynolds numbers, and so all viscosities, are positive.
    """
    for value in np.ravel(values.get(REYNOLDS, 1.0)):
        if not SMALLEST <= value <= LARGEST:
            allowed = f"above zero ({SMALLEST:g} to {LARGEST:g})"
            raise ValueError(f"{REYNOLDS}: must be {allowed}; got {exact(value)}")
    return values


Interval = Annotated[Place, AfterValidator(ordered)]
"""The least and the greatest value, which may be equal."""
Range = Annotated[Place, AfterValidator(rising), Field(description="a range [low, high]")]
"""The least value, and a greater one."""

PointValues = Annotated[dict[SafeName, Coordinate], AfterValidator(viscous)]
"""The values of one point by name; `Plan.usual_values` are those of the other parameters."""
Listed = Annotated[tuple[Positive | PointValues, ...], Field(min_length=1, max_length=MAX_RUNS)]
"""A list of points; a number is a Reynolds number."""


class SampleSection(Section):
    """Points that fill a box; every other key is a parameter with its least and greatest value."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Range] = Field(init=False)

    count: Whole = key(..., "number of points", ge=1, le=100_000)
    method: Literal["sobol", "halton", "latin-hypercube"] = key(
        "sobol",
        "sequence of points; with sobol and halton, a larger count keeps the earlier points",
    )
    seed: Whole = key(0, "seed of the random shift", ge=0, le=2**32 - 1)

    @model_validator(mode="after")
    def _of_a_parameter(self) -> SampleSection:
        if not self.entries:
            raise ValueError("names no parameter: give one, such as reynolds: [50, 200]")
        viscous({name: entry for name, entry in self.entries.items() if isinstance(entry, tuple)})
        return self

    @property
    def entries(self) -> Mapping[str, Any]:
        """The entry of each parameter, such as its least and greatest value."""
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
    """Return points (count, n_parameters) in the unit cube."""
    if method == "random":
        return np.random.default_rng(seed).random((count, n_parameters))
    from scipy.stats import qmc  # late, because it takes long to load

    kinds = {"sobol": qmc.Sobol, "halton": qmc.Halton, "latin-hypercube": qmc.LatinHypercube}
    with warnings.catch_warnings():
        # Sequences warn if the count is not a power of two; less balance does no harm here.
        warnings.simplefilter("ignore", UserWarning)
        return kinds[method](n_parameters, rng=seed).random(count)


class GivenPoints(Section):
    """Points: a grid of lists by parameter, or `points`, or `sample`."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, OtherValues] = Field(init=False)

    reynolds: tuple[Positive, ...] = key((), REYNOLDS_WORDS, unit="-")
    points: tuple[PointValues, ...] = key(
        (), "list of points, each with its values by name, instead of a grid of lists"
    )
    sample: SampleSection | None = key(None, "points that fill a box, instead of a grid")

    @model_validator(mode="after")
    def _one_way(self) -> GivenPoints:
        if self.points and self.sample is not None:
            raise ValueError("sample: can't be combined with points; give one of the two")
        if (self.points or self.sample) and self.__pydantic_extra__:
            other = next(iter(self.__pydantic_extra__))
            raise ValueError(f"{other}: can't be combined with points or sample; leave one out")
        return self

    @property
    def lists(self) -> dict[str, tuple[float, ...]]:
        """The lists of a grid by parameter, Reynolds numbers first."""
        return {REYNOLDS: self.reynolds, **(self.__pydantic_extra__ or {})}

    @property
    def named(self) -> list[list[str]]:
        """The names of parameters of each point; a sample or a grid is one entry."""
        if self.sample is not None:
            return [list(self.sample.entries)]
        grid = [name for name, values in self.lists.items() if values]
        return [list(point) for point in self.points] or ([grid] if grid else [])

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all parameters, in order."""
        return tuple(dict.fromkeys(name for names in self.named for name in names))

    @property
    def values(self) -> list[dict[str, float]]:
        """The values of all points by name."""
        if self.sample is not None:
            return self.sample.points
        if self.points:
            return list(self.points)
        lists = self.lists
        if len(lists) > 1 and not lists[REYNOLDS]:
            del lists[REYNOLDS]
        return [dict(zip(lists, row, strict=True)) for row in product(*lists.values())]

    @property
    def n_points(self) -> int:
        """The number of points, without listing them."""
        if self.sample is not None:
            return self.sample.count
        lists = self.lists
        return len(self.points) or math.prod(len(v) or len(lists) > 1 for v in lists.values())


class TrainValues(GivenPoints):
    """The parameter values of training runs."""

    reynolds: ReynoldsValues = key((100.0,), REYNOLDS_WORDS, unit="-")

    @property
    def own_reynolds(self) -> float | None:
        """The Reynolds number of all points that name one, or of the list; None if they differ."""
        drawn = self.sample.entries if self.sample is not None else {}
        listed = [point[REYNOLDS] for point in self.points if REYNOLDS in point]
        found = set(drawn.get(REYNOLDS) or listed or self.reynolds)
        return found.pop() if len(found) == 1 else None


class TestValues(GivenPoints):
    """The parameter values of test runs, which only check predictions."""

    __test__ = False  # keeps pytest from collecting it as a test


class ParameterSection(Section):
    """The parameter values for training and for testing."""

    train: TrainValues = key(
        TrainValues(), "values of training runs; every other key is a parameter with its values"
    )
    test: TestValues = key(
        TestValues(),
        "values of full runs that only check predictions; every other key is a parameter with its "
        "values",
    )

    @model_validator(mode="after")
    def _not_too_many(self) -> ParameterSection:
        if self.train.n_points + self.test.n_points > MAX_RUNS:
            raise ValueError(f"at most {MAX_RUNS} values in all")
        return self
