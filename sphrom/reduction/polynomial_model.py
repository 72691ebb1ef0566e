"""Reduced models on the reference points: batches of runs, and steady states.

The cost of a step depends on the number of modes only. Coordinates are (n_modes,) each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sphrom.kernels import polynomial as kernels
from sphrom.reduction.reduced_rates import Polynomial, largest_steps

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Amplitude = Callable[[Array], Array]
"""The amplitude at times (n_times,) [s]."""

SAFETY = 0.9
"""Automatic time step over the stability limit."""
RUNGE_KUTTA, EXPONENTIAL = "runge-kutta", "exponential"
"""Methods of integration, as artifacts name them."""
N_HALVINGS = 20
"""How often a Newton step may be halved."""


def step_limit(polynomial: Polynomial, states: Array, amplitude: float = 0.0) -> float:
    """Return the largest time step [s] that is stable around every state (n_states, n_modes)."""
    return step_limits([(polynomial, states, amplitude)])[0]


def step_limits(systems: Sequence[tuple[Polynomial, Array, float]]) -> list[float]:
    """Return the limits [s] of some systems, given with as many states and an amplitude each."""
    jacobians = [
        polynomial.jacobians(states, amplitude) for polynomial, states, amplitude in systems
    ]
    return [float(limit) for limit in largest_steps(np.stack(jacobians))]


def steps_within(duration: float, limit: float, safety: float = SAFETY) -> int:
    """Return how many equal steps of at most `safety` times a limit [s] make a duration [s]."""
    return max(1, math.ceil(duration / (safety * limit)))


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

    @property
    def duration(self) -> float:
        """From the first snapshot to the last [s]."""
        return self.interval * (self.n_snapshots - 1)

    @cached_property
    def time(self) -> Array:
        """(n_snapshots,) [s]."""
        return self.start_time + self.interval * np.arange(self.n_snapshots, dtype=np.float64)


@dataclass(frozen=True)
class Runs:
    """Coordinates of a batch of runs."""

    time: Array
    """(n_snapshots,) [s]."""
    coordinates: Array
    """(n_runs, n_snapshots, n_modes), NaN from where a run diverged."""
    time_step: Array
    """(n_runs,) [s]."""
    diverged_at: Array
    """(n_runs,) the time [s] of the last step before a run diverged; NaN where it didn't."""
    correction: Array | None = None
    """(n_runs, n_snapshots, n_modes) the part of the coordinates that training runs add."""


class PolynomialModel:
    """A batch of polynomial systems, such as one model at many parameters.

    Raises ValueError when they differ in modes or degrees.
    """

    integrator = RUNGE_KUTTA

    def __init__(self, polynomials: Sequence[Polynomial]) -> None:
        packed = [polynomial.packed() for polynomial in polynomials]
        if len({(coefficients.shape, tuple(used)) for coefficients, used in packed}) != 1:
            raise ValueError("polynomials of one batch must have the same modes and degrees")
        self._coefficients = np.stack([coefficients for coefficients, _ in packed])
        self._used = packed[0][1]
        self._degree = polynomials[0].degree

    @property
    def n_runs(self) -> int:
        """How many systems there are."""
        return len(self._coefficients)

    def steps_taken(self, n_steps: int, output_times: OutputTimes) -> int:
        """Return the steps that a run asked for some over a output_times takes: as many."""
        return n_steps

    def time_step(self, n_steps: int, output_times: OutputTimes) -> float:
        """Return the length [s] of the steps of a run that is asked for some."""
        return output_times.interval * max(1, output_times.n_snapshots - 1) / max(1, n_steps)

    def run_in(
        self,
        n_steps: Indices | Sequence[int],
        start: Array,
        output_times: OutputTimes,
        amplitude: Amplitude | None = None,
    ) -> Runs:
        """Advance all systems from coordinates (n_runs, n_modes) by Runge-Kutta steps (Eq. 2.18).

        Snapshots within a step are interpolated by the cubic of the states and slopes at its ends.

        Parameters
        ----------
        n_steps : (n_runs,) the equal steps from the start to the last snapshot.
        amplitude : None where it is zero throughout.
        """
        wanted = np.asarray(n_steps, dtype=np.int64)
        n_modes = start.shape[1]
        # Exactly a part of the interval where steps end on every snapshot.
        per_snapshot = np.maximum(wanted, 1) / max(1, output_times.n_snapshots - 1)
        time_step = output_times.interval / per_snapshot
        out = np.full((self.n_runs, output_times.n_snapshots, n_modes), np.nan)
        out[:, 0] = start
        steps = np.empty(self.n_runs, dtype=np.int64)
        coefficients, used, amplitudes = self._driven(
            output_times.start_time, wanted, time_step, amplitude
        )
        scratch = (
            np.empty((self.n_runs, coefficients.shape[3])),
            np.empty((self.n_runs, 5, n_modes)),
        )
        common = (self._degree, output_times.largest_norm**2)
        if self.n_runs == 1:
            # One run needs no threads, and starting them takes longer than many a run.
            steps[0] = kernels.integrate(
                coefficients[0], used, amplitudes[0], time_step[0], wanted[0], *common,
                scratch[0][0], scratch[1][0], out[0],
            )  # fmt: skip
        else:
            kernels.integrate_batch(
                coefficients, used, amplitudes, time_step, wanted, *common, *scratch, out, steps
            )
        diverged = np.where(steps == wanted, np.nan, output_times.start_time + steps * time_step)
        return Runs(output_times.time, out, time_step, diverged)

    def _driven(
        self, start_time: float, n_steps: Indices, time_step: Array, amplitude: Amplitude | None
    ) -> tuple[Array, Indices, Array]:
        """Return the coefficients that count, and the amplitudes at the substeps of each run."""
        if amplitude is None:
            return self._coefficients[:, :1], self._used[:1], np.zeros((self.n_runs, 3))
        n_times = 2 * n_steps + 1
        amplitudes = np.zeros((self.n_runs, max(3, int(n_times.max()))))
        for row, n, step in zip(amplitudes, n_times, time_step, strict=True):
            row[:n] = amplitude(start_time + 0.5 * step * np.arange(n))
        return self._coefficients, self._used, amplitudes


@dataclass(frozen=True)
class SteadyState:
    """Where the rates vanish, or as near as Newton's method came."""

    coordinates: Array
    residual: float
    """The rates' norm [1/s]."""
    n_steps: int
    converged: bool


def steady_state(
    polynomial: Polynomial,
    start: Array,
    *,
    amplitude: float = 0.0,
    tolerance: float = 1e-10,
    max_steps: int = 50,
) -> SteadyState:
    """Find coordinates at which the rates vanish, by Newton's method with halved steps.

    It has converged when the rates' norm is below `tolerance` times that of the constant and the
    linear part. Whether the state is stable is for `spectrum` of its Jacobian to say.
    """
    state, rates = np.array(start), polynomial(start, amplitude)
    for n_steps in range(max_steps):
        residual = float(np.linalg.norm(rates))
        constant = polynomial(np.zeros_like(state), amplitude)
        linear = polynomial.at_rest(amplitude) @ state
        size = float(np.linalg.norm(constant) + np.linalg.norm(linear))
        if residual <= tolerance * size:
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
    return SteadyState(state, float(np.linalg.norm(rates)), max_steps, False)
