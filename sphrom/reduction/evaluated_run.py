"""Runs of reduced rates that are evaluated at all points anew for each state."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.polynomial_model import RUNGE_KUTTA, OutputTimes, Runs
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.sph.drives import Factors
from sphrom.sph.fluid import FlowConditions
from sphrom.sph.runge_kutta import runge_kutta_step

Array = NDArray[np.float64]
Rates = Callable[[Array, FlowConditions], Array]
"""From coordinates (n_modes,) and the conditions of the flow, their rates (n_modes,)."""

SHORT, MOST_TIMED = 1.0, 5
"""Runs are repeated for their timing within so many seconds, so many times at most."""


@dataclass(frozen=True)
class EvaluatedIntegrator:
    """Runge-Kutta steps (Eq. 2.18) of a model with rates that are evaluated at points."""

    model: ReferenceModel
    rates: Rates
    kinematic_viscosity: float
    """[m2/s]."""
    steps_per_snapshot: int
    factors: Factors = field(default_factory=dict)
    """The values of the parameters that drive the flow."""

    name = RUNGE_KUTTA

    @property
    def time_step(self) -> float:
        """The length of its steps [s]."""
        output_times = self.model.output_times
        n_intervals = max(1, output_times.n_snapshots - 1)
        return output_times.interval * n_intervals / (self.steps_per_snapshot * n_intervals)

    def run(self) -> Runs:
        """Run the model."""
        return self._run(lambda n_snapshots: None)

    def timed(self, repeats: int, advance: Callable[[int], None]) -> tuple[Runs, float]:
        """Run it, and return the least time [s] of some runs: a few if runs are short, else one."""
        seconds: list[float] = []
        while not seconds or (sum(seconds) < SHORT and len(seconds) < MOST_TIMED):
            began = time.perf_counter()
            runs = self._run((lambda n_snapshots: None) if seconds else advance)
            seconds.append(time.perf_counter() - began)
        return runs, min(seconds)

    def _run(self, advance: Callable[[int], None]) -> Runs:
        def functional(coordinates: Array, time: float) -> Array:
            return self.rates(coordinates, self.conditions(time))

        model = self.model
        return integrate(
            functional, model.start, model.output_times, self.steps_per_snapshot, advance
        )

    def conditions(self, time: float) -> FlowConditions:
        """Return the conditions of the flow at a time [s]."""
        amplitude = self.model.amplitude
        strength = 0.0 if amplitude is None else float(amplitude(np.array([time]))[0])
        return FlowConditions(self.kinematic_viscosity, amplitude=strength, factors=self.factors)


def integrate(
    functional: Callable[[Array, float], Array],
    start: Array,
    output_times: OutputTimes,
    steps_per_snapshot: int,
    advance: Callable[[int], None] = lambda n_snapshots: None,
) -> Runs:
    """Advance coordinates (n_modes,) by Runge-Kutta steps (Eq. 2.18), for any rates.

    Parameters
    ----------
    functional : the rates (n_modes,) of coordinates at a time [s].
    advance : called with one after each snapshot.
    """
    time_step = output_times.interval / steps_per_snapshot
    out = np.full((1, output_times.n_snapshots, len(start)), np.nan)
    out[0, 0] = state = start
    diverged, step = np.nan, 0
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for snapshot in range(1, output_times.n_snapshots):
            for _ in range(steps_per_snapshot):
                time = output_times.start_time + step * time_step
                state = runge_kutta_step(functional, state, time, time_step)
                if not np.linalg.norm(state) <= output_times.largest_norm:
                    return Runs(output_times.time, out, np.array([time_step]), np.array([time]))
                step += 1
            out[0, snapshot] = state
            advance(1)
    return Runs(output_times.time, out, np.array([time_step]), np.array([diverged]))
