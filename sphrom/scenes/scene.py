"""What every scene offers: geometry, initial and boundary conditions, and what drives the flow.

A scene says what differs from the least: fluid at rest at zero pressure, between walls at rest,
that nothing drives and of which no exact solution is known.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sphrom.sph.domain import Domain

Array = NDArray[np.float64]
Amplitude = Callable[[float], float]
"""An amplitude at a time [s]."""


@dataclass(frozen=True)
class Scales:
    """What a scene takes from the fluid."""

    speed: float
    """Largest speed of the flow [m/s]."""
    density: float
    """At zero pressure [kg/m3]."""
    kinematic_viscosity: float
    """[m2/s]."""
    values: Mapping[str, float] = field(default_factory=dict)
    """Of the scene's own parameters, by name; those that aren't there don't vary."""


@dataclass(frozen=True)
class Drive:
    """A body force that is one field times an amplitude in time."""

    field: Callable[[Array], Array]
    """(2, n_particles) [m/s2] at positions (2, n_particles) [m], for an amplitude of 1."""
    amplitude: Amplitude

    def __call__(self, position: Array, time: float) -> Array:
        """Return the acceleration (2, n_particles) [m/s2]."""
        return self.amplitude(time) * self.field(position)


@dataclass(frozen=True)
class Channel:
    """A channel along x."""

    height: float
    """[m]."""
    contains: Callable[[Array], NDArray[np.bool_]]
    """Whether positions (n_points, 2) [m] lie where all that flows through it passes."""


class ExactFlow(Protocol):
    """An exact solution of incompressible flow; positions are (n_particles, 2)."""

    @property
    def energy_decay_rate(self) -> float:
        """The rate at which the kinetic energy's logarithm changes [1/s]."""

    def velocity(self, position: Array, time: float) -> Array:
        """Return the velocity (n_particles, 2) [m/s] at a time [s]."""

    def pressure(self, position: Array, time: float) -> Array:
        """Return the pressure (n_particles,) [Pa] at a time [s]."""


class Scene(ABC):
    """A flow to simulate, in SI units; positions are (n_particles, 2) unless they say otherwise."""

    @property
    @abstractmethod
    def domain(self) -> Domain:
        """Where the fluid is."""

    def initial_velocity(self, position: Array) -> Array:
        """Return the velocity (n_particles, 2) [m/s] at the start."""
        return np.zeros_like(position)

    def initial_pressure(self, position: Array) -> Array:
        """Return the pressure (n_particles,) [Pa] at the start."""
        return np.zeros(len(position))

    def wall_velocity(self, position: Array) -> Array:
        """Return the velocity (n_ghosts, 2) [m/s] of the walls that ghosts (n_ghosts, 2) are of."""
        return np.zeros_like(position)

    @property
    def wall_amplitude(self) -> Amplitude | None:
        """What `wall_velocity` is multiplied with, or None where walls move steadily."""
        return None

    @property
    def body_force(self) -> Drive | None:
        """What pushes the fluid, or None where nothing does."""
        return None

    @property
    def amplitude(self) -> Amplitude | None:
        """How strongly the flow is driven, by force or walls, or None where that never changes."""
        return self.wall_amplitude if self.body_force is None else self.body_force.amplitude

    @property
    def exact(self) -> ExactFlow | None:
        """The exact solution, or None where none is known."""
        return None
