"""The section `fit` of a case: which parameters measurements are to tell, and by which model."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from sphrom.case.fields import Coordinate, Number, SafeName, Section, Whole, key
from sphrom.case.parameters import Range
from sphrom.case.points import REYNOLDS, impossible

MOST_STARTS = 1000
"""Of one search."""
LEAST_PERCENT, MOST_PERCENT = 1e-6, 1e3
"""Noise over a history's range."""
Percent = Annotated[Number, Field(ge=LEAST_PERCENT, le=MOST_PERCENT)]


class FitSection(Section):
    """Parameters of a reduced model from measured histories."""

    model: SafeName | None = key(
        None, "a reduced model with evaluation: operators; null is the first"
    )
    parameters: dict[SafeName, Coordinate | Range] = key(
        {},
        "by name the range [low, high] to look for a parameter in, or its known value; others that "
        "vary in the case are looked for in their trained range",
        unit="as the parameter",
    )
    noise: Percent | None = key(
        None,
        "standard deviation of the noise over the range of each history, where the measurements "
        "say none",
        unit="%",
    )
    starts: Whole = key(
        8, "how many starts the search has, spread over the ranges", ge=1, le=MOST_STARTS
    )

    @model_validator(mode="after")
    def _viscous(self) -> FitSection:
        given = self.parameters.get(REYNOLDS, 1.0)
        low = given[0] if isinstance(given, tuple) else given
        if (reason := impossible(REYNOLDS, low)) is not None:
            raise ValueError(f"parameters.{REYNOLDS}: {reason}")
        return self
