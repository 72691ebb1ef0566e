"""Reduced models on the reference points: Runge-Kutta time steps, and steady states.

The cost of a step depends on the number of modes only. Coordinates are (n_modes,) each.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.reduction.reduced_operators import Polynomial, stability_limits

Amplitude = Callable[[Array], Array]
"""The amplitude at times (n_times,) [s]."""
Driven = tuple[Array, Indices, Array]
"""The used coefficients, their number per row, and the amplitudes at substeps."""

SAFETY = 0.9
"""Automatic time step over the stability limit."""
RUNGE_KUTTA, EXPONENTIAL = "runge-kutta", "exponential"
"""Names of the integration methods in artifacts."""
CONVERGED, MOST_STEPS, N_HALVINGS = 1e-10, 50, 20
"""Newton's method: norm of a steady state's rates relative to that of their terms, largest number
of steps, largest number of halvings of a step."""


def step_limit(polynomial: Polynomial, states: Array, amplitude: float = 0.0) -> float:
    """Return the largest time step [s] that is stable around every state (n_states, n_modes)."""
    eigenvalues = np.linalg.eigvals(polynomial.jacobians(states, amplitude))
    return float(stability_limits(eigenvalues.ravel().astype(np.complex128)).min())


def steps_within(duration: float, limit: float) -> int:
    """Return the number of equal steps over a duration [s], each at most `SAFETY` times a limit."""
    return max(1, math.ceil(duration / (SAFETY * limit)))


@dataclass(frozen=True)
class OutputTimes:
    """The snapshot times of a run, and the norm beyond which it counts as diverged."""

    interval: float
    """Time between snapshots [s]."""
    n_snapshots: int
    """Number of snapshots, including the start."""
    start_time: float = 0.0
    """[s]."""
    largest_norm: float = 1e100
    """Largest norm of the coordinates; a run with a larger norm has diverged."""
    trained: float = math.inf
    """Duration for which the limit holds [s]; it grows in proportion for longer runs."""

    @property
    def duration(self) -> float:
        """Time from the first to the last snapshot [s]."""
        return self.interval * (self.n_snapshots - 1)

    @property
    def largest_square(self) -> float:
        """Square of the norm beyond which coordinates have diverged."""
        return (self.largest_norm * max(1.0, self.duration / self.trained)) ** 2

    @cached_property
    def time(self) -> Array:
        """(n_snapshots,) [s]."""
        return self.start_time + self.interval * np.arange(self.n_snapshots, dtype=np.float64)


@dataclass(frozen=True)
class Run:
    """The coordinates of a run."""

    time: Array
    """(n_snapshots,) [s]."""
    coordinates: Array
    """(n_snapshots, n_modes), NaN once the run has diverged."""
    time_step: float
    """[s]."""
    diverged_at: float
    """Time [s] of the last step before the run diverged; NaN if it did not."""
    correction: Array | None = None
    """(n_snapshots, n_modes), the part of the coordinates that the correction adds."""


@cache
def _compiled() -> Callable[..., int]:
    """Return the compiled steps, which only runs need."""
    from sphrom.kernels.polynomial import integrate

    return integrate


class PolynomialModel:
    """A polynomial system integrated by Runge-Kutta steps (Eq. 2.18).

    Snapshots within a step are interpolated by cubics through the states and slopes at its ends.
    """

    integrator = RUNGE_KUTTA

    def __init__(self, polynomial: Polynomial) -> None:
        self._coefficients, self._used = polynomial.packed()
        self._degree = polynomial.degree

    def steps_taken(self, n_steps: int, output_times: OutputTimes) -> int:
        """Return the number of steps taken by a run with `n_steps` requested: the same."""
        return n_steps

    def time_step(self, n_steps: int, output_times: OutputTimes) -> float:
        """Return the time step [s] of a run with `n_steps` steps."""
        # An exact fraction of the interval if steps end on every snapshot.
        per_snapshot = max(n_steps, 1) / max(1, output_times.n_snapshots - 1)
        return output_times.interval / per_snapshot

    def run(
        self,
        n_steps: int,
        start: Array,
        output_times: OutputTimes,
        amplitude: Amplitude | None = None,
    ) -> Run:
        """Integrate the system from coordinates (n_modes,), in at least `n_steps` equal steps.

        An amplitude of None is zero at all times.
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
        """Fill the snapshots after the first; return the number of steps before a divergence."""
        return _compiled()(
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
    """A zero of the rates, or the closest state that Newton's method reached."""

    coordinates: Array
    residual: float
    """Norm of the rates [1/s]."""
    n_steps: int
    converged: bool


def steady_state(polynomial: Polynomial, start: Array, amplitude: float = 0.0) -> SteadyState:
    """Find a zero of the rates by Newton's method with step halving.

    It has converged if the norm of the rates is below `CONVERGED` times that of the constant and
    linear parts. The eigenvalues of the Jacobian there show whether the state is stable.
    """
    state = np.array(start)
    rates = polynomial(start, amplitude)
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
