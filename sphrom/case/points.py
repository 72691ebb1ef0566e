"""Parameter points: the values of the scene's parameters at which one run is made."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, order=True)
class ParameterPoint:
    """The values that tell one run of a case from another."""

    reynolds: float

    @property
    def label(self) -> str:
        """How a person reads it, such as `reynolds=100`."""
        return ", ".join(f"{name}={value:g}" for name, value in self.as_dict().items())

    @property
    def file_label(self) -> str:
        """How file names spell it, such as `reynolds100`."""
        return "-".join(f"{name}{value:g}" for name, value in self.as_dict().items())

    def as_dict(self) -> dict[str, float]:
        """Return the values by name."""
        return {"reynolds": self.reynolds}


def near(point: ParameterPoint, known: Iterable[ParameterPoint]) -> str:
    """Return which of the known points is nearest to a point, in words."""
    nearest_point = min(known, key=lambda other: abs(other.reynolds - point.reynolds))
    return f"the nearest is {exactly(nearest_point)}"


def exactly(point: ParameterPoint) -> str:
    """Return a point's label with every digit that its values have."""
    values = ((name, value, f"{value:g}") for name, value in point.as_dict().items())
    return ", ".join(
        f"{name}={short if float(short) == value else repr(value)}" for name, value, short in values
    )
