"""Runge-Kutta steps of small systems whose rates are polynomials (Eq. 2.18).

The rates are a matrix of coefficients times the vector of all monomials of the coordinates, up to a
degree. Monomials are ordered by degree, then by their nondecreasing indices: 1, a_0, a_1, ...,
a_0 a_0, a_0 a_1, ..., a_1 a_1, .... Monomials of one degree whose first index is at least j are
therefore the last ones, and the next degree is each coordinate times a tail of this one.

Coefficients may depend on time through the powers of an amplitude. There is one matrix per power,
of which only the leading columns are used.
"""

from __future__ import annotations

from sphrom.arrays import Array, Indices
from sphrom.kernels.jit import term


@term
def fill_monomials(coordinates: Array, degree: int, out: Array) -> None:
    """Compute all monomials (n_monomials,) of coordinates (n_modes,) up to a degree of 1 to 3."""
    n_modes = coordinates.size
    out[0] = 1.0
    for j in range(n_modes):
        out[1 + j] = coordinates[j]
    place = 1 + n_modes
    if degree >= 2:
        for j in range(n_modes):
            factor = coordinates[j]
            for k in range(j, n_modes):
                out[place] = factor * coordinates[k]
                place += 1
    if degree >= 3:
        tail, last = 1 + n_modes, place
        for j in range(n_modes):
            factor = coordinates[j]
            for k in range(tail, last):
                out[place] = factor * out[k]
                place += 1
            tail += n_modes - j


@term
def evaluate(
    coefficients: Array, used: Indices, amplitude: float, monomials: Array, out: Array
) -> None:
    """Compute the rates (n_modes,) [1/s] from monomials.

    Parameters
    ----------
    coefficients : (n_powers, n_modes, n_monomials) by power of the amplitude.
    used : (n_powers,) number of columns that are used.
    """
    # Entries are indexed rather than sliced into rows: for small systems views cost more than sums.
    # Four rows share the loaded monomials, because larger systems are limited by memory access.
    n_together = 4 * (out.size // 4)
    for i in range(0, n_together, 4):
        factor = 1.0
        for p in range(used.size):
            first, second, third, fourth = 0.0, 0.0, 0.0, 0.0
            for k in range(used[p]):
                monomial = monomials[k]
                first += coefficients[p, i, k] * monomial
                second += coefficients[p, i + 1, k] * monomial
                third += coefficients[p, i + 2, k] * monomial
                fourth += coefficients[p, i + 3, k] * monomial
            if p == 0:
                out[i], out[i + 1], out[i + 2], out[i + 3] = first, second, third, fourth
            else:
                out[i] += factor * first
                out[i + 1] += factor * second
                out[i + 2] += factor * third
                out[i + 3] += factor * fourth
            factor *= amplitude
    for i in range(n_together, out.size):
        total = 0.0
        factor = 1.0
        for p in range(used.size):
            part = 0.0
            for k in range(used[p]):
                part += coefficients[p, i, k] * monomials[k]
            total += factor * part
            factor *= amplitude
        out[i] = total


@term
def _between(
    share: float,
    time_step: float,
    state: Array,
    slope: Array,
    ahead: Array,
    rate: Array,
    snapshot: int,
    out: Array,
) -> None:
    """Compute a snapshot within a step, by the cubic of states and slopes at its ends."""
    rest = 1.0 - share
    end = share * share * (3.0 - 2.0 * share)
    along, back = time_step * share * rest * rest, time_step * share * share * rest
    for i in range(state.size):
        chord = state[i] + end * (ahead[i] - state[i])
        out[snapshot, i] = chord + along * slope[i] - back * rate[i]


@term
def integrate(
    coefficients: Array,
    used: Indices,
    amplitudes: Array,
    time_step: float,
    n_steps: int,
    degree: int,
    largest_square: float,
    monomials: Array,
    work: Array,
    out: Array,
) -> int:
    """Advance a system from `out[0]`; return the number of steps before it diverged, or all.

    Snapshots are equally spaced over the run. At the end of a step they are its state; within a
    step they are interpolated, with fourth order like the steps.

    Parameters
    ----------
    amplitudes : (2 n_steps + 1,) at the start, the middle and the end of steps; for a system
        without amplitude, (3,) of any values.
    n_steps : number of steps of the whole run.
    largest_square : of the coordinates' norm, beyond which the system has diverged.
    monomials, work : (n_monomials,) and (5, n_modes), scratch.
    out : (n_snapshots, n_modes); only those before a divergence are written.
    """
    state, slope, stage = work[0], work[1], work[2]
    ahead, rate = work[3], work[4]
    for i in range(state.size):
        stage[i] = ahead[i] = out[0, i]
    n_intervals = out.shape[0] - 1
    snapshot = 1
    # Rates are evaluated at one place in the code, because they are inlined there and calls are
    # slow for small systems. The slope at the end of a step is the first one of the next step.
    for step in range(n_steps + 1):
        first = 2 * step if used.size > 1 else 0
        for substep in range(4):
            fill_monomials(stage, degree, monomials)
            evaluate(coefficients, used, amplitudes[first + (substep + 1) // 2], monomials, rate)
            if substep == 0:
                # Integers determine exactly which snapshots the last step passed.
                passed = snapshot * n_steps - (step - 1) * n_intervals
                while snapshot <= n_intervals and passed < n_intervals:
                    share = passed / n_intervals
                    _between(share, time_step, state, slope, ahead, rate, snapshot, out)
                    snapshot += 1
                    passed += n_steps
                # Snapshots at the end of the step are its state.
                if step > 0 and passed == n_intervals:
                    for i in range(state.size):
                        out[snapshot, i] = ahead[i]
                    snapshot += 1
                if step == n_steps:
                    return n_steps
                for i in range(state.size):
                    state[i] = ahead[i]
                    slope[i] = rate[i]
            weight = time_step / 6.0 if substep == 0 or substep == 3 else time_step / 3.0
            reach = time_step if substep == 2 else 0.5 * time_step
            for i in range(state.size):
                ahead[i] += weight * rate[i]
                stage[i] = state[i] + reach * rate[i]
        square = 0.0
        for i in range(state.size):
            square += ahead[i] * ahead[i]
            stage[i] = ahead[i]
        # A comparison with NaN is false, so NaN counts as diverged.
        if not square <= largest_square:
            return step
    return n_steps
