"""The section `sweep` of a case: a model, and the parameter values at which it is run."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from sphrom.case.fields import Coordinate, Flag, Number, Positive, SafeName, Section, Whole, key
from sphrom.case.parameters import OtherValues, PointValues, ReynoldsValues, SampleSection
from sphrom.case.points import REYNOLDS

MOST_VALUES = 100_000
"""Values of one sweep."""

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


class OtherSpreadSection(SpreadSection):
    """Values of a parameter that are spread over a range of any sign."""

    low: Coordinate = key(..., "the least of the range", unit="as the parameter")
    high: Coordinate = key(..., "the greatest of the range", unit="as the parameter")


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
    sample: SampleSection | None = key(
        None, "points that fill a box, in place of reynolds and parameters"
    )
    coordinates: Flag = key(True, "whether to store the generalized coordinates of reduced runs")
    error_estimate: Flag = key(
        True,
        "whether to estimate errors of reduced models on the reference points, where operators "
        "allow it; this takes longer than the runs",
    )
    sensitivities: Flag = key(
        False,
        "whether to differentiate the kinetic energy, forces, flow rates and probes at the end by "
        "the parameters, for models with operators",
    )
    probes: tuple[Place, ...] = key(
        (), "places [x, y] in the fluid where velocity and pressure are stored over time", unit="m"
    )

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that are named."""
        sampled = self.sample.ranges if self.sample else {}
        listed = (name for point in self.points for name in point)
        return tuple(dict.fromkeys((REYNOLDS, *self.parameters, *listed, *sampled)))
