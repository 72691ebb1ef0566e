"""Flows: geometry, initial conditions, walls, driving forces, and exact solutions.

By default a scene has fluid at rest at zero pressure between walls at rest, no driving force and no
known exact solution. Subclasses override the differences.

The vortex (Eq. 4.4) is an exact solution of incompressible flow. With u = (sin cos, -cos sin) the
momentum equation gives a pressure with a plus sign; the minus sign printed in Eq. 4.4 starts an
acoustic wave with twice the amplitude of the pressure.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.sph.box_domain import BoxDomain, Rectangle
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import Resistance
from sphrom.sph.space_box import SpaceBox
from sphrom.sph.terms import Term

VectorField = Callable[[Array], Array]
"""Vectors (n_points, 2) at positions (n_points, 2) [m]."""
Amplitude = Callable[[float], float]
"""An amplitude at a time [s]."""


@dataclass(frozen=True)
class Scales:
    """The properties of the fluid that a scene depends on."""

    speed: float
    """Largest speed of the flow [m/s]."""
    density: float
    """The density at zero pressure [kg/m3]."""
    kinematic_viscosity: float
    """[m2/s]."""
    values: Mapping[str, float] = field(default_factory=dict)
    """The scene's own varying parameters, by name."""


@dataclass(frozen=True)
class BodyForce:
    """A body force that is one field times an amplitude in time."""

    field: Callable[[Array], Array]
    """(2, n_particles) [m/s2] at positions (2, n_particles) [m], for an amplitude of 1."""
    amplitude: Amplitude
    series: Callable[[Array], Array] | None = None
    """The amplitude at many times at once, if that is faster."""
    changes: bool = True
    """Whether the amplitude changes with time."""

    def __call__(self, position: Array, time: float) -> Array:
        """Return the acceleration (2, n_particles) [m/s2]."""
        return self.amplitude(time) * self.field(position)

    def over(self, times: Array) -> Array:
        """Return the amplitude (n_components, n_times) at times [s]."""
        series = self.series or np.vectorize(self.amplitude, [np.float64])
        return np.broadcast_to(series(times), (1, len(times)))


@dataclass(frozen=True)
class Channel:
    """A channel along x."""

    height: float
    """[m]."""
    contains: Callable[[Array], NDArray[np.bool_]]
    """Whether positions (n_points, 2) [m] are in the part that the whole flow passes through."""


class Scene(ABC):
    """A flow to simulate, in SI units; positions are (n_particles, 2) unless stated otherwise."""

    body_force: BodyForce | None = None
    """The driving body force, if any."""
    resistance: Resistance | None = None
    """The resistance that slows the fluid, if any."""
    terms: Sequence[Term] = ()
    """Terms that a user adds to the acceleration."""

    @property
    @abstractmethod
    def domain(self) -> Domain:
        """The domain of the fluid."""

    def initial_velocity(self, position: Array) -> Array:
        """Return the velocity (n_particles, 2) [m/s] at the start."""
        return np.zeros_like(position)

    def initial_pressure(self, position: Array) -> Array:
        """Return the pressure (n_particles,) [Pa] at the start."""
        return np.zeros(len(position))

    def wall_velocity(self, position: Array) -> Array:
        """Return the velocity (n_ghosts, 2) [m/s] of the walls of ghosts at (n_ghosts, 2) [m]."""
        return np.zeros_like(position)

    @property
    def wall_amplitude(self) -> Amplitude | None:
        """The time-dependent factor of `wall_velocity`, or None if walls move steadily."""
        return None

    def wall_speed(self, position: Array) -> Callable[[float], float | Array] | None:
        """Return the factor of `wall_velocity` at times, for all ghosts or for each (n_ghosts,)."""
        return self.wall_amplitude

    @property
    def amplitude(self) -> Amplitude | None:
        """The time-dependent factor of the driving force or walls, or None if it never changes."""
        return self.wall_amplitude if self.body_force is None else self.body_force.amplitude

    def driving(self, times: Array) -> Array:
        """Return the amplitude of the driving (n_components, n_times) at times [s]."""
        if self.body_force is not None:
            return self.body_force.over(times)
        amplitude = self.amplitude or (lambda _: 1.0)
        return np.array([[amplitude(time) for time in times.tolist()]])

    @property
    def exact(self) -> TaylorGreen | None:
        """The exact solution of incompressible flow, or None if none is known."""
        return None


@dataclass(frozen=True)
class CustomFlow(Scene):
    """A flow that a case describes."""

    where: Domain
    """The domain of the fluid."""
    wall_velocities: Mapping[str, VectorField]
    """Velocities [m/s] of moving walls at places on them, by the walls' names."""
    start: Callable[[Array], Array]
    """Velocity [m/s] and pressure [Pa] (n_points, n_dim + 1) at positions (n_points, n_dim) [m]."""
    body_force: BodyForce | None = None
    resistance: Resistance | None = None
    wall_amplitudes: Mapping[str, Amplitude] = field(default_factory=dict)
    """Factors of the velocities of walls that change with time, by the walls' names."""
    terms: Sequence[Term] = ()

    @property
    def domain(self) -> Domain:
        return self.where

    @property
    def wall_amplitude(self) -> Amplitude | None:
        return next(iter(self.wall_amplitudes.values()), None)

    def wall_speed(self, position: Array) -> Callable[[float], float | Array] | None:
        if not self.wall_amplitudes:
            return None
        nearest = self.where.nearest_wall(position)
        names = self.where.wall_names
        factors = [self.wall_amplitudes.get(name, lambda time: 1.0) for name in names]
        return lambda time: np.array([factor(time) for factor in factors])[nearest]

    def initial_velocity(self, position: Array) -> Array:
        return self.start(position)[:, :-1]

    def initial_pressure(self, position: Array) -> Array:
        return self.start(position)[:, -1]

    def wall_velocity(self, position: Array) -> Array:
        velocity = np.zeros_like(position)
        if self.wall_velocities:
            names = np.array(self.where.wall_names)[self.where.nearest_wall(position)]
            place = self.where.on_wall(position)
            for name, field_of in self.wall_velocities.items():
                chosen = names == name
                velocity[chosen] = field_of(place[chosen])
        return velocity


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
        """The exact solution, which has the correct sign of the pressure in any case."""
        return replace(self, pressure_sign=1.0)

    def initial_velocity(self, position: Array) -> Array:
        return self.velocity(position, 0.0)

    def initial_pressure(self, position: Array) -> Array:
        return self.pressure(position, 0.0)

    @property
    def wave_number(self) -> float:
        """kappa = 2 pi / L [1/m]."""
        return 2.0 * math.pi / self.length

    @property
    def energy_decay_rate(self) -> float:
        """The rate of change of the logarithm of the kinetic energy, -4 nu kappa^2 [1/s]."""
        return -4.0 * self.kinematic_viscosity * self.wave_number**2

    def velocity(self, position: Array, time: float) -> Array:
        """Return the velocity (n_particles, 2) [m/s] at a time [s]."""
        x, y = (self.wave_number * position).T
        amplitude = self.speed * math.exp(0.5 * self.energy_decay_rate * time)
        return amplitude * np.stack((np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y)), axis=1)

    def pressure(self, position: Array, time: float) -> Array:
        """Return the pressure (n_particles,) [Pa] at a time [s]; its mean is zero."""
        x, y = (2.0 * self.wave_number * position).T
        amplitude = 0.25 * self.reference_density * self.speed**2
        decay = math.exp(self.energy_decay_rate * time)
        return self.pressure_sign * amplitude * decay * (np.cos(x) + np.cos(y))


@dataclass(frozen=True)
class TaylorGreen3D(Scene):
    """The vortex of Taylor and Green in a periodic cube (Brachet et al., J. Fluid Mech. 130, 1983).

    It starts as u = sin x cos y cos z, v = -cos x sin y cos z, w = 0, and has no closed solution.
    """

    length: float
    speed: float
    reference_density: float

    @property
    def domain(self) -> Domain:
        """The cube, periodic along all axes."""
        return SpaceBox((0.0,) * 3, (self.length,) * 3, (True,) * 3)

    def initial_velocity(self, position: Array) -> Array:
        x, y, z = (2.0 * math.pi / self.length * position).T
        u = np.sin(x) * np.cos(y) * np.cos(z)
        v = -np.cos(x) * np.sin(y) * np.cos(z)
        return self.speed * np.stack((u, v, np.zeros_like(u)), axis=1)

    def initial_pressure(self, position: Array) -> Array:
        x, y, z = (4.0 * math.pi / self.length * position).T
        scale = self.reference_density * self.speed**2 / 16.0
        return scale * (np.cos(x) + np.cos(y)) * (np.cos(z) + 2.0)


LID_EXPONENT = 14
"""Flatness of the regularised lid's profile (Rodriguez et al., section 4.2)."""


@dataclass(frozen=True)
class LidDrivenCavity(Scene):
    """The cavity [0, L] x [0, L], in SI units; fluid starts at rest, at zero pressure.

    The regularised lid moves at U (1 - (2 x / L - 1)^14)^2, which vanishes at the corners; section
    4.2 of Rodriguez et al. prints it without the minus signs. The uniform lid moves at U
    everywhere, so the flow is singular at the corners.

    A lid that starts impulsively, as in the paper, emits sound that lasts for seconds. With a ramp
    its speed rises along half a cosine. A ramp over 1.5 periods of the longest wave, 3 L / c0, does
    not excite this wave at all, and shorter waves hardly.
    """

    length: float
    speed: float
    lid: Literal["regularised", "uniform"] = "regularised"
    ramp: float = 0.0
    """Time that the lid takes to reach its speed [s]."""

    @property
    def domain(self) -> Domain:
        """The box, with walls all around."""
        return BoxDomain((0.0, 0.0), (self.length, self.length), (False, False))

    def lid_velocity(self, x: Array) -> Array:
        """Return the lid's velocity (n_points,) [m/s] at places (n_points,) [m] along it."""
        if self.lid == "uniform":
            return np.full_like(x, self.speed)
        return self.speed * (1.0 - (2.0 * x / self.length - 1.0) ** LID_EXPONENT) ** 2

    @property
    def wall_amplitude(self) -> Amplitude | None:
        """The share of its speed that the lid has reached, or None if it starts impulsively."""
        return self._speed_share if self.ramp > 0.0 else None

    def _speed_share(self, time: float) -> float:
        return 0.5 - 0.5 * math.cos(math.pi * min(max(time / self.ramp, 0.0), 1.0))

    def wall_velocity(self, position: Array) -> Array:
        """Return the velocity (n_ghosts, 2) [m/s] of the walls of ghosts at (n_ghosts, 2) [m].

        Ghosts above the box belong to the lid, those beyond its corners to the side walls at rest.
        """
        x, y = position.T
        velocity = np.zeros_like(position)
        on_lid = (y > self.length) & (x >= 0.0) & (x <= self.length)
        velocity[on_lid, 0] = self.lid_velocity(x[on_lid])
        return velocity


@dataclass(frozen=True)
class LidDrivenCube(LidDrivenCavity):
    """The cavity [0, L]^3, whose top wall moves along x.

    The speed of the regularised lid also vanishes at its ends along z.
    """

    @property
    def domain(self) -> Domain:
        """The cube, with walls all around."""
        return SpaceBox((0.0,) * 3, (self.length,) * 3, (False,) * 3)

    def wall_velocity(self, position: Array) -> Array:
        x, y, z = position.T
        velocity = np.zeros_like(position)
        beside = (np.minimum(x, z) < 0.0) | (np.maximum(x, z) > self.length)
        on_lid = (y > self.length) & ~beside
        if self.speed:
            along_x = self.lid_velocity(x[on_lid])
            velocity[on_lid, 0] = along_x * self.lid_velocity(z[on_lid]) / self.speed
        return velocity


@dataclass(frozen=True)
class LogisticForce:
    """The strength of the body force of Eq. 4.5: b0 [1 / (1 + exp(+-k (t - f0))) + k0].

    A kick has the sign + that follows from the printed f = -t: the force starts near b0, drops to
    b0 / 2 at the switch time f0, and b0 k0 remains. A ramp-up has the sign -, and rises to b0.
    """

    magnitude: float = 100.0
    """b0 [m/s2]."""
    rate: float = 400.0
    """k [1/s]."""
    switch_time: float = 0.03
    """f0 [s]."""
    sustained_share: float = 0.0058
    """k0."""
    form: Literal["kick", "ramp-up"] = "kick"

    def __call__(self, time: float) -> float:
        """Return the acceleration along x [m/s2] at a time [s]."""
        since_switch = self.rate * (time - self.switch_time)
        # Other scenes do not need this module, and importing it takes long.
        from scipy.special import expit

        logistic = expit(-since_switch if self.form == "kick" else since_switch)
        return self.magnitude * (float(logistic) + self.sustained_share)

    @property
    def largest(self) -> float:
        """Upper bound of the acceleration [m/s2]."""
        return self.magnitude * (1.0 + self.sustained_share)


@dataclass(frozen=True)
class OpenCavity(Scene):
    """A channel, periodic along x, over a cavity midway along it; lengths in [m], fluid at rest.

    The force of Eq. 4.5 acts only in the channel above the cavity.

    The text of Rodriguez et al. does not determine this flow, so the constants are our
    interpretation. With f = -t, Eq. 4.5 as printed is not "ramped up": the force starts at 98 m/s2,
    is half of that after f0 = 0.01 s and then stays at 0.1 m/s2. That kick accelerates the channel
    to about 0.35 m/s. The remaining force is too weak to sustain even that speed at Re = 2400 or to
    make the shear layer shed vortices, and far from the reference speed of 2 m/s. If the force
    ramped up to 100 m/s2, the fluid would exceed that speed after 0.04 s and the speed of sound
    after 0.4 s. A sustained 0.58 m/s2 gives the flow that the text describes: the largest speed is
    2 m/s, and vortices are shed periodically, about five in the recorded second. So the form is
    kept, with f0 = 0.03 s and k0 = 0.0058: a longer kick to reach the speed, and a force that
    sustains it.
    """

    channel_length: float = 0.4
    channel_height: float = 0.1
    cavity_length: float = 0.2
    cavity_height: float = 0.1
    force: LogisticForce = field(default_factory=LogisticForce)

    @property
    def channel(self) -> Rectangle:
        """The rectangle of the channel."""
        top = self.cavity_height + self.channel_height
        return Rectangle((0.0, self.cavity_height), (self.channel_length, top))

    @property
    def cavity(self) -> Rectangle:
        """The rectangle of the cavity."""
        middle, half = 0.5 * self.channel_length, 0.5 * self.cavity_length
        return Rectangle((middle - half, 0.0), (middle + half, self.cavity_height))

    @property
    def domain(self) -> Domain:
        """The channel and the cavity, in a box that is periodic along x."""
        parts = self.channel, self.cavity
        return BoxDomain((0.0, 0.0), self.channel.upper, (True, False), parts)

    @property
    def body_force(self) -> BodyForce:  # type: ignore[override]
        """The force of Eq. 4.5 above the cavity."""
        return BodyForce(self._along_x_above, self.force)

    def _along_x_above(self, position: Array) -> Array:
        """Return (1, 0) [m/s2] at positions (2, n_particles) [m] above the cavity, else zero."""
        cavity = self.cavity
        x = np.mod(position[0], self.channel_length)
        above = (position[1] >= cavity.upper[1]) & (x >= cavity.lower[0]) & (x <= cavity.upper[0])
        field = np.zeros_like(position)
        field[0, above] = 1.0
        return field
