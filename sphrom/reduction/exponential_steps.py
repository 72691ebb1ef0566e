"""Reduced models on the reference points with time steps that sound does not limit.

The rates around a flow are stiff because of sound, whose frequencies are those of a linear part L:
rates(a) = L a + N(a). Exponential Runge-Kutta steps (Cox and Matthews 2002, Krogstad 2005)
integrate L exactly. They are of fourth order in the rest N, which changes as slowly as the flow.
The values of N within a step define a parabola in time. Its exact integral (by the functions phi_1
to phi_3 of L) gives the state anywhere in the step: at snapshots many periods of sound apart.

The closer L is to the Jacobian along a run, the longer the steps may be. The Jacobian at the mean
of the training states serves all runs near a training point. The solution does not depend on L.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from sphrom.arrays import Array
from sphrom.reduction.polynomial_model import (
    EXPONENTIAL,
    Amplitude,
    Driven,
    OutputTimes,
    PolynomialModel,
)
from sphrom.reduction.reduced_operators import Polynomial

N_INTEGRALS = 3
"""Number of phi functions for a parabola."""


@dataclass(frozen=True)
class StepRatio:
    """How many steps there are per snapshot or snapshots per step; one of the numbers is one."""

    snapshots_per_step: int
    steps_per_snapshot: int

    @classmethod
    def of(cls, n_steps: int, n_intervals: int) -> StepRatio:
        """Return the ratio for `n_steps` or slightly more steps over `n_intervals` intervals."""
        if n_steps <= 1:
            return cls(max(1, n_intervals), 1)
        if n_steps < n_intervals:
            longest = (n_intervals - 1) // (n_steps - 1)
            taken = math.ceil(n_intervals / longest)
            # The same number of steps may be shorter, so that the last one overshoots less.
            return cls(math.ceil(n_intervals / taken), 1)
        return cls(1, math.ceil(n_steps / max(1, n_intervals)))

    def n_steps(self, n_intervals: int) -> int:
        """Return the number of steps over some intervals; the last one may end beyond them."""
        return math.ceil(n_intervals / self.snapshots_per_step) * self.steps_per_snapshot

    def time_step(self, interval: float) -> float:
        """Return the time step [s], given the time between snapshots [s]."""
        return interval * self.snapshots_per_step / self.steps_per_snapshot


def integrals(linear: Array, time_step: float) -> Array:
    """Return t^k phi_k(t L) for a linear part (n_modes, n_modes) and a time t [s], k = 0 to 3.

    The shape is (4, n_modes, n_modes), the unit s^k. The first one is the exponential.
    """
    n_modes = len(linear)
    chain = np.zeros(((N_INTEGRALS + 1) * n_modes,) * 2)
    chain[:n_modes, :n_modes] = time_step * linear
    # Each block row is the derivative of the one before, so the exponential holds all integrals.
    chain[:-n_modes, n_modes:] += time_step * np.eye(N_INTEGRALS * n_modes)
    # Runge-Kutta steps do not need this module, and importing it takes long.
    from scipy.linalg import expm

    rows: Array = expm(chain)[:n_modes].reshape(n_modes, N_INTEGRALS + 1, n_modes)
    return rows.transpose(1, 0, 2)


def after(first: Array, second: Array, time_step: float) -> Array:
    """Return the integrals at the sum of two times, the second of which is a time step [s]."""
    both: Array = first[0] @ second
    powers = np.array([time_step**i / math.factorial(i) for i in range(N_INTEGRALS)])
    for j in range(1, N_INTEGRALS + 1):
        both[j:] += powers[: N_INTEGRALS + 1 - j, None, None] * first[j]
    return both


Matrices = tuple[Array, Array, Array]
"""Matrices of steps of one length: stages, links and ends (`sphrom.kernels.exponential`)."""


def _matrices(halves: Callable[[int], Array], time_step: float, n_states: int) -> Matrices:
    """Return the matrices of steps of a length [s] that output some equally spaced states.

    `halves` returns the integrals at a multiple of half the time between two states.
    """
    reached = [halves(2 * k) for k in range(1, n_states + 1)]
    half = halves(n_states)
    end = reached[-1]
    to_third, to_fourth = 4.0 * half[2] / time_step, 2.0 * end[2] / time_step
    # The weights of the start in the later stages, and those of stages in each other (Krogstad).
    second, third = [half[0], half[1]], [half[0], half[1] - to_third]
    fourth = [end[0], end[1] - to_fourth]
    stages = np.array([second, third, fourth])
    links = np.array([to_third, to_fourth])
    # The weights of the start and of the three values that give a parabola, in the states.
    power, phi_1, phi_2, phi_3 = np.stack(reached, axis=1)
    phi_2, phi_3 = phi_2 / time_step, phi_3 / time_step**2
    start = phi_1 - 3.0 * phi_2 + 4.0 * phi_3
    ends = np.array([power, start, 4.0 * phi_2 - 8.0 * phi_3, 4.0 * phi_3 - phi_2])
    # Kernels sum over columns, so the index of the result comes last.
    n_modes = ends.shape[-1]
    return (
        np.ascontiguousarray(stages.transpose(1, 3, 0, 2)).reshape(2, n_modes, -1),
        np.ascontiguousarray(links.transpose(0, 2, 1)),
        np.ascontiguousarray(ends.transpose(0, 3, 1, 2)).reshape(4, n_modes, -1),
    )


class LinearPart:
    """The linear part of steps (n_modes, n_modes) [1/s], and the matrices that follow from it.

    The matrices are computed once for all systems with this linear part.
    """

    def __init__(self, matrix: Array) -> None:
        self.matrix = matrix
        self._integrals: dict[float, list[Array]] = {}
        self._matrices: dict[tuple[float, StepRatio], Matrices] = {}

    def integrals(self, unit: float, multiple: int) -> Array:
        """Return the integrals (4, n_modes, n_modes) at a multiple (1 or more) of a time [s].

        Each is computed from the one before.
        """
        if unit not in self._integrals:
            self._integrals[unit] = [integrals(self.matrix, unit)]
        computed = self._integrals[unit]
        while len(computed) < multiple:
            computed.append(after(computed[-1], computed[0], unit))
        return computed[multiple - 1]

    def steps(self, interval: float, ratio: StepRatio) -> Matrices:
        """Return the matrices of steps, given the time between snapshots [s]."""
        if (key := (interval, ratio)) not in self._matrices:
            halves = partial(self.integrals, 0.5 * interval / ratio.steps_per_snapshot)
            step = ratio.time_step(interval)
            self._matrices[key] = _matrices(halves, step, ratio.snapshots_per_step)
        return self._matrices[key]


@dataclass(frozen=True)
class Change:
    """The derivative of a system with respect to one parameter."""

    polynomial: Polynomial
    """Derivative of the rates, with tensors of the same shapes as the system's."""
    start: Array
    """(n_modes,) Of the start coordinates."""
    amplitude: Amplitude | None = None
    """Derivative of the amplitude; None if it does not depend on the parameter."""


@cache
def _compiled() -> Callable[..., int]:
    """Return the compiled steps, which only runs need."""
    from sphrom.kernels.exponential import integrate

    return integrate


class ExponentialModel(PolynomialModel):
    """A polynomial system whose steps integrate a linear part exactly.

    A step spans a whole number of snapshot intervals, or an interval a whole number of steps. The
    last step may end beyond the last snapshot.
    """

    integrator = EXPONENTIAL

    def __init__(self, polynomial: Polynomial, linear: LinearPart) -> None:
        super().__init__(polynomial)
        self.linear = linear
        self._coefficients[0, :, 1 : 1 + len(linear.matrix)] -= linear.matrix

    def steps_taken(self, n_steps: int, output_times: OutputTimes) -> int:
        """Return the number of steps taken: `n_steps` or a few more, to match the snapshots."""
        n_intervals = output_times.n_snapshots - 1
        return StepRatio.of(n_steps, n_intervals).n_steps(n_intervals)

    def time_step(self, n_steps: int, output_times: OutputTimes) -> float:
        """Return the time step [s] of a run with about `n_steps` steps."""
        return StepRatio.of(n_steps, output_times.n_snapshots - 1).time_step(output_times.interval)

    def _integrate(
        self, n_steps: int, output_times: OutputTimes, driven: Driven, out: Array
    ) -> int:
        matrices, ratio = self.method(n_steps, output_times)
        return _compiled()(
            *driven, *matrices, ratio.n_steps(len(out) - 1),
            ratio.steps_per_snapshot, self._degree, output_times.largest_square,
            np.empty(driven[0].shape[2]), np.empty(8 * out.shape[1] + matrices[2].shape[2]), out,
        )  # fmt: skip

    def tangents(
        self,
        n_steps: int,
        start: Array,
        output_times: OutputTimes,
        changes: Sequence[Change],
        amplitude: Amplitude | None = None,
    ) -> tuple[Array, Array]:
        """Return the run from coordinates (n_modes,) and its derivatives for each parameter.

        The derivatives (n_parameters, n_snapshots, n_modes) are the exact ones of the discrete
        steps. They are NaN or infinite where the run diverges.

        Parameters
        ----------
        changes : derivative of the system with respect to each parameter.
        amplitude : None if it is zero at all times and for all parameters.
        """
        from sphrom.kernels import tangent  # few commands need it

        matrices, ratio = self.method(n_steps, output_times)
        taken = ratio.n_steps(output_times.n_snapshots - 1)
        start_time = output_times.start_time
        time_step = ratio.time_step(output_times.interval)
        coefficients, used, amplitudes = self._driven(start_time, taken, time_step, amplitude)
        by_parameter = np.zeros((len(changes), *coefficients.shape))
        by_amplitude = np.zeros(coefficients.shape)
        powers = np.arange(1, len(by_amplitude), dtype=np.float64)
        by_amplitude[:-1] = powers[:, None, None] * coefficients[1:]
        amplitude_changes = np.zeros((len(changes), amplitudes.size))
        out = np.zeros((1 + len(changes), output_times.n_snapshots, start.size))
        out[0, 0] = start
        times = start_time + 0.5 * time_step * np.arange(amplitudes.size, dtype=np.float64)
        for k, change in enumerate(changes):
            packed, _ = change.polynomial.packed()
            by_parameter[k] = packed[: len(used)]
            out[1 + k, 0] = change.start
            if amplitude is not None and change.amplitude is not None:
                amplitude_changes[k] = change.amplitude(times)
        n_monomials = coefficients.shape[2]
        tangent.integrate(
            coefficients, by_amplitude, by_parameter, used, amplitudes, amplitude_changes,
            *matrices, taken, ratio.steps_per_snapshot, self._degree,
            np.empty(n_monomials), np.empty(n_monomials), np.empty(start.size),
            np.empty((len(out), 8 * start.size + matrices[2].shape[2])), out,
        )  # fmt: skip
        return out[0], out[1:]

    def method(self, n_steps: int, output_times: OutputTimes) -> tuple[Matrices, StepRatio]:
        """Return the matrices of a run's steps, and the ratio of steps to snapshots."""
        ratio = StepRatio.of(n_steps, output_times.n_snapshots - 1)
        return self.linear.steps(output_times.interval, ratio), ratio
