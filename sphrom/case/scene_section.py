"""The base class of all kinds of scene, with the properties that the program needs of them."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator

from sphrom.arrays import Array
from sphrom.case.fields import (
    Coordinate,
    Duration,
    Place,
    Positive,
    SafeName,
    Section,
    Whole,
    key,
    only_one,
)
from sphrom.metrics.measures import COEFFICIENT, Column
from sphrom.scenes.flows import Channel, Scales, Scene
from sphrom.scenes.reference_profiles import ReferenceProfile
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import NONE, Fluid, Strip

Defaults = Mapping[str, Any]
Settings = Sequence[Mapping[str, float]]
"""Values of the parameters except the Reynolds number, of all points."""
OF_WALLS: Defaults = {
    "fluid": {"reference_density": 1.0},
    "discretization": {"smoothing_length_ratio": 2.0},
    "psi": {"polynomial_degree": 3},
    "compare": {"exact": False},
}
"""Defaults of other sections for scenes with walls."""


class SceneSection(Section):
    """A kind of scene, the base class of the sections that a case may have."""

    title: ClassVar[str]
    """The scene's name in a report."""
    defaults: ClassVar[Defaults] = {}
    """Defaults of other sections that differ from their own."""

    if TYPE_CHECKING:  # each kind has the key, after its own
        measure: Measures

    @cached_property
    def domain(self) -> Domain:
        """The domain of the fluid, which does not depend on the fluid's scales."""
        return self.flow(Scales(speed=0.0, density=1.0, kinematic_viscosity=1.0)).domain

    @abstractmethod
    def flow(self, scales: Scales) -> Scene:
        """Return the flow to simulate."""

    @property
    def resolved_length(self) -> float:
        """The length that discretization.resolution divides into particles [m]."""
        return self.domain.lengths[0]

    @property
    def length_scale(self) -> float:
        """L of the Reynolds number [m]."""
        return self.resolved_length

    @property
    def probe_line(self) -> float:
        """x of the vertical line on which runs are compared [m]."""
        return 0.5 * (self.domain.lower[0] + self.domain.upper[0])

    def parameters(self, reference_speed: float) -> dict[str, float]:
        """Return the scene's parameters apart from the Reynolds number, with their own values.

        `reference_speed` is that of the fluid [m/s].
        """
        return {}

    def driving(self, names: Collection[str]) -> tuple[str, ...]:
        """Return the parameters among `names` that change walls' velocities or the force field."""
        return ()

    def parameter_problems(self, names: Collection[str]) -> Iterator[tuple[str, str]]:
        """Yield the parameters in which operators would not be affine, with the reasons."""
        yield from ()

    def check_at(self, values: Mapping[str, float]) -> None:
        """Raise ValueError if the scene is impossible with some values of its parameters."""

    def largest_wall_speed(self, values: Mapping[str, float], until: float = 0.0) -> float:
        """Return the largest speed of varied walls until a time, at values of parameters [m/s]."""
        return 0.0

    def largest_amplitude(self, until: float) -> float:
        """Return the largest factor of the walls' velocities in runs until a time [s]."""
        return 1.0

    @property
    def amplitudes(self) -> Mapping[str, str]:
        """The amplitudes in time of walls and forces, by key; empty unless walls change."""
        return {}

    def largest_head(self, final_time: float, values: Mapping[str, float] = NONE) -> float:
        """Return a bound of the body force's head along the fluid until a time [m2/s2].

        `values` are those of the parameters, by default the scene's own.
        """
        return 0.0

    def largest_resistance(self, viscosity: float) -> float:
        """Return the largest rate of resistance [1/s], at a viscosity [m2/s]."""
        return 0.0

    @property
    def has_surface(self) -> bool:
        """Whether the fluid has a free surface."""
        return False

    @property
    def gravity(self) -> float:
        """The acceleration along -y of fluid with a free surface [m/s2]."""
        return 0.0

    def level_at(self, values: Mapping[str, float] = NONE) -> float:
        """Return the height y of a level free surface at rest [m], else infinity.

        `values` are those of the parameters, by default the scene's own.
        """
        return math.inf

    @property
    def free_slip(self) -> bool:
        """Whether fluid slips along walls without friction."""
        return False

    def fill(self, particle_spacing: float, values: Mapping[str, float] = NONE) -> Array:
        """Return the initial positions of particles on a lattice (n_particles, 2) [m]."""
        return self.domain.fill(particle_spacing)

    @property
    def strip(self) -> Strip | None:
        """The strip of the inflow; None without an inflow."""
        return None

    @property
    def porous_widths(self) -> Mapping[str, float]:
        """The width of each porous body [m]."""
        return {}

    def unresolved(self, particle_spacing: float) -> Iterator[str]:
        """Yield the keys of expressions that change within a spacing [m], so particles miss it."""
        yield from ()

    @property
    def porous_way(self) -> float:
        """The integral of 1/k along the path of the fluid through porous bodies [1/m]."""
        return 0.0

    def stations(self, line: float) -> Array:
        """Return the points of histories (n_stations, 2) [m], for x of the compared line [m]."""
        return np.empty((0, 2))

    @property
    def ramp(self) -> float:
        """The time in which an inflow or a lid reaches its speed [s]; 0 without a ramp."""
        return 0.0

    @property
    def channel(self) -> Channel | None:
        """The channel whose bulk velocity is measured, or None."""
        return None

    @property
    def measured_walls(self) -> Mapping[str, str]:
        """The walls with measured forces, by the names of the measurements."""
        return {name: m.force_on for name, m in self.measure.items() if m.force_on is not None}

    @property
    def measured_fields(self) -> Measures:
        """The measurements of velocity and pressure: flow rates, probes and lines, by name."""
        return {n: m for n, m in self.recorded.items() if m.force_on is None and not m.of_surface}

    @property
    def measured_surface(self) -> Measures:
        """The measurements that only scenes with a free surface have, by name."""
        return {name: m for name, m in self.recorded.items() if m.of_surface}

    @property
    def recorded(self) -> Measures:
        """The measurements that runs record: all except frequencies, which follow from others."""
        return {name: m for name, m in self.measure.items() if m.frequency is None}

    @property
    def columns(self) -> dict[str, Column]:
        """The recorded histories, by column name."""
        columns: dict[str, Column] = {}
        for name, measured in self.recorded.items():
            columns |= Column.named(name, measured.quantities)
        return columns

    def starts_by(self, name: str) -> bool:
        """Return whether the initial state of runs depends on a parameter of the scene."""
        return False

    def reference_profiles(
        self, reynolds: float, reference_speed: float
    ) -> tuple[ReferenceProfile, ...]:
        """Return the profiles of independent solutions of the flow."""
        return ()

    def over(self, settings: Settings, particle_spacing: float, until: float) -> SceneSection:
        """Return the scene for all parameters, a spacing [m] and an end of runs [s]."""
        return self

    def shortest_period(self, settings: Settings) -> float:
        """Return the shortest period [s] of the driving at some values of the parameters."""
        return math.inf

    def unknown_times(self, final_time: float) -> Iterator[tuple[str, str]]:
        """Yield keys whose histories don't contain all times of runs [s], with reasons."""
        yield from ()

    def problems(self, final_time: float, fluid: Fluid) -> Iterator[tuple[str, str]]:
        """Yield keys of the scene that don't fit the final time [s] or the fluid, with reasons."""
        yield from ()

    def warnings(self) -> Iterator[tuple[str, str]]:
        """Yield keys of the scene that a user should check, with the reasons."""
        yield from ()


class SegmentSection(Section):
    """A straight segment in the fluid; its ends may be on walls."""

    # `from` is a keyword of Python.
    model_config = ConfigDict(serialize_by_alias=True)

    start: Place = key(..., "start of the segment", unit="m", alias="from")
    end: Place = key(..., "end of the segment", unit="m", alias="to")


class LineSection(SegmentSection):
    """Points at equal distances along a segment, including its ends."""

    points: Annotated[Whole, Field(ge=2, le=10_000)] = key(101, "number of points")


class FrequencySection(Section):
    """A history whose oscillation is measured."""

    of: SafeName = key(..., "oscillating history, named as in tables of a sweep: `lift_force_y`")
    from_time: Duration | None = key(
        None, "time from which the history counts; null means that of its measurement", unit="s"
    )


class CoefficientSection(Section):
    """The scales of the coefficient C of a force F = C rho U^2 L / 2 per metre of depth."""

    speed: Positive = key(..., "reference speed U", unit="m/s")
    length: Positive = key(..., "reference length L", unit="m")


KINDS = "force_on", "flow_rate", "probe", "line", "elevation", "of_fluid", "frequency"
"""The keys for the kind of a measurement; it has exactly one."""


class MeasureSection(Section):
    """One measurement at every snapshot: exactly one kind, and the times that count."""

    force_on: SafeName | None = key(
        None, "wall: its force, and its torque about its centroid; for a side, the box's centre"
    )
    flow_rate: SegmentSection | None = key(
        None,
        "segment: the flow rate through it, positive from its left to its right side; a segment "
        "that goes up counts flow along x as positive",
    )
    probe: Place | None = key(None, "point: its velocity and pressure", unit="m")
    line: LineSection | None = key(None, "segment: velocity and pressure along it")
    elevation: Coordinate | None = key(
        None,
        "x of a vertical line: height y of the free surface of the fluid on the floor, without "
        "drops above it",
        unit="m",
    )
    of_fluid: Literal["centre_of_mass", "energy"] | None = key(
        None,
        "fluid with a free surface: its centre of mass, or its kinetic and potential energy, zero "
        "at rest (in a shape without level: at the floor)",
    )
    frequency: FrequencySection | None = key(
        None, "history of another measurement: frequency, amplitude and mean of its oscillation"
    )

    from_time: Duration | None = key(
        None,
        "time from which means, errors and other statistics count; null means after the ramp of an "
        "inflow or after a driving that grows from zero to a constant value, otherwise the start",
        unit="s",
    )
    coefficient: CoefficientSection | None = key(
        None, "scales of the force's coefficient, which is then measured beside the force"
    )

    @model_validator(mode="after")
    def _one_kind(self) -> MeasureSection:
        kind = only_one(self, KINDS)
        if self.coefficient is not None and self.force_on is None:
            raise ValueError(f"coefficient: is only for force_on, not for {kind}")
        if self.from_time is not None and self.frequency is not None:
            raise ValueError("from_time: of an oscillation is frequency.from_time")
        return self

    @property
    def quantities(self) -> tuple[str, ...]:
        """The quantities over time, keys of `sphrom.metrics.measures.UNITS`; none for a line."""
        if self.force_on is not None:
            return ("force", "torque", *(() if self.coefficient is None else (COEFFICIENT,)))
        if self.flow_rate is not None:
            return ("flow_rate",)
        if self.elevation is not None:
            return ("elevation",)
        if self.of_fluid is not None:
            energies = ("kinetic_energy", "potential_energy")
            return energies if self.of_fluid == "energy" else (self.of_fluid,)
        return ("velocity", "pressure") if self.probe is not None else ()

    @property
    def of_surface(self) -> bool:
        """Whether it needs a scene with a free surface."""
        return self.elevation is not None or self.of_fluid is not None

    @property
    def segment(self) -> tuple[Place, Place] | None:
        """The ends of the segment [m]; None for measurements without one."""
        section = self.flow_rate or self.line
        return None if section is None else (section.start, section.end)


Measures = dict[SafeName, MeasureSection]
"""Measurements by name."""
MEASURE: Any = key({}, "measurements over time, by name")
"""The key of a scene for its measurements."""
