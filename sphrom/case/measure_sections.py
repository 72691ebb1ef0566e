"""The kinds of measurements, one class each: keys, quantities, checks, and how it measures.

A class names its quantities, entries of `sphrom.metrics.quantities`. A kind that measures fields
gives their places and integrals as a `FieldMeasure`, which full runs, models and fits use alike.
`MEASURES` lists all kinds.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol, Self

import numpy as np
from pydantic import ConfigDict, Field

from sphrom.arrays import Array
from sphrom.case.fields import (
    Coordinate,
    Duration,
    OneOf,
    Point,
    Positive,
    SafeName,
    Section,
    Whole,
    key,
)
from sphrom.metrics.measures import FieldMeasure, FlowRate, Integral, Quantities
from sphrom.metrics.quantities import AXES, COEFFICIENT, OF_WALLS
from sphrom.sph.domain import Domain
from sphrom.text import exact, place_text

if TYPE_CHECKING:
    from sphrom.case.models import Case

WITHIN_WALL = 0.1
"""Tolerated depth of a place in a solid, relative to the particle spacing, as circles are
polygons."""
PER_SPACING = 4
"""Places to check along a segment, per particle spacing."""
MOST_LOOKED_AT = 100_000


class MeasureSection(Section):
    """One measurement: its quantity, and the time from which statistics are computed."""

    folder: ClassVar[str] = "measure"
    """The group of its datasets in artifacts, and the beginning of its figures' names."""

    @property
    @abstractmethod
    def since(self) -> float | None:
        """The time from which statistics are computed [s], if the case gives one."""

    @property
    def quantities(self) -> tuple[str, ...]:
        """The quantities over time; none for a line."""
        return ()

    @abstractmethod
    def problem(self, case: Case) -> str | None:
        """Return why a case can't have the measurement, or None."""

    def time_problem(self, case: Case) -> str | None:
        """Return why its `from_time` is impossible, or None."""
        end = case.time.final_time
        if self.since is None or self.since < end:
            return None
        return f"from_time must be before time.final_time, {exact(end)} s; got {exact(self.since)}"


class RecordedMeasure(MeasureSection):
    """A measurement at every snapshot of a run."""

    from_time: Duration | None = key(
        None,
        "time from which means, errors and other statistics are computed; null means the end "
        "of the ramp of an inflow or of a driving that grows from zero to a constant value, "
        "otherwise the start",
        unit="s",
    )

    @property
    def since(self) -> float | None:
        return self.from_time

    @property
    def of_runs(self) -> Self:
        """The measurement without the keys that affect figures but not runs."""
        return self.model_copy(update={"from_time": None})


class CoefficientSection(Section):
    """The scales of the coefficient C of a force F = C rho U^2 L / 2 per metre of depth.

    In three dimensions F = C rho U^2 L^2 / 2.
    """

    speed: Positive = key(..., "reference speed U", unit="m/s")
    length: Positive = key(..., "reference length L", unit="m")


class ForceMeasure(RecordedMeasure):
    """The force and the torque on a wall."""

    folder: ClassVar[str] = "force"

    force_on: SafeName = key(
        ...,
        "wall: the force on it and the torque about its centroid, for a side of the box about the "
        "box's centre; in three dimensions only the force",
    )
    coefficient: CoefficientSection | None = key(
        None, "scales of the force's coefficient, which is then measured too"
    )

    @property
    def quantities(self) -> tuple[str, ...]:
        return (*OF_WALLS, *(() if self.coefficient is None else (COEFFICIENT,)))

    @property
    def of_runs(self) -> Self:
        return self.model_copy(update={"from_time": None, "coefficient": None})

    def problem(self, case: Case) -> str | None:
        names = case.scene.domain.wall_names
        if self.force_on in names:
            return None
        if self.force_on in getattr(case.scene, "porous", ()):
            return "is a porous body, which has no wall to measure a force on"
        return f"there is no such wall; the walls are {', '.join(names) or 'none'}"


class FieldsMeasure(RecordedMeasure):
    """Velocity and pressure at places, or integrals of them along a segment."""

    title: ClassVar[str]
    """The name of such measurements in a drawing of the case."""
    is_flow: ClassVar[bool] = False
    """Whether it has a positive direction, to the right of its segment."""

    @property
    def ends(self) -> tuple[Point, Point]:
        """The ends of the segment [m]; the same place twice for a point."""
        segment = getattr(self, MEASURES.kind_of(self))
        return segment.start, segment.end

    @abstractmethod
    def fields(self, particle_spacing: float) -> FieldMeasure:
        """Return the places and integrals that are measured, at a spacing [m]."""

    def problem(self, case: Case) -> str | None:
        if (problem := self._shape_problem(case.scene.domain)) is not None:
            return problem
        start, end = np.array(self.ends)
        spacing = case.plan.particle_spacing
        length = math.dist(start, end)
        if not length > 0.0:
            return "its ends are the same place"
        number = min(2 + math.ceil(PER_SPACING * length / spacing), MOST_LOOKED_AT)
        places = start + np.linspace(0.0, 1.0, number)[:, None] * (end - start)
        return outside_fluid(case.scene.domain, places, spacing)

    def _shape_problem(self, domain: Domain) -> str | None:
        """Return why its places don't fit the dimensions of the domain, or None."""
        axes = ", ".join(AXES[: domain.n_dim])
        wrong = [end for end in self.ends if len(end) != domain.n_dim]
        return f"a place has the coordinates {axes} here; got {list(wrong[0])}" if wrong else None


class SegmentSection(Section):
    """A straight segment in the fluid; its ends may be on walls."""

    # `from` is a keyword of Python.
    model_config = ConfigDict(serialize_by_alias=True)

    start: Point = key(..., "start of the segment", unit="m", alias="from")
    end: Point = key(..., "end of the segment", unit="m", alias="to")


class LineSection(SegmentSection):
    """Points at equal distances along a segment, including its ends."""

    points: Annotated[Whole, Field(ge=2, le=10_000)] = key(101, "number of points")


class FlowRateMeasure(FieldsMeasure):
    """The flow rate through a segment."""

    title: ClassVar[str] = "sections"
    is_flow: ClassVar[bool] = True
    quantities: ClassVar[tuple[str, ...]] = ("flow_rate",)

    flow_rate: SegmentSection = key(
        ...,
        "segment: the flow rate through it, positive from its left to its right side, so for a "
        "segment that goes up, flow along x is positive; in three dimensions opposite corners of a "
        "rectangle perpendicular to an axis, through which the flow rate is along this axis",
    )

    def fields(self, particle_spacing: float) -> FieldMeasure:
        return FlowRate.through(np.array(self.ends), particle_spacing)

    def _shape_problem(self, domain: Domain) -> str | None:
        if (problem := super()._shape_problem(domain)) is not None or domain.n_dim == 2:
            return problem
        if np.count_nonzero(np.subtract(*self.ends)) == 2:
            return None
        return "its corners must be equal along one axis, and differ along the two others"


class IntegralMeasure(FieldsMeasure):
    """The integrals of velocity and pressure along a segment."""

    title: ClassVar[str] = "integrals"
    quantities: ClassVar[tuple[str, ...]] = ("velocity_integral", "pressure_integral")

    integral: SegmentSection = key(
        ..., "segment: the line integrals of velocity and pressure along it"
    )

    def fields(self, particle_spacing: float) -> FieldMeasure:
        return Integral(np.array(self.ends), particle_spacing)


class ProbeMeasure(FieldsMeasure):
    """Velocity and pressure at a point."""

    title: ClassVar[str] = "probes"
    quantities: ClassVar[tuple[str, ...]] = ("velocity", "pressure")

    probe: Point = key(..., "point: its velocity and pressure", unit="m")

    @property
    def ends(self) -> tuple[Point, Point]:
        return self.probe, self.probe

    def fields(self, particle_spacing: float) -> FieldMeasure:
        return FieldMeasure(np.array([self.probe]))

    def problem(self, case: Case) -> str | None:
        domain = case.scene.domain
        place = np.array([self.probe])
        spacing = case.plan.particle_spacing
        return self._shape_problem(domain) or outside_fluid(domain, place, spacing)


class LineMeasure(FieldsMeasure):
    """Velocity and pressure along a line."""

    title: ClassVar[str] = "lines"

    line: LineSection = key(..., "segment: velocity and pressure along it")

    def fields(self, particle_spacing: float) -> FieldMeasure:
        return FieldMeasure.line(np.array(self.ends), self.line.points)


class FluidWithSurface(Protocol):
    """Fluid with a free surface, of a full or a reduced run."""

    def elevation_at(self, x: float) -> Array:
        """Return the height of the surface [m]."""

    @property
    def centre_of_mass(self) -> Array:
        """The centre of mass (..., 2) [m]."""

    @property
    def kinetic_energy(self) -> Array:
        """The kinetic energy [J/m]."""

    @property
    def potential_energy(self) -> Array:
        """The potential energy in the scene's gravity [J/m]."""


class SurfaceMeasure(RecordedMeasure):
    """A measurement that only scenes with a free surface have."""

    @abstractmethod
    def of(self, fluid: FluidWithSurface) -> Quantities:
        """Return the measurement of a fluid."""

    def problem(self, case: Case) -> str | None:
        if not case.scene.has_surface:
            return "needs fluid with a free surface; set scene.fluid"
        return None


class ElevationMeasure(SurfaceMeasure):
    """The height of the free surface at a place."""

    quantities: ClassVar[tuple[str, ...]] = ("elevation",)

    elevation: Coordinate = key(
        ...,
        "x of a vertical line: height y of the free surface of the fluid on the floor, without "
        "drops above it",
        unit="m",
    )

    def of(self, fluid: FluidWithSurface) -> Quantities:
        return {"elevation": fluid.elevation_at(self.elevation)}

    def problem(self, case: Case) -> str | None:
        if (problem := super().problem(case)) is not None:
            return problem
        domain = case.scene.domain
        if domain.periodic[1]:
            return "needs a floor; leave y out of box.periodic"
        levels = [case.scene.level_at(dict(point.others)) for point in case.plan.points]
        place = np.array([[self.elevation, min((*levels, domain.upper[1]))]])
        return outside_fluid(domain, place, case.plan.particle_spacing)


class FluidMeasure(SurfaceMeasure):
    """The centre of mass, or the energies, of the whole fluid."""

    of_fluid: Literal["centre_of_mass", "energy"] = key(
        ...,
        "fluid with a free surface: its centre of mass, or its kinetic and potential energy; the "
        "latter is zero at rest, or for a shape without level at the floor",
    )

    @property
    def quantities(self) -> tuple[str, ...]:
        if self.of_fluid == "energy":
            return ("kinetic_energy", "potential_energy")
        return (self.of_fluid,)

    def of(self, fluid: FluidWithSurface) -> Quantities:
        return {name: getattr(fluid, name) for name in self.quantities}

    def problem(self, case: Case) -> str | None:
        if (problem := super().problem(case)) is not None:
            return problem
        if self.of_fluid == "centre_of_mass" and any(case.scene.domain.periodic):
            return "fluid in a periodic box has no centre of mass; take of_fluid: energy"
        return None


class FrequencySection(Section):
    """A history whose oscillation is measured."""

    of: SafeName = key(..., "oscillating history, named as in tables of a sweep: `lift_force_y`")
    from_time: Duration | None = key(
        None,
        "time from which the history is used; null means the from_time of its measurement",
        unit="s",
    )


class FrequencyMeasure(MeasureSection):
    """The oscillation of another measurement."""

    frequency: FrequencySection = key(
        ..., "history of another measurement: frequency, amplitude and mean of its oscillation"
    )

    @property
    def since(self) -> float | None:
        return self.frequency.from_time

    def problem(self, case: Case) -> str | None:
        return None


def outside_fluid(domain: Domain, place: Array, particle_spacing: float) -> str | None:
    """Return a problem if one of some places (n_places, n_dim) is out of the box or in a solid."""
    beyond = (place < np.array(domain.lower)) | (place > np.array(domain.upper))
    for first in place[beyond.any(axis=1)][:1]:
        return f"{place_text(first)} m is outside of the box"
    in_solid = domain.distance_and_normal(place)[0] < -WITHIN_WALL * particle_spacing
    for x, y in place[in_solid][:1]:
        turns = np.flatnonzero(np.diff(~in_solid, prepend=False, append=False)).reshape(-1, 2)
        ends = place[turns - (0, 1)].reshape(-1, 4).tolist()
        fluid = " and ".join("from ({:g}, {:g}) to ({:g}, {:g}) m".format(*part) for part in ends)
        more = f"; give a segment for each part of the fluid, {fluid}" if fluid else ""
        return f"({x:g}, {y:g}) m is in a solid{more}"
    return None


MEASURES = OneOf(
    force_on=ForceMeasure,
    flow_rate=FlowRateMeasure,
    probe=ProbeMeasure,
    line=LineMeasure,
    integral=IntegralMeasure,
    elevation=ElevationMeasure,
    of_fluid=FluidMeasure,
    frequency=FrequencyMeasure,
)
"""All kinds of measurements, by the key that each one has alone."""
Measures = dict[SafeName, Annotated[MeasureSection, MEASURES]]
"""Measurements by name."""
MEASURE: Any = key({}, "measurements over time, by name")
"""The key of a scene for its measurements."""
