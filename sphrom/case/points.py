"""Parameter points: the values of the scene's parameters at which one run is made."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from sphrom.case.fields import LARGEST, SMALLEST
from sphrom.text import exact

REYNOLDS = "reynolds"
"""The parameter that every point has: it gives the viscosity."""
Values = float | dict[str, float]
"""The values of a point as a case gives them; a number is a Reynolds number."""


def impossible(name: str, value: float) -> str | None:
    """Return why a parameter can't have a value; None where it can."""
    if name != REYNOLDS or SMALLEST <= value <= LARGEST:
        return None
    return f"must be above zero ({SMALLEST:g} to {LARGEST:g}); got {exact(value)}"


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

    @property
    def given(self) -> Values:
        """The values as lists of a case take them: a number where nothing else varies."""
        return self.as_dict() if self.others else self.reynolds

    def as_dict(self) -> dict[str, float]:
        """Return the values by name."""
        return {REYNOLDS: self.reynolds, **self.factors}


def nearest_point(point: ParameterPoint, known: Iterable[ParameterPoint]) -> ParameterPoint:
    """Return the known point nearest to a point; each parameter counts over its largest value."""
    points = list(known)
    rows = [list(other.as_dict().values()) for other in points]
    sizes = [max(map(abs, column)) or 1.0 for column in zip(*rows, strict=True)]
    place = list(point.as_dict().values())

    def distance(row: list[float]) -> float:
        parts = ((a - b) / size for a, b, size in zip(row, place, sizes, strict=True))
        return math.hypot(*parts)

    return points[min(range(len(points)), key=lambda k: distance(rows[k]))]


def near(point: ParameterPoint, known: Iterable[ParameterPoint]) -> str:
    """Return which of the known points is nearest to a point, in words."""
    return f"the nearest is {nearest_point(point, known).label}"


def outside(point: ParameterPoint, trained: Iterable[ParameterPoint]) -> dict[str, str]:
    """Return the parameters of a point that are beyond the trained values, with their ranges."""
    points, found = [other.as_dict() for other in trained], {}
    for name, value in point.as_dict().items():
        low, high = min(p[name] for p in points), max(p[name] for p in points)
        if not low <= value <= high:
            found[name] = f"{exact(low)} to {exact(high)}"
    return found
