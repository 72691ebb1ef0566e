"""Reduced models on the reference points: steps of Runge and Kutta, and steady states.

The cost of a step depends on the number of modes only. Coordinates are (n_modes,) each.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.kernels import polynomial as kernels
from sphrom.reduction.reduced_rates import Polynomial, stability_limits

Amplitude = Callable[[Array], Array]
"""The amplitude at times (n_times,) [s]."""
Driven = tuple[Array, Indices, Array]
"""The coefficients that count, how many, and the amplitudes at substeps."""

SAFETY = 0.9
"""Automatic time step over the stability limit."""
RUNGE_KUTTA, EXPONENTIAL = "runge-kutta", "exponential"
"""Methods of integration, as artifacts name them."""
CONVERGED, MOST_STEPS, N_HALVINGS = 1e-10, 50, 20
"""Of Newton's method: the rates of a steady state over their terms, the number of steps, and how
often each may be halved."""


def step_limit(polynomial: Polynomial, states: Array, amplitude: float = 0.0) -> float:
    """Return the largest time step [s] that is stable around every state (n_states, n_modes)."""
    eigenvalues = np.linalg.eigvals(polynomial.jacobians(states, amplitude))
    return float(stability_limits(eigenvalues.ravel().astype(np.complex128)).min())


def steps_within(duration: float, limit: float) -> int:
    """Return how many equal steps of at most `SAFETY` times a limit [s] make a duration [s]."""
    return max(1, math.ceil(duration / (SAFETY * limit)))


@dataclass(frozen=True)
class OutputTimes:
    """The snapshots of a run, and when it counts as divergent."""

    interval: float
    """From one snapshot to the next [s]."""
    n_snapshots: int
    """The start among them."""
    start_time: float = 0.0
    """[s]."""
    largest_norm: float = 1e100
    """Of the coordinates; beyond it a run has diverged."""
    trained: float = math.inf
    """The time for which that is so [s]; longer runs may grow in proportion."""

    @property
    def duration(self) -> float:
        """From the first snapshot to the last [s]."""
        return self.interval * (self.n_snapshots - 1)

    @property
    def largest_square(self) -> float:
        """Of the norm of coordinates that count as those of a flow."""
        return (self.largest_norm * max(1.0, self.duration / self.trained)) ** 2

    @cached_property
    def time(self) -> Array:
        """(n_snapshots,) [s]."""
        return self.start_time + self.interval * np.arange(self.n_snapshots, dtype=np.float64)


@dataclass(frozen=True)
class Run:
    """Coordinates of a run."""

    time: Array
    """(n_snapshots,) [s]."""
    coordinates: Array
    """(n_snapshots, n_modes), NaN from where the run diverged."""
    time_step: float
    """[s]."""
    diverged_at: float
    """The time [s] of the last step before the run diverged; NaN where it didn't."""
    correction: Array | None = None
    """(n_snapshots, n_modes) the part of the coordinates that training runs add."""


class PolynomialModel:
    """A polynomial system in Runge-Kutta steps (Eq. 2.18).

    Snapshots within a step are interpolated by the cubic of the states and slopes at its ends.
    """

    integrator = RUNGE_KUTTA

    def __init__(self, polynomial: Polynomial) -> None:
        self._coefficients, self._used = polynomial.packed()
        self._degree = polynomial.degree

    def steps_taken(self, n_steps: int, output_times: OutputTimes) -> int:
        """Return the steps that a run asked for some takes: as many."""
        return n_steps

    def time_step(self, n_steps: int, output_times: OutputTimes) -> float:
        """Return the length [s] of the steps of a run that is asked for some."""
        # Exactly a part of the interval where steps end on every snapshot.
        per_snapshot = max(n_steps, 1) / max(1, output_times.n_snapshots - 1)
        return output_times.interval / per_snapshot

    def run(
        self,
        n_steps: int,
        start: Array,
        output_times: OutputTimes,
        amplitude: Amplitude | None = None,
    ) -> Run:
        """Advance the system from coordinates (n_modes,), in some equal steps at least.

        An amplitude of None is zero throughout.
        """
        out = np.full((output_times.n_snapshots, start.size), np.nan)
        out[0] = start
        taken = self.steps_taken(n_steps, output_times)
        time_step = self.time_step(n_steps, output_times)
        driven = self._driven(output_times.start_time, taken, time_step, amplitude)
        done = self._integrate(n_steps, output_times, driven, out)
        diverged_at = math.nan if done == taken else output_times.start_time + done * time_step
        return Run(output_times.time, out, time_step, diverged_at)

    def _integrate(
        self, n_steps: int, output_times: OutputTimes, driven: Driven, out: Array
    ) -> int:
        """Fill the snapshots after the first, and return the steps before it diverged, or all."""
        return kernels.integrate(
            *driven, self.time_step(n_steps, output_times), n_steps, self._degree,
            output_times.largest_square, np.empty(driven[0].shape[2]),
            np.empty((5, out.shape[1])), out,
        )  # fmt: skip

    def _driven(
        self, start_time: float, n_steps: int, time_step: float, amplitude: Amplitude | None
    ) -> Driven:
        if amplitude is None:
            return self._coefficients[:1], self._used[:1], np.zeros(3)
        times = start_time + 0.5 * time_step * np.arange(max(3, 2 * n_steps + 1), dtype=np.float64)
        return self._coefficients, self._used, amplitude(times)


@dataclass(frozen=True)
class SteadyState:
    """Where the rates vanish, or as near as Newton's method came."""

    coordinates: Array
    residual: float
    """The rates' norm [1/s]."""
    n_steps: int
    converged: bool


def steady_state(polynomial: Polynomial, start: Array, amplitude: float = 0.0) -> SteadyState:
    """Find coordinates at which the rates vanish, by Newton's method with halved steps.

    It has converged when the rates' norm is below `CONVERGED` times that of the constant and the
    linear part. Whether the state is stable is for the eigenvalues of its Jacobian to say.
    """
    state, rates = np.array(start), polynomial(start, amplitude)
    for n_steps in range(MOST_STEPS):
        residual = float(np.linalg.norm(rates))
        constant = polynomial(np.zeros_like(state), amplitude)
        linear = polynomial.at_rest(amplitude) @ state
        size = float(np.linalg.norm(constant) + np.linalg.norm(linear))
        if residual <= CONVERGED * size:
            return SteadyState(state, residual, n_steps, True)
        try:
            change = np.linalg.solve(polynomial.jacobian(state, amplitude), -rates)
        except np.linalg.LinAlgError:
            return SteadyState(state, residual, n_steps, False)
        for halving in range(N_HALVINGS):
            ahead = state + 0.5**halving * change
            rates = polynomial(ahead, amplitude)
            if np.linalg.norm(rates) < residual:
                break
        else:
            return SteadyState(state, residual, n_steps, False)
        state = ahead
    return SteadyState(state, float(np.linalg.norm(rates)), MOST_STEPS, False)
