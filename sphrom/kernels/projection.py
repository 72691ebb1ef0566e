"""Sums of the projection onto modes at particles: normal equations, and residuals.

The modes' values are (n_particles, n_modes, 3): for each mode the first field and two components of
velocity, all values of a particle together, as splines return them. With `separate_mean`, the last
vector has a first field of one and zero velocity. Particles are divided into a fixed number of
chunks, whose sums are added in order, so results do not depend on the number of threads.
"""

from __future__ import annotations

import math

from numba import prange

from sphrom.arrays import Array
from sphrom.kernels.jit import parallel, term

N_CHUNKS = 32
"""Number of parts into which particles are divided."""
BLOCK = 64
"""Number of particles whose values are transposed at once, so that sums run over particles."""


@term
def _dot(left: Array, right: Array) -> float:
    total = 0.0
    for k in range(left.size):
        total += left[k] * right[k]
    return total


@parallel
def gram(modes: Array, weights: Array, separate_mean: bool, scratch: Array, partial: Array) -> None:
    """Sum the weighted products of modes, chunk by chunk, into the lower triangles.

    Parameters
    ----------
    modes, weights : (n_particles, n_modes, 3), (n_particles,).
    scratch : (N_CHUNKS, n_vectors, 3 BLOCK) scratch memory, with the mean's vector last.
    partial : (N_CHUNKS, n_vectors, n_vectors) the result, to be summed over chunks.
    """
    n_particles, n_modes = modes.shape[:2]
    for chunk in prange(N_CHUNKS):
        rows = scratch[chunk]
        rows[:] = 0.0
        partial[chunk] = 0.0
        end = (chunk + 1) * n_particles // N_CHUNKS
        for first in range(chunk * n_particles // N_CHUNKS, end, BLOCK):
            n = min(BLOCK, end - first)
            if n < BLOCK:
                rows[:] = 0.0
            for k in range(n):
                root = math.sqrt(weights[first + k])
                for m in range(n_modes):
                    rows[m, k] = root * modes[first + k, m, 0]
                    rows[m, BLOCK + k] = root * modes[first + k, m, 1]
                    rows[m, 2 * BLOCK + k] = root * modes[first + k, m, 2]
                if separate_mean:
                    rows[n_modes, k] = root
            for a in range(rows.shape[0]):
                for b in range(a + 1):
                    partial[chunk, a, b] += _dot(rows[a], rows[b])


@parallel
def products(
    modes: Array, weights: Array, separate_mean: bool, fields: Array, partial: Array
) -> None:
    """Sum the weighted products of modes with fields (3, n_particles), chunk by chunk.

    Parameters
    ----------
    partial : (N_CHUNKS, n_vectors) the result, to be summed over chunks.
    """
    n_particles, n_modes = modes.shape[:2]
    for chunk in prange(N_CHUNKS):
        sums = partial[chunk]
        sums[:] = 0.0
        for i in range(chunk * n_particles // N_CHUNKS, (chunk + 1) * n_particles // N_CHUNKS):
            a = weights[i] * fields[0, i]
            b = weights[i] * fields[1, i]
            c = weights[i] * fields[2, i]
            for m in range(n_modes):
                sums[m] += a * modes[i, m, 0] + b * modes[i, m, 1] + c * modes[i, m, 2]
            if separate_mean:
                sums[n_modes] += a


@parallel
def leave_out(
    modes: Array, separate_mean: bool, coordinates: Array, fields: Array, remainder: Array
) -> None:
    """Subtract from fields (3, n_particles) the modes times coordinates (n_vectors,)."""
    n_particles, n_modes = modes.shape[:2]
    for i in prange(n_particles):
        a = coordinates[n_modes] if separate_mean else 0.0
        b = c = 0.0
        for m in range(n_modes):
            a += coordinates[m] * modes[i, m, 0]
            b += coordinates[m] * modes[i, m, 1]
            c += coordinates[m] * modes[i, m, 2]
        remainder[0, i] = fields[0, i] - a
        remainder[1, i] = fields[1, i] - b
        remainder[2, i] = fields[2, i] - c


@parallel
def take_out_advection(gradient: Array, carrier: Array, rates: Array) -> None:
    """Subtract the advection of fields from rates (3, n_particles).

    Parameters
    ----------
    gradient : (n_particles, 3, 2) of the fields.
    carrier : (2, n_particles) the carrying velocity [m/s].
    """
    for i in prange(rates.shape[1]):
        for f in range(3):
            rates[f, i] -= carrier[0, i] * gradient[i, f, 0] + carrier[1, i] * gradient[i, f, 1]
