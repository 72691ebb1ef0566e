"""The base class of all kinds of scene, with the properties that the program needs of them."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from sphrom.arrays import Array
from sphrom.case.fields import Section
from sphrom.case.measure_sections import (
    FieldsMeasure,
    ForceMeasure,
    Measures,
    RecordedMeasure,
    SurfaceMeasure,
)
from sphrom.metrics.quantities import Column
from sphrom.scenes.flows import Channel, Scales, Scene
from sphrom.scenes.reference_profiles import ReferenceProfile
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import NONE, Fluid, Strip
from sphrom.sph.terms import Term

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
IN_SPACE: Defaults = {
    "discretization": {"smoothing_length_ratio": 2.0, "resolution": 32},
    "reference": {"points": "lattice"},
}
"""Defaults of other sections for scenes in three dimensions."""


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
        """Return the largest rate of resistance and linear terms [1/s], at a viscosity [m2/s]."""
        return 0.0

    @property
    def added(self) -> Mapping[str, Term]:
        """The terms that a user adds to the acceleration, by name."""
        return {}

    @property
    def has_functions(self) -> bool:
        """Whether the scene has Python functions, which other processes don't have."""
        return False

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
        return {n: m.force_on for n, m in self.measure.items() if isinstance(m, ForceMeasure)}

    @property
    def measured_fields(self) -> dict[str, FieldsMeasure]:
        """The measurements of velocity and pressure: flow rates, probes and lines, by name."""
        return {n: m for n, m in self.measure.items() if isinstance(m, FieldsMeasure)}

    @property
    def measured_surface(self) -> dict[str, SurfaceMeasure]:
        """The measurements that only scenes with a free surface have, by name."""
        return {n: m for n, m in self.measure.items() if isinstance(m, SurfaceMeasure)}

    @property
    def recorded(self) -> dict[str, RecordedMeasure]:
        """The measurements that runs record: all except frequencies, which follow from others."""
        return {n: m for n, m in self.measure.items() if isinstance(m, RecordedMeasure)}

    @property
    def columns(self) -> dict[str, Column]:
        """The recorded histories, by column name."""
        columns: dict[str, Column] = {}
        for name, measured in self.recorded.items():
            columns |= Column.named(name, measured.quantities, self.domain.n_dim)
        return columns

    def starts_by(self, name: str) -> bool:
        """Return whether the initial state of runs depends on a parameter of the scene."""
        return False

    def scheduling(self, names: Collection[str]) -> tuple[str, ...]:
        """Return the parameters, among some, that change knots of histories and nothing else."""
        return ()

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
