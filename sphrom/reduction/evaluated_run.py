"""Runs of reduced rates that are evaluated anew at each state, as at all points they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.polynomial_model import Runs, Schedule
from sphrom.sph.fixed_points import Surroundings
from sphrom.sph.runge_kutta import runge_kutta_step

Array = NDArray[np.float64]
Rates = Callable[[Array, Surroundings], Array]
"""From coordinates (n_modes,) and what surrounds the fluid, their rates (n_modes,)."""


@dataclass(frozen=True)
class Drive:
    """What surrounds the fluid over time."""

    kinematic_viscosity: float
    """[m2/s]."""
    amplitude: Callable[[float], float] = lambda time: 0.0
    """Of the body force, or of driven walls, at a time [s]."""

    def at(self, time: float) -> Surroundings:
        """Return what surrounds the fluid at a time [s]."""
        return Surroundings(self.kinematic_viscosity, amplitude=self.amplitude(time))


def integrate(
    rates: Rates,
    start: Array,
    schedule: Schedule,
    steps_per_snapshot: int,
    drive: Drive,
    advance: Callable[[int], None] = lambda n_snapshots: None,
) -> Runs:
    """Advance coordinates (n_modes,) by Runge-Kutta steps (Eq. 2.18), for any rates.

    `advance` is called with one after each snapshot.
    """
    time_step = schedule.interval / steps_per_snapshot
    out = np.full((1, schedule.n_snapshots, len(start)), np.nan)
    out[0, 0] = state = start
    diverged, step = np.nan, 0

    def functional(coordinates: Array, time: float) -> Array:
        return rates(coordinates, drive.at(time))

    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for snapshot in range(1, schedule.n_snapshots):
            for _ in range(steps_per_snapshot):
                time = schedule.start_time + step * time_step
                state = runge_kutta_step(functional, state, time, time_step)
                if not np.linalg.norm(state) <= schedule.largest_norm:
                    return Runs(schedule.time, out, np.array([time_step]), np.array([time]))
                step += 1
            out[0, snapshot] = state
            advance(1)
    return Runs(schedule.time, out, np.array([time_step]), np.array([diverged]))
