"""A fluid with its linear state equation (Eq. 2.8), its discretization, and stable time steps.

The state equation relates pressure to density fluctuations rho - rho_0.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Generic, Literal, TypeVar

from sphrom.arrays import Array
from sphrom.kernels import SUPPORT_RATIO

T = TypeVar("T")
Factors = Mapping[str, float]
"""The values of the parameters by name."""
NONE: Factors = MappingProxyType({})
"""No parameter differs from the scene's value."""


@dataclass(frozen=True)
class UnitForcing(Generic[T]):
    """The contributions of walls and of the body force per unit of a parameter, where any."""

    walls: T | None = None
    force: T | None = None


ROUNDING = 1e-9
"""Relative tolerance for equality up to rounding."""
COURANT_LIMIT = 1.5
"""Largest c0 dt / h (Eq. 2.19)."""
VISCOUS_LIMIT = 0.125
"""Largest nu dt / h^2 (Morris, Fox and Zhu 1997)."""
WALL_VISCOUS_LIMIT = 0.22
"""Largest nu dt / (h dx) beside walls, where velocities are extrapolated from close by."""
STIFFER_AT_CORNERS = 0.2
"""Increase of the largest friction rate beside walls at a corner, over its sharpness."""
LARGEST_WAVE_NUMBER = 1.4
"""Largest resolved wave number of sound, times h: sqrt of the largest eigenvalue of -D G."""
REAL_AXIS_LIMIT = 2.78
"""Stability limit of Eq. 2.18 on the negative real axis."""


@dataclass(frozen=True)
class Fluid:
    """A weakly compressible fluid, in SI units."""

    reference_density: float
    sound_speed: float
    kinematic_viscosity: float
    max_speed: float
    """U_max [m/s], the largest expected speed."""


def pressure_of(density_fluctuation: Array, sound_speed: float) -> Array:
    """Return the pressure [Pa] of density fluctuations [kg/m3]."""
    return sound_speed**2 * density_fluctuation


def fluctuation_of(pressure: Array, sound_speed: float) -> Array:
    """Return the density fluctuation [kg/m3] for a pressure [Pa]."""
    return pressure / sound_speed**2


def volume_of(density_fluctuation: Array, reference_density: float, mass: float) -> Array:
    """Return the volume [m2] of particles with one mass [kg/m]."""
    return mass / (reference_density + density_fluctuation)


@dataclass(frozen=True)
class Discretization:
    """The discretization into particles, and the terms that keep them regular."""

    particle_spacing: float
    smoothing_length: float
    diffusion_coefficient: float = 0.1
    """delta of Eq. 2.6."""
    acoustic_damping: float = 0.0
    """alpha of the acoustic damper, a bulk viscosity of alpha h c0."""
    viscosity: Literal["laplacian", "pair"] = "laplacian"
    """The viscous operator: the Laplacian of the velocity, or Eq. 2.12 as printed."""
    shifting: bool = True
    shifting_amplitude: float = 1.0
    """chi of Eq. 2.14."""
    shifting_as_printed: bool = False
    """Whether to use Eq. 2.14 as printed, with the exponent outside the bracket."""
    shifting_transport: Literal["advective", "paper"] = "advective"
    """Transport by shifting: of differences, by a particle's own shift; or as printed."""
    no_slip: Literal["linear", "whole", "paper", "free"] = "linear"
    """The ghosts' velocity: extrapolated from each particle; twice the wall's less the fluid's; or
    the fluid's with the tangential part reversed. Free slip reverses the normal part."""
    wall_continuity: Literal["adjoint", "normal", "paper"] = "adjoint"
    """Walls in the continuity equation: the transpose of their pressure force; or the velocities of
    ghosts, along the wall's normal only, or like those of fluid."""
    free_surface: bool = False
    """Whether ghosts near or above the surface are weighted by the share of fluid beside them."""
    fixed_volume: bool = False
    """Whether to subtract the mean of the continuity equation, so that volumes fill the domain."""

    @property
    def support_radius(self) -> float:
        """The radius of the kernel's support [m]."""
        return SUPPORT_RATIO * self.smoothing_length

    @property
    def n_layers(self) -> int:
        """Number of ghost layers that the kernel's support needs."""
        return math.ceil(self.support_radius / self.particle_spacing * (1.0 - ROUNDING))

    @property
    def n_neighbours(self) -> float:
        """Average number of particles in a kernel's support."""
        return math.pi * (self.support_radius / self.particle_spacing) ** 2


@dataclass(frozen=True)
class StepLimits:
    """The largest stable time steps [s]."""

    acoustic: float
    viscous: float

    @property
    def least(self) -> float:
        """The smaller limit."""
        return min(self.acoustic, self.viscous)


def step_limits(
    fluid: Fluid,
    discretization: Discretization,
    has_walls: bool = False,
    sharpness: float = 0.0,
    resistance: float = 0.0,
) -> StepLimits:
    """Return the limits of the time step.

    Sound limits it by Eq. 2.19. If the damper's alpha is larger than 2 over the largest wave
    number, the shortest waves are overdamped, and their damping rate limits the step. Resistance,
    with the largest rate `resistance` [1/s], adds to this rate and to that of viscosity. Beside
    walls, the viscous limit also depends on the spacing, and on the sharpness of the sharpest
    corner that juts into the fluid (`sphrom.sph.polygons.jutting_corners`).
    """
    length, courant = discretization.smoothing_length, COURANT_LIMIT
    half = 0.5 * discretization.acoustic_damping * LARGEST_WAVE_NUMBER
    half += 0.5 * resistance * length / (fluid.sound_speed * LARGEST_WAVE_NUMBER)
    if half > 1.0:
        rate = LARGEST_WAVE_NUMBER * (half + math.sqrt(half**2 - 1.0))
        courant = min(courant, REAL_AXIS_LIMIT / rate)
    diffusion = VISCOUS_LIMIT * length**2
    if has_walls:
        limit = WALL_VISCOUS_LIMIT / (1.0 + STIFFER_AT_CORNERS * sharpness)
        diffusion = min(diffusion, limit * length * discretization.particle_spacing)
    acoustic = courant * length / fluid.sound_speed
    viscous = diffusion / fluid.kinematic_viscosity
    if resistance > 0.0:
        viscous = 1.0 / (1.0 / viscous + resistance / REAL_AXIS_LIMIT)
    return StepLimits(acoustic, viscous)
