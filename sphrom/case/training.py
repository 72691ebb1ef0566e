"""The section `training` of a case: the region of parameters that `sphrom train` makes a model for.

Every key that isn't named here is a parameter with its least and greatest value.
"""

from __future__ import annotations

import math
import re
from typing import Annotated, Literal

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from sphrom.case.fields import SafeName, Section, Whole, key
from sphrom.case.parameters import Range
from sphrom.case.points import REYNOLDS, impossible

MOST_CANDIDATES = 100_000
PERCENTAGE = re.compile(r"\s*([0-9.eE+-]+)\s*%\s*")


def percentage(text: str) -> float:
    """Return the number of a text such as `1%`. Raises ValueError for anything else."""
    found = PERCENTAGE.fullmatch(text)
    try:
        value = float(found[1]) if found else math.nan
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError("must be a percentage above zero, such as 1%")
    return value


def _checked(text: str) -> str:
    percentage(text)
    return text


Percentage = Annotated[str, Field(strict=True), AfterValidator(_checked)]


class TrainingSection(Section):
    """A region of the parameters, and the error allowed of a model anywhere in it."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Range] = Field(init=False)

    tolerance: Percentage = key(
        "1%", "error allowed of the model, over the field's size, root mean squares over a run"
    )
    quantity: Literal["velocity", "pressure", "both"] = key("velocity", "whose error is meant")
    budget: Annotated[Whole, Field(ge=2, le=10_000)] = key(
        8, "most full runs to learn from, those that are there already too"
    )
    model: SafeName | None = key(
        None,
        "the model by its name, of those with evaluation: operators; null is the first of these",
    )
    candidates: Annotated[Whole, Field(ge=1, le=MOST_CANDIDATES)] = key(
        100, "how many points of the region the model's error is estimated at"
    )
    seed: Whole = key(0, "seed of the points' random shift", ge=0, le=2**32 - 1)

    @model_validator(mode="after")
    def _viscous(self) -> TrainingSection:
        low, _ = self.ranges.get(REYNOLDS, (1.0, 1.0))
        if (reason := impossible(REYNOLDS, low)) is not None:
            raise ValueError(f"{REYNOLDS}: {reason}")
        return self

    @property
    def ranges(self) -> dict[str, tuple[float, ...]]:
        """The least and the greatest value of each parameter, none where there is no region."""
        return dict(self.__pydantic_extra__ or {})

    @property
    def fields(self) -> tuple[int, ...]:
        """Which of velocity, 0, and pressure, 1, count."""
        return {"velocity": (0,), "pressure": (1,), "both": (0, 1)}[self.quantity]
