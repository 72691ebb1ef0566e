"""Flows: geometry, starts, walls, what drives them, and exact solutions.

A scene says what differs from the least: fluid at rest at zero pressure, between walls at rest,
that nothing drives and of which no exact solution is known.

The vortex (Eq. 4.4) is an exact solution of incompressible flow. With u = (sin cos, -cos sin) the
momentum equation gives a pressure with a plus sign; the minus sign of Eq. 4.4 as printed starts an
acoustic wave of twice the pressure's amplitude.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.sph.box_domain import BoxDomain, Rectangle
from sphrom.sph.domain import Domain
from sphrom.sph.resistance import Resistance

VectorField = Callable[[Array], Array]
"""From positions (n_points, 2) [m], vectors (n_points, 2)."""
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
class BodyForce:
    """A body force that is one field times an amplitude in time."""

    field: Callable[[Array], Array]
    """(2, n_particles) [m/s2] at positions (2, n_particles) [m], for an amplitude of 1."""
    amplitude: Amplitude
    series: Callable[[Array], Array] | None = None
    """The amplitude at many times at once, where that is faster."""
    changes: bool = True
    """Whether the amplitude changes with time."""

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


class Scene(ABC):
    """A flow to simulate, in SI units; positions are (n_particles, 2) unless they say otherwise."""

    body_force: BodyForce | None = None
    """What pushes the fluid, or None where nothing does."""
    resistance: Resistance | None = None
    """What slows the fluid, or None where nothing does."""

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
    def amplitude(self) -> Amplitude | None:
        """How strongly the flow is driven, by force or walls, or None where that never changes."""
        return self.wall_amplitude if self.body_force is None else self.body_force.amplitude

    @property
    def exact(self) -> TaylorGreen | None:
        """The exact solution of incompressible flow, or None where none is known."""
        return None


@dataclass(frozen=True)
class CustomFlow(Scene):
    """A flow that a case describes."""

    where: Domain
    """The domain of the fluid."""
    wall_velocities: Mapping[str, VectorField]
    """By the names of walls that move, their velocity [m/s] at places on them."""
    start: Callable[[Array], Array]
    """From positions (n_points, 2) [m], velocity [m/s] and pressure [Pa] (n_points, 3)."""
    body_force: BodyForce | None = None
    resistance: Resistance | None = None

    @property
    def domain(self) -> Domain:
        """Where the fluid is."""
        return self.where

    def initial_velocity(self, position: Array) -> Array:
        """Return the velocity (n_particles, 2) [m/s] at the start."""
        return self.start(position)[:, :2]

    def initial_pressure(self, position: Array) -> Array:
        """Return the pressure (n_particles,) [Pa] at the start."""
        return self.start(position)[:, 2]

    def wall_velocity(self, position: Array) -> Array:
        """Return the velocity (n_ghosts, 2) [m/s] of the walls that ghosts (n_ghosts, 2) are of."""
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


LID_EXPONENT = 14
"""How flat the regularised lid's profile is (Rodriguez et al., section 4.2)."""


@dataclass(frozen=True)
class LidDrivenCavity(Scene):
    """The cavity [0, L] x [0, L], in SI units; fluid starts at rest, at zero pressure.

    The regularised lid moves at U (1 - (2 x / L - 1)^14)^2, which vanishes at the corners; section
    4.2 of Rodriguez et al. prints it without its minus signs. The uniform one moves at U all along,
    and the flow is singular at the corners.

    A lid that starts at once, as there, starts sound too, which lasts for seconds. With a ramp it
    comes up to speed along half a cosine. Over 1.5 periods of the longest wave, 3 L / c0, that does
    not excite this wave at all, and shorter ones hardly.
    """

    length: float
    speed: float
    lid: Literal["regularised", "uniform"] = "regularised"
    ramp: float = 0.0
    """How long the lid takes to come up to speed [s]."""

    @property
    def domain(self) -> Domain:
        """The box, walls all around."""
        return BoxDomain((0.0, 0.0), (self.length, self.length), (False, False))

    def lid_velocity(self, x: Array) -> Array:
        """Return the lid's velocity (n_points,) [m/s] at places (n_points,) [m] along it."""
        if self.lid == "uniform":
            return np.full_like(x, self.speed)
        return self.speed * (1.0 - (2.0 * x / self.length - 1.0) ** LID_EXPONENT) ** 2

    @property
    def wall_amplitude(self) -> Amplitude | None:
        """The share of its speed that the lid has reached, or None where it starts at once."""
        return self._speed_share if self.ramp > 0.0 else None

    def _speed_share(self, time: float) -> float:
        return 0.5 - 0.5 * math.cos(math.pi * min(max(time / self.ramp, 0.0), 1.0))

    def wall_velocity(self, position: Array) -> Array:
        """Return the velocity (n_ghosts, 2) [m/s] of the walls that ghosts (n_ghosts, 2) are of.

        Ghosts above the box are the lid's, those beyond its corners the side walls', at rest.
        """
        x, y = position.T
        velocity = np.zeros_like(position)
        on_lid = (y > self.length) & (x >= 0.0) & (x <= self.length)
        velocity[on_lid, 0] = self.lid_velocity(x[on_lid])
        return velocity


@dataclass(frozen=True)
class LogisticForce:
    """How strong the body force of Eq. 4.5 is: b0 [1 / (1 + exp(+-k (t - f0))) + k0].

    A kick has the sign + that the printed f = -t gives: the force starts near b0, drops to b0 / 2
    at the switch time f0, and b0 k0 is what stays. A ramp-up has the sign -, and rises to b0.
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
        # Other scenes don't need it, and loading it takes long.
        from scipy.special import expit

        logistic = expit(-since_switch if self.form == "kick" else since_switch)
        return self.magnitude * (float(logistic) + self.sustained_share)

    @property
    def largest(self) -> float:
        """What the acceleration never exceeds [m/s2]."""
        return self.magnitude * (1.0 + self.sustained_share)


@dataclass(frozen=True)
class OpenCavity(Scene):
    """A channel, periodic along x, over a cavity midway along it; lengths in [m], fluid at rest.

    The force of Eq. 4.5 acts in the channel above the cavity only.

    Which flow this is can't be told from the text of Rodriguez et al., so the constants here are a
    reading of ours. With f = -t, Eq. 4.5 as printed is not "ramped up": it starts at 98 m/s2, is
    half of that after f0 = 0.01 s and then stays at 0.1 m/s2. That kick brings the channel to about
    0.35 m/s, and what stays is too weak to hold even that at Re = 2400 or to let the shear layer
    shed vortices, let alone reach the reference speed of 2 m/s. Ramped up to 100 m/s2, fluid would
    pass that speed after 0.04 s and the speed of sound after 0.4 s. A sustained 0.58 m/s2 gives
    what the text describes: the largest speed is 2 m/s, and vortices are shed periodically, some
    five in the recorded second. So the form is kept, with f0 = 0.03 s and k0 = 0.0058: a longer
    kick that brings the flow up to speed, and a force that keeps it there.
    """

    channel_length: float = 0.4
    channel_height: float = 0.1
    cavity_length: float = 0.2
    cavity_height: float = 0.1
    force: LogisticForce = field(default_factory=LogisticForce)

    @property
    def channel(self) -> Rectangle:
        """Where the channel is."""
        top = self.cavity_height + self.channel_height
        return Rectangle((0.0, self.cavity_height), (self.channel_length, top))

    @property
    def cavity(self) -> Rectangle:
        """Where the cavity is."""
        middle, half = 0.5 * self.channel_length, 0.5 * self.cavity_length
        return Rectangle((middle - half, 0.0), (middle + half, self.cavity_height))

    @property
    def domain(self) -> Domain:
        """Channel and cavity, in a box that is periodic along x."""
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
