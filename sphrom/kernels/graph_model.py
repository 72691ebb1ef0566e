"""Runge-Kutta steps of reduced models of fluid below y = eta(x, t).

Unknowns are (a, b): those of stream functions and those of the elevation. Integrals over the fluid
are sums over fixed columns, times Gauss points in y/eta that follow the elevation. At a column each
mode is a polynomial of y between knots. The rates of the kinetic energy hold the derivative of the
mass matrix's own sum, and gravity and the elevation share theirs. Without viscosity and force,
energy is therefore constant with any number of columns and points.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.jit import parallel, term

FINISHED, STEEP, ABOVE, DRY, DIVERGED = 0, 1, 2, 3, 4
"""How a run ends."""
LARGEST = 1e100
"""Sum of the coordinates' sizes beyond which, or where it is no number, a run has diverged."""


class Tables(NamedTuple):
    """Modes at the columns of integration."""

    stream: Array
    """(n_columns, n_rows, 3, 5, n_modes) coefficients of psi, psi_x and psi_xx by power of the
    height above the row's lower knot."""
    elevation: Array
    """(n_columns, n_surface) of elevation modes."""
    slope: Array
    """(n_columns, n_surface) [1/m], their derivatives along x."""
    weights: Array
    """(n_columns,) [m]."""
    heights: Array
    """(n_points,) Gauss points of y/eta."""
    height_weights: Array
    """(n_points,)"""
    bottom: float
    row_height: float
    norm: float
    """Integral of the square of an elevation mode [m]."""


class Limits(NamedTuple):
    """The limits at which a run stops."""

    slope: float
    top: float
    """[m] above the bottom."""
    least_depth: float
    """Smallest depth relative to the mean depth."""


@term
def _place(tables: Tables, height: float) -> tuple[int, float]:
    last = tables.stream.shape[1] - 1
    along = height / tables.row_height
    # Heights may be anything once a run diverges, and only some floats have an integer.
    row = int(along) if 0.0 < along < last else (last if along >= last else 0)
    return row, height - row * tables.row_height


@term
def _quartic(c: Array, k: int, t: float) -> float:
    """Return the value of a mode's polynomial."""
    return c[0, k] + t * (c[1, k] + t * (c[2, k] + t * (c[3, k] + t * c[4, k])))


@term
def _quartic_slope(c: Array, k: int, t: float) -> float:
    """Return the derivative of a mode's polynomial."""
    return c[1, k] + t * (2 * c[2, k] + t * (3 * c[3, k] + t * 4 * c[4, k]))


@term
def rates(
    tables: Tables,
    state: Array,
    depth: float,
    gravity: float,
    viscosity: float,
    growth: float,
    most: float,
    force_x: float,
    force_y: float,
    closure: Array,
    mass: Array,
    work: Array,
    out: Array,
) -> None:
    """Compute the rates of a state (n_modes + n_surface,), `mass` and `work` being overwritten.

    Gravity has the factor 1 + growth A^2 for waves of amplitude A, at most that of A^2 = `most`.
    """
    n_modes, n_surface = tables.stream.shape[4], tables.slope.shape[1]
    p_x, p_y, p_xx, p_xy, p_yy = work[0], work[1], work[2], work[3], work[4]
    mass[:] = 0.0
    out[:] = 0.0
    energy = 0.0  # Over the potential energy of a surface mode of unit amplitude.
    for k in range(n_modes):
        energy += state[k] * state[k] / (gravity * tables.norm)
    for s in range(n_surface):
        energy += state[n_modes + s] * state[n_modes + s]
    gravity = gravity * (1.0 + growth * min(energy, most)) - force_y
    for q in range(tables.weights.size):
        height, slope = depth, 0.0
        for s in range(n_surface):
            height += tables.elevation[q, s] * state[n_modes + s]
            slope += tables.slope[q, s] * state[n_modes + s]
        row, t = _place(tables, height)
        c = tables.stream[q, row, 0]
        flow = 0.0
        push = tables.weights[q] * (force_x - gravity * slope)
        for k in range(n_modes):
            value = _quartic(c, k, t)
            flow += value * state[k]
            out[k] += push * value
        for s in range(n_surface):
            out[n_modes + s] += tables.weights[q] * flow * tables.slope[q, s] / tables.norm
    for q in range(tables.weights.size):
        height, rate = depth, 0.0
        for s in range(n_surface):
            height += tables.elevation[q, s] * state[n_modes + s]
            rate += tables.elevation[q, s] * out[n_modes + s]
        for p in range(tables.heights.size):
            y = height * tables.heights[p]
            row, t = _place(tables, y)
            c = tables.stream[q, row]
            u, v, u_x, u_y, v_x = 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(n_modes):
                p_y[k] = _quartic_slope(c[0], k, t)
                p_yy[k] = 2 * c[0, 2, k] + t * (6 * c[0, 3, k] + t * 12 * c[0, 4, k])
                p_x[k] = _quartic(c[1], k, t)
                p_xy[k] = _quartic_slope(c[1], k, t)
                p_xx[k] = _quartic(c[2], k, t)
                u += p_y[k] * state[k]
                v -= p_x[k] * state[k]
                u_x += p_xy[k] * state[k]
                u_y += p_yy[k] * state[k]
                v_x -= p_xx[k] * state[k]
            w = tables.weights[q] * tables.height_weights[p] * height
            stretch = rate / height
            # The factors of a mode's psi_x, psi_y and second derivatives.
            of_y = -0.5 * (u * u_x + v * u_y + stretch * (u + y * u_y))
            of_x = 0.5 * (u * v_x - v * u_x + stretch * (v - y * u_x))
            of_xy = 0.5 * (u * u - v * v + stretch * y * v) - 4 * viscosity * u_x
            of_yy = 0.5 * (u * v - stretch * y * u) - viscosity * (u_y + v_x)
            of_xx = -0.5 * u * v + viscosity * (u_y + v_x)
            for k in range(n_modes):
                first = of_x * p_x[k] + of_y * p_y[k]
                second = of_xx * p_xx[k] + of_xy * p_xy[k] + of_yy * p_yy[k]
                out[k] += w * (first + second)
                for i in range(k + 1):
                    mass[k, i] += w * (p_x[k] * p_x[i] + p_y[k] * p_y[i])
    _solve(mass, out)
    for i in range(out.size):
        for k in range(out.size):
            out[i] += closure[i, k] * state[k]


@term
def _solve(mass: Array, out: Array) -> None:
    """Replace the leading entries of `out` by the solution with a symmetric matrix (its lower)."""
    n = mass.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = mass[i, j]
            for k in range(j):
                total -= mass[i, k] * mass[j, k]
            mass[i, j] = np.sqrt(total) if i == j else total / mass[j, j]
    for i in range(n):
        for k in range(i):
            out[i] -= mass[i, k] * out[k]
        out[i] /= mass[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            out[i] -= mass[k, i] * out[k]
        out[i] /= mass[i, i]


@term
def _ending(tables: Tables, limits: Limits, state: Array, depth: float) -> tuple[int, int]:
    n_modes = tables.stream.shape[4]
    size = 0.0
    for i in range(state.size):
        size += abs(state[i])
    if not size < LARGEST:
        return DIVERGED, 0
    for q in range(tables.weights.size):
        height, slope = depth, 0.0
        for s in range(tables.slope.shape[1]):
            height += tables.elevation[q, s] * state[n_modes + s]
            slope += tables.slope[q, s] * state[n_modes + s]
        if height < limits.least_depth * depth:
            return DRY, q
        if height > limits.top:
            return ABOVE, q
        if abs(slope) > limits.slope:
            return STEEP, q
    return FINISHED, 0


@parallel
def run_all(
    tables: Tables,
    limits: Limits,
    given: Array,
    force: Array,
    closure: Array,
    n_substeps: int,
    time_step: float,
    states: Array,
    endings: Indices,
) -> None:
    """Run models one by one. `states` contains the initial states and gets the later ones.

    Parameters
    ----------
    given : (n_runs, 5) depth [m], gravity [m/s2], kinematic viscosity [m2/s], the growth of gravity
        with the square of the waves' amplitude [1/m2], and the square beyond which it ends [m2].
    force : (n_runs, 2 n_steps + 1, 2) [m/s2] at the steps and between.
    closure : (n_runs, n_modes + n_surface, n_modes + n_surface) [1/s].
    time_step : [s].
    states : (n_runs, n_steps / n_substeps + 1, n_modes + n_surface).
    endings : (n_runs, 3) how a run ended, the number of finished steps, and the column.
    """
    n_modes = tables.stream.shape[4]
    n_snapshots, n_all = states.shape[1:]
    for run in prange(states.shape[0]):
        mass = np.empty((n_modes, n_modes))
        work = np.empty((5, n_modes))
        state = states[run, 0].copy()
        stage = np.empty(n_all)
        rate = np.empty(n_all)
        total = np.empty(n_all)
        depth, gravity, viscosity, growth, most = given[run]
        dt = time_step
        for step in range((n_snapshots - 1) * n_substeps):
            total[:] = 0.0
            rate[:] = 0.0
            for part in range(4):
                ahead = 0.5 * dt if part in (1, 2) else dt * (part == 3)
                at = 2 * step + (part + 1) // 2
                for i in range(n_all):
                    stage[i] = state[i] + ahead * rate[i]
                f_x, f_y = force[run, at]
                # As separate arguments the same numbers would change the last bits of runs.
                given_now = depth, gravity, viscosity, growth, most, f_x, f_y
                rates(tables, stage, *given_now, closure[run], mass, work, rate)
                factor = dt / 3 if part in (1, 2) else dt / 6
                for i in range(n_all):
                    total[i] += factor * rate[i]
            for i in range(n_all):
                state[i] += total[i]
            code, column = _ending(tables, limits, state, depth)
            endings[run, 0], endings[run, 1], endings[run, 2] = code, step + 1, column
            if code != FINISHED:
                break
            if (step + 1) % n_substeps == 0:
                states[run, (step + 1) // n_substeps] = state
