"""Reduced models on the reference points in steps that sound doesn't limit.

Around a flow the rates are stiff through sound, whose frequencies are those of a linear part L:
rates(a) = L a + N(a). Exponential Runge-Kutta steps (Cox and Matthews 2002, Krogstad 2005) carry L
exactly, and are of fourth order in the rest N, which changes as slowly as the flow. Its values in a
step give a parabola in time, which integrated exactly (by the functions phi_1 to phi_3 of L) gives
the state anywhere in the step: also the snapshots, between which sound may turn over many times.

The nearer L comes to the Jacobian along a run the longer steps may be: that at the mean of training
states serves all runs near a training point. Any L gives the same solution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from sphrom.arrays import Array
from sphrom.kernels import exponential as kernels
from sphrom.reduction.polynomial_model import (
    EXPONENTIAL,
    Amplitude,
    Driven,
    OutputTimes,
    PolynomialModel,
)
from sphrom.reduction.reduced_rates import Polynomial

N_INTEGRALS = 3
"""Number of phi functions for a parabola."""


@dataclass(frozen=True)
class StepRatio:
    """How steps and snapshots alternate: one of the two numbers is one."""

    snapshots_per_step: int
    steps_per_snapshot: int

    @classmethod
    def of(cls, n_steps: int, n_intervals: int) -> StepRatio:
        """Return steps of which some intervals take `n_steps`, or a few more."""
        if n_steps <= 1:
            return cls(max(1, n_intervals), 1)
        if n_steps < n_intervals:
            longest = (n_intervals - 1) // (n_steps - 1)
            taken = math.ceil(n_intervals / longest)
            # As many steps may be shorter: the last one then ends nearer to the last snapshot.
            return cls(math.ceil(n_intervals / taken), 1)
        return cls(1, math.ceil(n_steps / max(1, n_intervals)))

    def n_steps(self, n_intervals: int) -> int:
        """Return the steps over some intervals, of which the last may reach beyond them."""
        return math.ceil(n_intervals / self.snapshots_per_step) * self.steps_per_snapshot

    def time_step(self, interval: float) -> float:
        """Return a step [s] from the time between snapshots [s]."""
        return interval * self.snapshots_per_step / self.steps_per_snapshot


def integrals(linear: Array, time_step: float) -> Array:
    """Return t^k phi_k(t L) of a linear part (n_modes, n_modes) at a time t [s], k = 0 to 3.

    They are (4, n_modes, n_modes) [s^k], of which the first is the exponential.
    """
    n_modes = len(linear)
    chain = np.zeros(((N_INTEGRALS + 1) * n_modes,) * 2)
    chain[:n_modes, :n_modes] = time_step * linear
    # Each block row is the derivative of the one before: the exponential holds all integrals.
    chain[:-n_modes, n_modes:] += time_step * np.eye(N_INTEGRALS * n_modes)
    # Runge-Kutta steps do without it, and it takes long to load.
    from scipy.linalg import expm

    rows: Array = expm(chain)[:n_modes].reshape(n_modes, N_INTEGRALS + 1, n_modes)
    return rows.transpose(1, 0, 2)


def after(first: Array, second: Array, time_step: float) -> Array:
    """Return integrals at the sum of two times, of which the second is a time step [s]."""
    both: Array = first[0] @ second
    powers = np.array([time_step**i / math.factorial(i) for i in range(N_INTEGRALS)])
    for j in range(1, N_INTEGRALS + 1):
        both[j:] += powers[: N_INTEGRALS + 1 - j, None, None] * first[j]
    return both


Matrices = tuple[Array, Array, Array]
"""Of steps of one length: stages, links and ends, as `sphrom.kernels.exponential` takes them."""


def _matrices(halves: Callable[[int], Array], time_step: float, n_states: int) -> Matrices:
    """Return the matrices of steps of a length [s] that reach some states, equally far apart.

    `halves` returns integrals at a multiple of half the time between two states.
    """
    reached = [halves(2 * k) for k in range(1, n_states + 1)]
    stages, links = _krogstad(halves(n_states), reached[-1], time_step)
    ends = _parabola(np.stack(reached, axis=1), time_step)
    # Kernels sum up columns: the index of the result comes last.
    n_modes = ends.shape[-1]
    return (
        np.ascontiguousarray(stages.transpose(1, 3, 0, 2)).reshape(2, n_modes, -1),
        np.ascontiguousarray(links.transpose(0, 2, 1)),
        np.ascontiguousarray(ends.transpose(0, 3, 1, 2)).reshape(4, n_modes, -1),
    )


def _parabola(at: Array, step: float) -> Array:
    """Return the weights (4, ...) of the start state and a parabola's values in states in a step.

    Those are reached by integrals (4, ...).
    """
    power, first, second, third = at[0], at[1], at[2] / step, at[3] / step**2
    start = first - 3.0 * second + 4.0 * third
    return np.array([power, start, 4.0 * second - 8.0 * third, 4.0 * third - second])


def _krogstad(half: Array, whole: Array, step: float) -> tuple[Array, Array]:
    """Return the weights of the start in the other stages, and of these stages in one another."""
    to_third, to_fourth = 4.0 * half[2] / step, 2.0 * whole[2] / step
    second, third = [half[0], half[1]], [half[0], half[1] - to_third]
    fourth = [whole[0], whole[1] - to_fourth]
    return np.array([second, third, fourth]), np.array([to_third, to_fourth])


class LinearPart:
    """The linear part of steps (n_modes, n_modes) [1/s], and the matrices that follow from it.

    They are computed once for all systems whose steps carry it.
    """

    def __init__(self, matrix: Array) -> None:
        self.matrix = matrix
        self._integrals: dict[float, list[Array]] = {}
        self._matrices: dict[tuple[float, StepRatio], Matrices] = {}

    def integrals(self, unit: float, multiple: int) -> Array:
        """Return the integrals (4, n_modes, n_modes) at a multiple, from 1, of a time [s].

        Each follows from the one before.
        """
        if unit not in self._integrals:
            self._integrals[unit] = [integrals(self.matrix, unit)]
        known = self._integrals[unit]
        while len(known) < multiple:
            known.append(after(known[-1], known[0], unit))
        return known[multiple - 1]

    def steps(self, interval: float, ratio: StepRatio) -> Matrices:
        """Return the matrices of steps, from the time between snapshots [s]."""
        if (key := (interval, ratio)) not in self._matrices:
            halves = partial(self.integrals, 0.5 * interval / ratio.steps_per_snapshot)
            about = ratio.time_step(interval), ratio.snapshots_per_step
            self._matrices[key] = _matrices(halves, *about)
        return self._matrices[key]


@dataclass(frozen=True)
class Change:
    """What changes with a parameter, per unit of it."""

    polynomial: Polynomial
    """The rates, with the tensors that those of the system have."""
    start: Array
    """(n_modes,)."""
    amplitude: Amplitude | None = None
    """The amplitude; None where it stays."""


class ExponentialModel(PolynomialModel):
    """A polynomial system whose steps carry a linear part exactly.

    Steps are whole numbers of snapshots long, or some make one snapshot; the last may reach beyond
    the last snapshot.
    """

    integrator = EXPONENTIAL

    def __init__(self, polynomial: Polynomial, linear: LinearPart) -> None:
        super().__init__(polynomial)
        self._linear = linear
        self._coefficients[0, :, 1 : 1 + len(linear.matrix)] -= linear.matrix

    def steps_taken(self, n_steps: int, output_times: OutputTimes) -> int:
        """Return the steps that a run asked for `n_steps` takes: a few more, to meet snapshots."""
        n_intervals = output_times.n_snapshots - 1
        return StepRatio.of(n_steps, n_intervals).n_steps(n_intervals)

    def time_step(self, n_steps: int, output_times: OutputTimes) -> float:
        """Return the length [s] of the steps of a run that is asked for some."""
        return StepRatio.of(n_steps, output_times.n_snapshots - 1).time_step(output_times.interval)

    def _integrate(
        self, n_steps: int, output_times: OutputTimes, driven: Driven, out: Array
    ) -> int:
        matrices, ratio = self._method(n_steps, output_times)
        return kernels.integrate(
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
        """Return the run from coordinates (n_modes,), and its derivatives, per unit of a parameter.

        These (n_parameters, n_snapshots, n_modes) are the exact derivatives of the steps that the
        run takes, and NaN or infinite where it diverges.

        Parameters
        ----------
        changes : what changes with each parameter.
        amplitude : None where it is zero throughout, whatever the parameters are.
        """
        from sphrom.kernels import tangent  # few commands need it

        matrices, ratio = self._method(n_steps, output_times)
        taken = ratio.n_steps(output_times.n_snapshots - 1)
        start_time, time_step = output_times.start_time, ratio.time_step(output_times.interval)
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
            found, _ = change.polynomial.packed()
            by_parameter[k] = found[: len(used)]
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

    def _method(self, n_steps: int, output_times: OutputTimes) -> tuple[Matrices, StepRatio]:
        """Return the matrices of a run's steps, and how long steps are."""
        ratio = StepRatio.of(n_steps, output_times.n_snapshots - 1)
        return self._linear.steps(output_times.interval, ratio), ratio
