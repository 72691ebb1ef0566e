"""Exponential Runge-Kutta steps of small systems whose rates are polynomials.

The rates are a linear part, which steps integrate exactly, and a rest, which is a polynomial as in
`sphrom.kernels.polynomial`. A step evaluates the rest four times: at its start, twice in its middle
and at its end. The matrices that follow from the linear part are arguments. Each snapshot within a
step costs one product with a matrix; the last of them is the end of the step.
"""

from __future__ import annotations

from sphrom.arrays import Array, Indices
from sphrom.kernels.jit import term
from sphrom.kernels.polynomial import evaluate, fill_monomials


@term
def _stages(state: Array, rate: Array, matrices: Array, out: Array) -> None:
    """Compute the contribution of a step's start to its three other stages (3 n_modes,)."""
    # Inner loops run over the results, which are long and contiguous, so they are vectorised.
    for r in range(out.size):
        out[r] = 0.0
    for i in range(state.size):
        for r in range(out.size):
            out[r] += state[i] * matrices[0, i, r] + rate[i] * matrices[1, i, r]


@term
def _add(rate: Array, matrix: Array, out: Array) -> None:
    """Add the contribution of the rest at one stage to the next stage."""
    for i in range(rate.size):
        for r in range(out.size):
            out[r] += rate[i] * matrix[i, r]


@term
def _ends(state: Array, rates: Array, matrices: Array, out: Array) -> None:
    """Compute the states (n_states * n_modes,) within and at the end of a step."""
    for r in range(out.size):
        out[r] = 0.0
    for i in range(state.size):
        start, end = rates[0, i], rates[3, i]
        middle = 0.5 * (rates[1, i] + rates[2, i])
        for r in range(out.size):
            out[r] += (
                state[i] * matrices[0, i, r]
                + start * matrices[1, i, r]
                + middle * matrices[2, i, r]
                + end * matrices[3, i, r]
            )


@term
def integrate(
    coefficients: Array,
    used: Indices,
    amplitudes: Array,
    stages: Array,
    links: Array,
    ends: Array,
    n_steps: int,
    steps_per_snapshot: int,
    degree: int,
    largest_square: float,
    monomials: Array,
    work: Array,
    out: Array,
) -> int:
    """Advance a system from `out[0]`; return the number of steps before it diverged, or all.

    Either a step spans one or more snapshot intervals, or an interval several steps. The last step
    may end beyond the last snapshot.

    Parameters
    ----------
    coefficients, used : of the rest, as in `sphrom.kernels.polynomial`.
    amplitudes : (2 n_steps + 1,) at the start, the middle and the end of steps; for a system
        without amplitude, (3,) of any values.
    stages : (2, n_modes, 3 n_modes) contribution of the state and the rest at a step's start to the
        other stages.
    links : (2, n_modes, n_modes) contribution of the rest from the second stage to the third, and
        from the third to the fourth.
    ends : (4, n_modes, n_states * n_modes) contribution of the state and of the rest at the start,
        in the middle and at the end of a step to the states within it and at its end.
    largest_square : of the coordinates' norm, beyond which the system has diverged.
    monomials, work : (n_monomials,) and (8 n_modes + n_states * n_modes,), scratch.
    out : (n_snapshots, n_modes); only those before a divergence are written.
    """
    n_modes = out.shape[1]
    points = work[: 4 * n_modes].reshape(4, n_modes)
    rates = work[4 * n_modes : 8 * n_modes].reshape(4, n_modes)
    reached = work[8 * n_modes :]
    n_states = reached.size // n_modes
    for i in range(n_modes):
        points[0, i] = out[0, i]
    snapshot = 1
    for step in range(n_steps):
        first = 2 * step if used.size > 1 else 0
        # The rest is evaluated at one place in the code, because it is inlined there.
        for stage in range(4):
            fill_monomials(points[stage], degree, monomials)
            amplitude = amplitudes[first + (stage + 1) // 2]
            evaluate(coefficients, used, amplitude, monomials, rates[stage])
            if stage == 0:
                _stages(points[0], rates[0], stages, work[n_modes : 4 * n_modes])
            elif stage < 3:
                _add(rates[stage], links[stage - 1], points[stage + 1])
        _ends(points[0], rates, ends, reached)
        n_kept = min(n_states, out.shape[0] - snapshot)
        square = 0.0
        for i in range(n_modes):
            last = reached[(n_kept - 1) * n_modes + i]
            square += last * last
            points[0, i] = reached[(n_states - 1) * n_modes + i]
        # A comparison with NaN is false, so NaN counts as diverged.
        if not square <= largest_square:
            return step
        if (step + 1) % steps_per_snapshot == 0:
            for k in range(n_kept):
                for i in range(n_modes):
                    out[snapshot + k, i] = reached[k * n_modes + i]
            snapshot += n_kept
    return n_steps
