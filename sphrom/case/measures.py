"""What a case measures over time."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field, model_validator

from sphrom.case.fields import Coordinate, SafeName, Section, Whole, key

Place = Annotated[tuple[Coordinate, ...], Field(min_length=2, max_length=2)]

KINDS = ("force_on", "flow_rate", "probe", "line")
"""What can be measured."""


class SegmentSection(Section):
    """A straight segment in the fluid; its ends may be on walls."""

    # `from` is a word of Python's.
    model_config = ConfigDict(serialize_by_alias=True)

    start: Place = key(..., "where it starts", unit="m", alias="from")
    end: Place = key(..., "where it ends", unit="m", alias="to")


class LineSection(SegmentSection):
    """Places at equal distances along a segment, both ends among them."""

    points: Annotated[Whole, Field(ge=2, le=10_000)] = key(101, "how many places")


class MeasureSection(Section):
    """One measurement at every snapshot: exactly one of its keys."""

    force_on: SafeName | None = key(
        None, "a wall: its force, and the torque about its centroid, or the box's centre for a side"
    )
    flow_rate: SegmentSection | None = key(
        None,
        "a segment: the flow rate through it, positive from the left to the right of the way along "
        "it, so that one that goes up counts flow along x",
    )
    probe: Place | None = key(None, "a place: velocity and pressure there", unit="m")
    line: LineSection | None = key(None, "a segment: velocity and pressure along it")

    @model_validator(mode="after")
    def _one_kind(self) -> MeasureSection:
        given = [name for name in KINDS if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) or "none"
            raise ValueError(f"must be exactly one of {', '.join(KINDS)}; got {found}")
        return self

    @property
    def quantities(self) -> tuple[str, ...]:
        """What is measured over time, by `sphrom.metrics.measures.UNITS`; along a line nothing."""
        if self.force_on is not None:
            return ("force", "torque")
        if self.flow_rate is not None:
            return ("flow_rate",)
        return ("velocity", "pressure") if self.probe is not None else ()

    @property
    def segment(self) -> tuple[Place, Place] | None:
        """The ends of the section or the line [m]; None for a probe and a force."""
        given = self.flow_rate or self.line
        return None if given is None else (given.start, given.end)


Measures = dict[SafeName, MeasureSection]
"""Measurements by name."""


def measures() -> Measures:
    """Describe the key of a scene that says what is measured."""
    measured: Measures = key({}, "what is measured over time, by name")
    return measured
