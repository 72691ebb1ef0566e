"""A check of the snapshots of a full run, which searches for unphysical effects."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import KW_ONLY, dataclass

import numpy as np

from sphrom.arrays import Array

MOST_UNEXPLAINED, NO_ENERGY = 0.1, 2e-3
"""Largest energy without a source, over work and kinetic energy, plus its limit over that at the
flow's speed. Good runs gain 0.4 % of their kinetic energy at most (a breaking dam; a drop, a tank
that sloshes, standing waves and flows by body forces: none), a tank of water at a Reynolds number
of 8e5 with 16 particles across 0.8 to 5 times its work, and 0.02 over the flow's speed."""
MOST_OF_DRIVE = 2.0
"""Largest kinetic energy relative to that of all fluid at the speed of walls and inflow; measured
are 0.03 to 0.2 for walls (lids, rotating cylinders, an L-shaped cavity, a fin)."""
MOST_AT_REST = 0.01
"""Largest root mean square speed of fluid that nothing drives, relative to the flow's; that tank
has 0.03 without a force."""
MOST_FLUCTUATION, PER_MACH_SQUARED = 0.015, 0.5
"""Largest root mean square of (rho - rho_0)/rho_0 minus its mean, or if larger, relative to the
Mach number squared. In 13 good flows at Ma = 0.1 it is 0.0005 to 0.0031, with an inflow 0.0084."""
MOST_DRIFT, MOST_DRIFT_BELOW_SURFACE = 5e-4, 5e-3
"""Largest change of the mean density over rho_0. In good flows it is 8e-6 at most, and below free
surfaces 6e-4, or 2e-3 where a dam breaks, and 7e-5 with an inflow."""


@dataclass
class Watch:
    """Searches the snapshots of a full run for unphysical effects.

    Energy is kinetic, potential, and that of compression. It may grow by the work of the body
    force, which is integrated over the snapshots by Simpson's rule. Work of walls and inflow is
    not; their speed bounds the kinetic energy.
    """

    reference_density: float
    sound_speed: float
    max_speed: float
    """The largest expected speed [m/s]."""
    drive_speed: float = 0.0
    """The largest speed of walls and inflow [m/s]."""
    gravity: float = 0.0
    """Gravity along -y [m/s2]; `force` includes it."""
    force: Callable[[Array, float], Array] | None = None
    _: KW_ONLY
    is_driven: bool = True
    has_surface: bool = False
    look_every: int = 1
    """Interval of the checked snapshots: one in so many."""

    def __post_init__(self) -> None:
        self._n_seen = 0
        self._before: tuple[float, float, Array, Array] | None = None
        self._work = self._moved = self._unknown = 0.0
        self._rows: list[tuple[float, ...]] = []

    def see(self, time: float, position: Array, velocity: Array, fluctuation: Array) -> None:
        """Add a snapshot; positions and velocities are (n_particles, n_dim)."""
        self._n_seen += 1
        if (self._n_seen - 1) % self.look_every:
            return
        compression = fluctuation / self.reference_density
        mean = float(compression.mean())
        variance = float(np.mean((compression - mean) ** 2))
        self._add_work(time, position.T, velocity.T)
        energies = (
            0.5 * float(np.mean(np.sum(velocity**2, axis=1))),
            self.gravity * float(position[:, 1].mean()),
            0.5 * self.sound_speed**2 * variance,
        )
        work = self._work, self._moved, self._unknown
        self._rows.append((time, *energies, *work, math.sqrt(variance), mean))

    def _add_work(self, time: float, position: Array, velocity: Array) -> None:
        """Add the work of the body force since the snapshot before, per mass [m2/s2]."""
        force = self.force
        if force is None:
            return

        def power(at: float, position: Array, velocity: Array) -> float:
            done = float(np.sum(force(position, at) * velocity)) / position.shape[1]
            return done + self.gravity * float(velocity[1].mean())

        now = power(time, position, velocity)
        if self._before is not None:
            begin, then, position_then, velocity_then = self._before
            step = time - begin
            middle = 0.5 * (begin + time)
            power_then = power(middle, position_then, velocity_then)
            between = 0.5 * (power_then + power(middle, position, velocity))
            work = step * (then + 4.0 * between + now) / 6.0
            self._work += work
            self._moved += abs(work)
            self._unknown += abs(work - 0.5 * step * (then + now))
        self._before = time, now, position, velocity

    def findings(self) -> Iterator[str]:
        """Yield the unphysical effects, in words."""
        if len(self._rows) < 2:
            return
        rows = np.array(self._rows).T
        time, kinetic, potential, internal, work, moved, unknown, fluctuation, mean = rows
        gain = kinetic + potential + internal
        gain = gain - gain[0] - work
        expected = 0.5 * self.max_speed**2
        allowed = MOST_UNEXPLAINED * (moved + np.maximum.accumulate(kinetic)) + unknown
        allowed += NO_ENERGY * expected + MOST_OF_DRIVE * 0.5 * self.drive_speed**2
        worst = int(np.argmax(kinetic))
        speed = math.sqrt(2.0 * kinetic[worst])
        if not self.is_driven and speed > MOST_AT_REST * self.max_speed:
            yield (
                f"nothing drives the fluid, but its root mean square speed is {speed:.3g} m/s at "
                f"t = {time[worst]:.4g} s"
            )
        elif (beyond := gain - allowed).max() > 0.0:
            worst = int(np.argmax(beyond))
            speed = math.sqrt(2.0 * gain[worst])
            yield (
                f"at t = {time[worst]:.4g} s the fluid has more energy than the work done on "
                f"it explains: the excess corresponds to a speed of {speed:.3g} m/s of all fluid"
            )
        mach = self.max_speed / self.sound_speed
        most = max(MOST_FLUCTUATION, PER_MACH_SQUARED * mach**2)
        worst = int(fluctuation.argmax())
        if fluctuation[worst] > most:
            yield (
                f"the density fluctuates by {fluctuation[worst]:.2%} (root mean square) at t = "
                f"{time[worst]:.4g} s; a weakly compressible flow stays below {most:.2%}"
            )
        drift = mean - mean[0]
        worst = int(np.abs(drift).argmax())
        if abs(drift[worst]) > (MOST_DRIFT_BELOW_SURFACE if self.has_surface else MOST_DRIFT):
            yield (
                f"the mean density changes by {drift[worst]:+.2%} until t = "
                f"{time[worst]:.4g} s, although no fluid enters or leaves"
            )
