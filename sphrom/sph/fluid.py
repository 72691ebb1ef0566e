"""What a fluid is, how it is cut into particles, and the time steps that both allow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from sphrom.kernels.wendland import SUPPORT_RATIO

COURANT_LIMIT = 1.5
"""Largest c0 dt / h (Eq. 2.19)."""
VISCOUS_LIMIT = 0.125
"""Largest nu dt / h^2 (Morris, Fox and Zhu 1997)."""


@dataclass(frozen=True)
class Fluid:
    """A weakly compressible fluid, in SI units."""

    reference_density: float
    sound_speed: float
    kinematic_viscosity: float
    max_speed: float
    """U_max [m/s], the largest speed expected."""

    @property
    def mach_number(self) -> float:
        """U_max over the speed of sound."""
        return self.max_speed / self.sound_speed


@dataclass(frozen=True)
class Discretization:
    """How the fluid is cut into particles, and the terms that keep them regular."""

    particle_spacing: float
    smoothing_length: float
    diffusion_coefficient: float = 0.1
    """delta of Eq. 2.6."""
    viscosity: Literal["laplacian", "pair"] = "laplacian"
    """The viscous operator: the velocity's Laplacian, or Eq. 2.12 as printed."""
    shifting: bool = True
    shifting_amplitude: float = 0.2
    """chi of Eq. 2.14."""
    shifting_as_printed: bool = False
    """Read Eq. 2.14 as printed, with the exponent outside of the bracket."""

    @property
    def support_radius(self) -> float:
        """The radius of the kernel's support [m]."""
        return SUPPORT_RATIO * self.smoothing_length

    @property
    def n_neighbours(self) -> float:
        """Particles in a kernel's support, on average."""
        return math.pi * (self.support_radius / self.particle_spacing) ** 2


@dataclass(frozen=True)
class StepLimits:
    """The largest stable time steps [s]."""

    acoustic: float
    viscous: float


def acoustic_limit(smoothing_length: float, sound_speed: float) -> float:
    """Return the largest step [s] that sound allows (Eq. 2.19)."""
    return COURANT_LIMIT * smoothing_length / sound_speed


def viscous_limit(smoothing_length: float, kinematic_viscosity: float) -> float:
    """Return the largest step [s] that viscosity allows."""
    return VISCOUS_LIMIT * smoothing_length**2 / kinematic_viscosity


def step_limits(fluid: Fluid, discretization: Discretization) -> StepLimits:
    """Return the acoustic and the viscous limit of the time step."""
    length = discretization.smoothing_length
    return StepLimits(
        acoustic=acoustic_limit(length, fluid.sound_speed),
        viscous=viscous_limit(length, fluid.kinematic_viscosity),
    )
