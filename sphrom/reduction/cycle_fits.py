"""Limit cycles of runs: harmonics that are fitted to coordinates, and checks of runs.

A run with a second line in its spectrum, which is no harmonic of the first, has no limit cycle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.metrics.series import dominant_frequency

Harmonics = NDArray[np.complex128]
"""A_k (1 + N_HARMONICS, n_values)."""

N_HARMONICS = 4
ORDERS = np.arange(1 + N_HARMONICS)
N_PHASES = 64
"""Number of phases of a cycle at which rates are fitted."""
PHASES = 2.0 * np.pi * np.arange(N_PHASES) / N_PHASES
PERIODIC = 0.9
"""Least share of a run's fluctuations that the harmonics have to explain."""
SECOND = 0.02
"""Largest share of a second line, no harmonic of the first, in a run's fluctuations."""
DECAYS = 0.9
"""Amplitude in the second half of a record relative to that in the first, below which it decays."""


@dataclass(frozen=True)
class LimitCycle:
    """A periodic state in generalized coordinates."""

    frequency: float
    """omega [rad/s]."""
    harmonics: Harmonics
    """Harmonics of the coordinates."""

    @property
    def states(self) -> Array:
        """(N_PHASES, n_modes), at equally spaced phases."""
        return around(self.harmonics)

    def at(self, time: Array) -> Array:
        """Return the states (n_times, n_modes) at times (n_times,) [s]."""
        return np.asarray(
            (np.exp(1j * self.frequency * np.outer(time, ORDERS)) @ self.harmonics).real
        )

    @property
    def rates(self) -> Array:
        """(N_PHASES, n_modes), the time derivatives of the states [1/s]."""
        return around(1j * self.frequency * ORDERS[:, None] * self.harmonics)


def around(harmonics: Harmonics) -> Array:
    """Return values (N_PHASES, n_values) at equally spaced phases."""
    return np.asarray((np.exp(1j * np.outer(PHASES, ORDERS)) @ harmonics).real)


def harmonics_of(time: Array, values: Array, frequency: float) -> Harmonics:
    """Return the harmonics of values (n_times, n_values) at a frequency [rad/s]."""
    turns = frequency * np.outer(time, ORDERS)
    waves = np.hstack((np.cos(turns), np.sin(turns[:, 1:])))
    fitted = np.linalg.lstsq(waves, values)[0].astype(np.complex128)
    fitted[1 : len(ORDERS)] -= 1j * fitted[len(ORDERS) :]
    return fitted[: len(ORDERS)]


def fitted_cycle(time: Array, states: Array) -> LimitCycle:
    """Return the cycle of a run's coordinates (n_snapshots, n_modes).

    Raises ValueError if the run is too short, not periodic, or its oscillation decays.
    """
    from scipy.optimize import minimize_scalar  # few models need it

    moved = states - states.mean(axis=0)
    leading = moved @ np.linalg.svd(moved, full_matrices=False)[2][0]
    first = 2.0 * math.pi * dominant_frequency(time, leading)

    def rest(frequency: float) -> Array:
        return states - LimitCycle(frequency, harmonics_of(time, states, frequency)).at(time)

    def missed(frequency: float) -> float:
        return float(np.sum(rest(frequency) ** 2))

    step = 0.1 * math.pi / float(time[-1] - time[0])
    frequency = float(minimize_scalar(missed, bracket=(first - step, first + step)).x)
    whole = float(np.sum(moved**2))
    explained = 1.0 - missed(frequency) / whole
    second, size = _second_line(time, rest(frequency), frequency)
    if not explained > PERIODIC or size > SECOND * whole:
        text = (
            f"is not periodic: harmonics of {frequency / (2.0 * math.pi):.4g} Hz explain "
            f"{100.0 * explained:.0f} % of its fluctuations"
        )
        if size > 0.0:
            text += f", and a second line, of {second:.4g} Hz, {100.0 * size / whole:.1f} %"
        raise ValueError(text)
    middle = len(time) // 2
    first, last = (
        float(np.linalg.norm(harmonics_of(time[half], states[half], frequency)[1]))
        for half in (slice(middle), slice(middle, None))
    )
    if last < DECAYS * first:
        raise ValueError(
            f"is not periodic: its oscillation decays, by {100.0 * (1.0 - last / first):.0f} % "
            "from the first half of the record to the second, so the flow may be steady there"
        )
    return LimitCycle(frequency, harmonics_of(time, states, frequency))


def _second_line(time: Array, rest: Array, frequency: float) -> tuple[float, float]:
    """Return the strongest line [Hz] that is no harmonic of a frequency [rad/s], and its size.

    `rest` (n_snapshots, n_modes) are the coordinates without these harmonics. The size is the sum
    of squares of the line; zero without a line that the record tells from a harmonic.
    """
    moved = rest - rest.mean(axis=0)
    try:
        line = dominant_frequency(time, moved @ np.linalg.svd(moved, full_matrices=False)[2][0])
    except ValueError:
        return 0.0, 0.0
    orders = 2.0 * math.pi * line / frequency
    resolution = 2.0 * math.pi / float(time[-1] - time[0]) / frequency
    if abs(orders - round(orders)) < resolution:
        return line, 0.0
    harmonics = harmonics_of(time, rest, 2.0 * math.pi * line)
    harmonics[2:] = harmonics[0] = 0.0
    return line, float(np.sum(LimitCycle(2.0 * math.pi * line, harmonics).at(time) ** 2))
