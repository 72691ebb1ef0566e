"""Runge-Kutta steps of small systems whose rates are polynomials (Eq. 2.18).

The rates are a matrix of coefficients times the vector of all monomials of the coordinates, up to a
degree. Monomials are ordered by degree, then by their indices, which never fall: 1, a_0, a_1, ...,
a_0 a_0, a_0 a_1, ..., a_1 a_1, .... Those of one degree whose first index is at least j are
therefore the last ones, and the next degree is each coordinate times a tail of this one.

Coefficients may depend on time through the powers of an amplitude: one matrix a power, of which
only the leading columns are used.
"""

from __future__ import annotations

import numpy as np
from numba import prange
from numpy.typing import NDArray

from sphrom.kernels.jit import sweep, term

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


@term
def fill_monomials(coordinates: Array, degree: int, out: Array) -> None:
    """Compute all monomials (n_monomials,) of coordinates (n_modes,) up to a degree of 1 to 3."""
    n_modes = coordinates.size
    out[0] = 1.0
    for j in range(n_modes):
        out[1 + j] = coordinates[j]
    first, last = 1, 1 + n_modes
    for d in range(2, degree + 1):
        tail, place = first, last
        for j in range(n_modes):
            factor = coordinates[j]
            for k in range(tail, last):
                out[place + k - tail] = factor * out[k]
            place += last - tail
            tail += 1 if d == 2 else n_modes - j
        first, last = last, place


@term
def evaluate(
    coefficients: Array, used: Indices, amplitude: float, monomials: Array, out: Array
) -> None:
    """Compute the rates (n_modes,) [1/s] from monomials.

    Parameters
    ----------
    coefficients : (n_powers, n_modes, n_monomials) by power of the amplitude.
    used : (n_powers,) how many of the columns count.
    """
    for i in range(out.size):
        total = 0.0
        factor = 1.0
        for p in range(used.size):
            row = coefficients[p, i, : used[p]]
            part = 0.0
            for k in range(row.size):
                part += row[k] * monomials[k]
            total += factor * part
            factor *= amplitude
        out[i] = total


@term
def _step(
    coefficients: Array, used: Indices, amplitudes: Array, time_step: float, degree: int,
    monomials: Array, state: Array, stage: Array, slope: Array, total: Array,
) -> None:
    """Advance a state (n_modes,) by one step, in place; amplitudes are those of the substeps."""
    for i in range(state.size):
        stage[i] = state[i]
        total[i] = state[i]
    for s in range(4):
        fill_monomials(stage, degree, monomials)
        evaluate(coefficients, used, amplitudes[(s + 1) // 2], monomials, slope)
        weight = time_step / 6.0 if s == 0 or s == 3 else time_step / 3.0
        ahead = time_step if s == 2 else 0.5 * time_step
        for i in range(state.size):
            total[i] += weight * slope[i]
            stage[i] = state[i] + ahead * slope[i]
    for i in range(state.size):
        state[i] = total[i]


@term
def integrate(
    coefficients: Array, used: Indices, amplitudes: Array, time_step: float, every: int,
    degree: int, largest_square: float, monomials: Array, work: Array, out: Array,
) -> int:
    """Advance a system from `out[0]`; return the steps done before it diverged, or all of them.

    Parameters
    ----------
    amplitudes : (2 n_steps + 1,) at the start, the middle and the end of steps; of a system without
        amplitude, (3,) of any values.
    every : steps from one snapshot to the next.
    largest_square : of the coordinates' norm, beyond which the system is called divergent.
    monomials, work : (n_monomials,) and (4, n_modes), scratch.
    out : (n_snapshots, n_modes), of which those before the divergence are written.
    """
    state = work[0]
    for i in range(state.size):
        state[i] = out[0, i]
    n_steps = (out.shape[0] - 1) * every
    for step in range(n_steps):
        first = 2 * step if used.size > 1 else 0
        _step(
            coefficients, used, amplitudes[first : first + 3], time_step, degree, monomials,
            state, work[1], work[2], work[3],
        )
        square = 0.0
        for i in range(state.size):
            square += state[i] * state[i]
        # A comparison with NaN is false: what is no number fails it.
        if not square <= largest_square:
            return step
        if (step + 1) % every == 0:
            snapshot = (step + 1) // every
            for i in range(state.size):
                out[snapshot, i] = state[i]
    return n_steps


@sweep
def integrate_batch(
    coefficients: Array, used: Indices, amplitudes: Array, time_steps: Array, every: Indices,
    degree: int, largest_square: float, monomials: Array, work: Array, out: Array, steps: Indices,
) -> None:
    """Do `integrate` for many systems, shared out over threads; a leading axis is the system's.

    Parameters
    ----------
    steps : (n_systems,) what `integrate` returns.
    """
    for b in prange(steps.size):
        steps[b] = integrate(
            coefficients[b], used, amplitudes[b], time_steps[b], every[b], degree, largest_square,
            monomials[b], work[b], out[b],
        )
