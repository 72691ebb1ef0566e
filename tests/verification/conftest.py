"""Full and reduced runs of the Taylor-Green vortex, small enough for a test."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sphrom.metrics.histories import relative_l2, without_mean
from sphrom.scenes.flows import TaylorGreen
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import Discretization, Fluid, step_limits
from sphrom.sph.functional import Functional
from sphrom.sph.packing import pack
from sphrom.sph.time_loop import runge_kutta_step

Array = NDArray[np.float64]
DENSITY, SPEED = 1000.0, 1.0


@dataclass(frozen=True)
class Vortex:
    """The vortex in the unit box, cut into particles."""

    resolution: int
    ratio: float = 2.0
    reynolds: float = 100.0
    mach: float = 0.1
    courant: float = 0.5
    pressure_sign: float = 1.0
    damping: float = 1.0

    @property
    def fluid(self) -> Fluid:
        return Fluid(DENSITY, SPEED / self.mach, 1.0 / self.reynolds, SPEED)

    @property
    def domain(self) -> Domain:
        return BoxDomain((0.0, 0.0), (1.0, 1.0), (True, True))

    @property
    def discretization(self) -> Discretization:
        spacing = 1.0 / self.resolution
        return Discretization(spacing, self.ratio * spacing, acoustic_damping=self.damping)

    @property
    def flow(self) -> TaylorGreen:
        return TaylorGreen(1.0, SPEED, DENSITY, 1.0 / self.reynolds)

    @property
    def functional(self) -> Functional:
        return Functional(self.fluid, self.discretization, self.domain)

    def start(self) -> Array:
        """Return the full state of packed particles at the start."""
        position = pack(self.domain, self.discretization, tolerance=1e-5).position
        flow = replace(self.flow, pressure_sign=self.pressure_sign)
        density = flow.pressure(position, 0.0) / self.fluid.sound_speed**2
        return np.vstack((position.T, density, flow.velocity(position, 0.0).T))

    def steps(self, time: float) -> tuple[int, float]:
        """Return how many steps there are to a time [s], and the step [s]."""
        length = self.discretization.smoothing_length
        longest = self.courant * length / self.fluid.sound_speed
        limits = step_limits(self.fluid, self.discretization)
        count = math.ceil(time / min(longest, limits.viscous))
        return count, time / count


@dataclass(frozen=True)
class Run:
    """A run's snapshots, and what was measured of them."""

    vortex: Vortex
    time: Array
    states: Array
    """(n_snapshots, 5, n_particles)."""

    def velocity_errors(self) -> Array:
        """Return the relative L2 errors [%] against the exact flow."""
        return np.array(
            [
                float(relative_l2(s[3:].T, self.vortex.flow.velocity(s[:2].T, t), field_axes=2))
                for t, s in zip(self.time, self.states, strict=True)
            ]
        )

    def pressure_errors(self) -> Array:
        """Return the relative L2 errors [%] against the exact flow, means removed."""
        stiffness = self.vortex.fluid.sound_speed**2
        return np.array(
            [
                float(
                    relative_l2(
                        without_mean(stiffness * s[2]), self.vortex.flow.pressure(s[:2].T, t)
                    )
                )
                for t, s in zip(self.time, self.states, strict=True)
            ]
        )


def run_full(vortex: Vortex, time: float, every: int = 5) -> Run:
    """Run the full model to a time [s]."""
    n_steps, step = vortex.steps(time)
    functional, state = vortex.functional, vortex.start()
    times, states = [0.0], [state]
    for n in range(1, n_steps + 1):
        state = runge_kutta_step(functional, state, (n - 1) * step, step)
        if n % every == 0 or n == n_steps:
            times.append(n * step)
            states.append(state)
    return Run(vortex, np.array(times), np.array(states))


@pytest.fixture(scope="session")
def vortex() -> type[Vortex]:
    return Vortex


@pytest.fixture(scope="session")
def full_run() -> Callable[..., Run]:
    return run_full
