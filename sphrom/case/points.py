"""Parameter points: the values of the scene's parameters at which one run is made."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from sphrom.text import exact


@dataclass(frozen=True, order=True)
class ParameterPoint:
    """The values that tell one run of a case from another."""

    reynolds: float

    @property
    def label(self) -> str:
        """How a person reads it, such as `reynolds=100`: no two points have the same."""
        return ", ".join(f"{name}={exact(value)}" for name, value in self.as_dict().items())

    @property
    def file_label(self) -> str:
        """How file names spell it, such as `reynolds100`: no two points have the same."""
        return "-".join(f"{name}{exact(value)}" for name, value in self.as_dict().items())

    def as_dict(self) -> dict[str, float]:
        """Return the values by name."""
        return {"reynolds": self.reynolds}


def near(point: ParameterPoint, known: Iterable[ParameterPoint]) -> str:
    """Return which of the known points is nearest to a point, in words."""
    nearest_point = min(known, key=lambda other: abs(other.reynolds - point.reynolds))
    return f"the nearest is {nearest_point.label}"
