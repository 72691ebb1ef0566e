"""Derivatives of runs for parameters: the tangent of exponential steps, in the same loop.

A system da/dt = f(a) has the tangent ds/dt = J(a) s + df/dp for each parameter p. The steps of
`sphrom.kernels.exponential`, applied to both, give the exact derivative of the discrete run. The
product J(a) s needs no matrix: it is the coefficients times the derivative of the monomials along
s.
"""

from __future__ import annotations

from sphrom.arrays import Array, Indices
from sphrom.kernels.exponential import _add, _ends, _stages
from sphrom.kernels.jit import term
from sphrom.kernels.polynomial import evaluate, fill_monomials


@term
def fill_tangents(
    coordinates: Array, tangent: Array, degree: int, monomials: Array, out: Array
) -> None:
    """Compute the derivatives (n_monomials,) of monomials of coordinates along a tangent."""
    n_modes = coordinates.size
    out[0] = 0.0
    for j in range(n_modes):
        out[1 + j] = tangent[j]
    place = 1 + n_modes
    if degree >= 2:
        for j in range(n_modes):
            factor, change = coordinates[j], tangent[j]
            for k in range(j, n_modes):
                out[place] = change * coordinates[k] + factor * tangent[k]
                place += 1
    if degree >= 3:
        tail, last = 1 + n_modes, place
        for j in range(n_modes):
            factor, change = coordinates[j], tangent[j]
            for k in range(tail, last):
                out[place] = change * monomials[k] + factor * out[k]
                place += 1
            tail += n_modes - j


@term
def integrate(
    coefficients: Array,
    by_amplitude: Array,
    by_parameter: Array,
    used: Indices,
    amplitudes: Array,
    amplitude_changes: Array,
    stages: Array,
    links: Array,
    ends: Array,
    n_steps: int,
    steps_per_snapshot: int,
    degree: int,
    monomials: Array,
    changes: Array,
    rate: Array,
    work: Array,
    out: Array,
) -> None:
    """Advance a system and its tangents from `out[:, 0]`, in steps of `kernels.exponential`.

    Parameters
    ----------
    coefficients, used : of the rest, as in `sphrom.kernels.polynomial`.
    by_amplitude : derivative of the coefficients with respect to the amplitude, same shape.
    by_parameter : (n_parameters, ...) derivatives of the coefficients for each parameter.
    amplitudes : (2 n_steps + 1,), or (3,) of any values without an amplitude.
    amplitude_changes : (n_parameters, same length) derivatives of the amplitudes.
    stages, links, ends : the matrices of steps, as in `sphrom.kernels.exponential`.
    monomials, changes, rate : (n_monomials,), (n_monomials,) and (n_modes,), scratch.
    work : (1 + n_parameters, 8 n_modes + n_states * n_modes), scratch.
    out : (1 + n_parameters, n_snapshots, n_modes): the run, then its derivatives.
    """
    n_rows, n_modes = out.shape[0], out.shape[2]
    n_states = work.shape[1] // n_modes - 8
    for b in range(n_rows):
        for i in range(n_modes):
            work[b, i] = out[b, 0, i]
    snapshot = 1
    for step in range(n_steps):
        first = 2 * step if used.size > 1 else 0
        for stage in range(4):
            at = first + (stage + 1) // 2
            amplitude, place = amplitudes[at], stage * n_modes
            point = work[0, place : place + n_modes]
            fill_monomials(point, degree, monomials)
            for b in range(n_rows):
                found = work[b, 4 * n_modes + place : 5 * n_modes + place]
                if b == 0:
                    evaluate(coefficients, used, amplitude, monomials, found)
                else:
                    along = work[b, place : place + n_modes]
                    fill_tangents(point, along, degree, monomials, changes)
                    evaluate(coefficients, used, amplitude, changes, found)
                    evaluate(by_parameter[b - 1], used, amplitude, monomials, rate)
                    for i in range(n_modes):
                        found[i] += rate[i]
                    if amplitude_changes[b - 1, at] != 0.0:
                        evaluate(by_amplitude, used, amplitude, monomials, rate)
                        for i in range(n_modes):
                            found[i] += amplitude_changes[b - 1, at] * rate[i]
                if stage == 0:
                    _stages(work[b, :n_modes], found, stages, work[b, n_modes : 4 * n_modes])
                elif stage < 3:
                    ahead = work[b, place + n_modes : place + 2 * n_modes]
                    _add(found, links[stage - 1], ahead)
        n_kept = min(n_states, out.shape[1] - snapshot)
        last = (step + 1) % steps_per_snapshot == 0
        for b in range(n_rows):
            rates = work[b, 4 * n_modes : 8 * n_modes].reshape(4, n_modes)
            reached = work[b, 8 * n_modes :]
            _ends(work[b, :n_modes], rates, ends, reached)
            for i in range(n_modes):
                work[b, i] = reached[(n_states - 1) * n_modes + i]
            if last:
                for k in range(n_kept):
                    for i in range(n_modes):
                        out[b, snapshot + k, i] = reached[k * n_modes + i]
        if last:
            snapshot += n_kept
