"""The records of a full run's settings: fluid, discretization, resistance; limits of stable steps.

The state equation (Eq. 2.8) is linear. It relates pressure to density fluctuations rho - rho_0.

A resistance adds -lambda u to the rates of the velocity; a porous body of permeability k has
lambda = nu/k (Darcy's law). An open flow runs in a box that is periodic along the flow, with a
strip across it, a fringe region (Spalart 1988; Nordstrom, Nordin and Henningson 1999, SIAM J. Sci.
Comput. 20). There lambda (U - u) returns the fluid to the velocity U of the inflow.

This force alone would have to balance the pressure drop and friction, so the flow rate would be too
low. As in simulations at a fixed flow rate, the strip therefore also removes the mean of the other
accelerations along the flow: a becomes a - e (e . a), with e the unit vector of all lambda.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Generic, Literal, TypeVar

import numpy as np

from sphrom.arrays import Array, Mask
from sphrom.kernels import SUPPORT_RATIO
from sphrom.sph.walls.kinds import KINDS, LARGEST_WAVE_NUMBER, WallKind

T = TypeVar("T")
Factors = Mapping[str, float]
"""The values of the parameters by name."""
NONE: Factors = MappingProxyType({})
"""No parameter differs from the scene's value."""
RISE, FALL = 0.3, 0.1
"""Shares of a strip's width over which lambda rises (where fluid enters) and falls."""

Rates = Callable[[Array], Array]
"""Return rates (n_positions,) at positions (2, n_positions) [m] in the box."""


@dataclass(frozen=True)
class UnitForcing(Generic[T]):
    """The contributions of walls and of the body force per unit of a parameter, where any."""

    walls: T | None = None
    force: T | None = None


OVERFLOWING = 1e150
"""Numbers whose square may be too large."""
ROUNDING = 1e-9
"""Relative tolerance for equality up to rounding."""
COURANT_LIMIT = 1.5
"""Largest c0 dt / h (Eq. 2.19)."""
VISCOUS_LIMIT = 0.125
"""Largest nu dt / h^2 (Morris, Fox and Zhu 1997)."""
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
    wall_kind: str = "mirrored"
    """The wall rule, one of `sphrom.sph.walls.kinds`."""
    free_slip: bool = False
    """Whether fluid slips along walls without friction."""
    free_surface: bool = False
    """Whether ghosts near or above the surface are weighted by the share of fluid beside them."""
    fixed_volume: bool = False
    """Whether to subtract the mean of the continuity equation, so that volumes fill the domain."""
    pair_precision: Literal["float64", "float32"] = "float64"
    """The precision of terms of pairs of particles and of their sums."""

    @property
    def walls(self) -> WallKind:
        """The wall rule."""
        return KINDS[self.wall_kind]

    @property
    def support_radius(self) -> float:
        """The radius of the kernel's support [m]."""
        return SUPPORT_RATIO * self.smoothing_length

    @property
    def n_layers(self) -> int:
        """Number of ghost layers that the kernel's support needs."""
        return math.ceil(self.support_radius / self.particle_spacing * (1.0 - ROUNDING))


@dataclass(frozen=True)
class StepLimits:
    """The largest stable time steps [s]."""

    acoustic: float
    viscous: float

    @property
    def least(self) -> float:
        """The smaller of both limits [s]."""
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
    corner that juts into the fluid (`sphrom.sph.polygons.jutting_corners`). The rule of walls has
    the numbers.
    """
    length = discretization.smoothing_length
    walls = discretization.walls
    largest = walls.wave_number if has_walls else LARGEST_WAVE_NUMBER
    courant = COURANT_LIMIT * (LARGEST_WAVE_NUMBER / largest)
    half = 0.5 * discretization.acoustic_damping * largest
    half += 0.5 * resistance * length / (fluid.sound_speed * largest)
    if half > 1.0:
        root = math.sqrt(half**2 - 1.0) if half < OVERFLOWING else half
        rate = largest * (half + root)
        courant = min(courant, REAL_AXIS_LIMIT / rate)
    diffusion = VISCOUS_LIMIT * length**2
    if has_walls:
        limit = walls.viscous_limit / (1.0 + walls.stiffer_at_corners * sharpness)
        diffusion = min(diffusion, limit * length * discretization.particle_spacing)
    acoustic = courant * length / fluid.sound_speed
    viscous = diffusion / fluid.kinematic_viscosity
    if resistance > 0.0:
        viscous = 1.0 / (1.0 / viscous + resistance / REAL_AXIS_LIMIT)
    return StepLimits(acoustic, viscous)


@dataclass(frozen=True)
class Strip:
    """A strip across the box that returns the flow to the inflow's velocity."""

    axis: int
    """The axis perpendicular to the strip: 0 is x."""
    start: float
    end: float
    """Its position along that axis [m]."""
    speed: float
    """The largest speed of the inflow [m/s]; negative if fluid leaves the strip at its start."""
    strength: float
    """K."""

    @property
    def largest(self) -> float:
        """The largest lambda [1/s]."""
        width = (self.end - self.start) * (1.0 - 0.5 * (RISE + FALL))
        return self.strength * abs(self.speed) / width

    def contains(self, position: Array) -> Mask:
        """Return whether positions (2, n_positions) [m] in the box are in the strip."""
        return np.asarray((position[self.axis] > self.start) & (position[self.axis] < self.end))

    def rates(self, position: Array) -> Array:
        """Return lambda (n_positions,) [1/s] at positions (2, n_positions) [m] in the box."""
        inside = self.contains(position)
        along = (position[self.axis, inside] - self.start) / (self.end - self.start)
        if self.speed < 0.0:
            along = 1.0 - along
        found = np.zeros(position.shape[1])
        found[inside] = self.largest * _step(along / RISE) * _step((1.0 - along) / FALL)
        return found

    def forcing(self, position: Array, velocity: Callable[[Array], Array]) -> Array:
        """Return lambda U (2, n_positions) [m/s2], given the inflow's velocity [m/s]."""
        out = np.zeros_like(position)
        inside = np.flatnonzero(self.contains(position))
        out[:, inside] = self.rates(position[:, inside]) * velocity(position[:, inside])
        return out


def _step(x: Array) -> Array:
    """Return a smooth step from 0 at zero to 1 at one, with all derivatives continuous."""
    within = np.clip(x, 1e-3, 1.0 - 1e-3)
    smooth = 1.0 / (1.0 + np.exp(1.0 / (within - 1.0) + 1.0 / within))
    return np.asarray(np.where(x >= 1.0, 1.0, smooth))


@dataclass(frozen=True)
class Resistance:
    """The resistance that slows the fluid of a scene."""

    own: Rates | None = None
    """lambda without porous bodies and the strip [1/s]."""
    inverse_permeability: Rates | None = None
    """1/k [1/m2]; zero outside porous bodies."""
    strip: Strip | None = None
    in_box: Callable[[Array], Array] = lambda position: position
    """Moves positions (2, n_positions) [m] into the box."""

    def steady(self, position: Array) -> Array:
        """Return lambda without porous bodies (n_positions,) [1/s], independent of viscosity."""
        in_box = self.in_box(position)
        found = np.zeros(in_box.shape[1]) if self.own is None else self.own(in_box)
        return found if self.strip is None else found + self.strip.rates(in_box)

    def rates(self, position: Array, viscosity: float) -> Array:
        """Return lambda (n_positions,) [1/s] at positions (2, n_positions) [m]."""
        found = self.steady(position)
        if self.inverse_permeability is not None:
            found = found + viscosity * self.inverse_permeability(self.in_box(position))
        return found

    def hold(self, position: Array, acceleration: Array) -> None:
        """Remove the mean of accelerations (2, n_positions) [m/s2] along the strip, in place."""
        if self.strip is not None:
            rates = self.strip.rates(self.in_box(position))
            along = acceleration[self.strip.axis]
            along -= rates * (rates @ along / (rates @ rates))

    def largest(self, samples: Array, viscosity: float) -> float:
        """Return the largest lambda [1/s] at positions (2, n_positions) [m], or in the strip."""
        largest = float(self.rates(samples, viscosity).max())
        return largest if self.strip is None else max(largest, self.strip.largest)
