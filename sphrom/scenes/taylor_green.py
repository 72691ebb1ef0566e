"""The Taylor-Green vortex in a periodic box (Eq. 4.4): an exact solution of incompressible flow.

With u = (sin cos, -cos sin) the momentum equation gives a pressure with a plus sign; the minus
sign of Eq. 4.4 as printed starts an acoustic wave of twice the pressure's amplitude.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sphrom.scenes.scene import Scene
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TaylorGreen(Scene):
    """The vortex in a square box, in SI units; positions are (n_particles, 2)."""

    length: float
    speed: float
    reference_density: float
    kinematic_viscosity: float
    pressure_sign: float = 1.0
    """+1, or -1 as printed in Eq. 4.4."""

    @property
    def domain(self) -> Domain:
        """The box, periodic along both axes."""
        return BoxDomain((0.0, 0.0), (self.length, self.length), (True, True))

    @property
    def exact(self) -> TaylorGreen:
        """The exact solution, whatever sign of the pressure this flow starts with."""
        return replace(self, pressure_sign=1.0)

    def initial_velocity(self, position: Array) -> Array:
        """Return the velocity (n_particles, 2) [m/s] at the start."""
        return self.velocity(position, 0.0)

    def initial_pressure(self, position: Array) -> Array:
        """Return the pressure (n_particles,) [Pa] at the start."""
        return self.pressure(position, 0.0)

    @property
    def wave_number(self) -> float:
        """kappa = 2 pi / L [1/m]."""
        return 2.0 * math.pi / self.length

    @property
    def energy_decay_rate(self) -> float:
        """The rate -4 nu kappa^2 at which the kinetic energy's logarithm changes [1/s]."""
        return -4.0 * self.kinematic_viscosity * self.wave_number**2

    def velocity(self, position: Array, time: float) -> Array:
        """Return the velocity (n_particles, 2) [m/s] at a time [s]."""
        x, y = (self.wave_number * position).T
        amplitude = self.speed * math.exp(0.5 * self.energy_decay_rate * time)
        return amplitude * np.stack((np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y)), axis=1)

    def pressure(self, position: Array, time: float) -> Array:
        """Return the pressure (n_particles,) [Pa] at a time [s], its mean zero."""
        x, y = (2.0 * self.wave_number * position).T
        amplitude = 0.25 * self.reference_density * self.speed**2
        decay = math.exp(self.energy_decay_rate * time)
        return self.pressure_sign * amplitude * decay * (np.cos(x) + np.cos(y))
