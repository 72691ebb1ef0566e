"""Reduced rates from a few sampled points, where they need not be polynomial.

Around every sample all that is linear in the coordinates is a small matrix, neighbours included, so
that a state's rates there cost what the samples are and not what the points are. Fields are fitted
to them by gappy least squares (`sphrom.reduction.sampling`). Either all of the rates are sampled,
or only what projected operators leave out of them,

    rho0/rho (P + K b) - [the same with rho0/rho expanded],

with P + K b the push of pressure, friction and walls (see `sphrom.sph.fixed_points`). The first are
fitted by the modes, and what is no mode's in them is taken for some: nothing keeps sound from
growing then. The second has modes of its own, from training states, and is as stable and exact as
the operators are, but for the error of a small remainder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.columns import Columns, column_gradients, columns
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.polynomial_model import Runs, Schedule
from sphrom.reduction.sampling import gappy_projection, weighted_modes
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import FixedPoints, Order, Surroundings
from sphrom.sph.runge_kutta import runge_kutta_step

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Rates = Callable[[Array, Surroundings], Array]
"""From coordinates (n_modes,) and what surrounds the fluid, their rates (n_modes,)."""

REMAINDER_TOLERANCE = 1e-4
"""Singular values of remainders, over the largest, below which they have no mode."""


class _Push:
    """What accelerates the fluid at the samples, as matrices of the columns."""

    def __init__(self, points: FixedPoints, fields: Columns, samples: Indices) -> None:
        terms = points.terms(fields.scaled_density, fields.velocity, samples)
        drag, force = points.wall_friction, points.body_force
        self._wall_speed = points.wall_speed
        none = np.zeros((2, len(samples)))
        self.divergence = terms.divergence
        self._share = fields.scaled_density[samples] / points.sound_speed
        self._pressure = -points.sound_speed * terms.pressure_gradient
        self._laplacian = terms.laplacian
        self._drag = none if drag is None else drag[:, samples]
        self._force = none if force is None else force[:, samples]
        self._head, self._more = none, np.zeros_like(terms.laplacian)
        if force is not None:
            self._head = points.head_push(force, samples)
            density = fields.scaled_density / points.sound_speed
            self._more = points.head_push(force[..., None] * density, samples)

    def acceleration(self, factors: Array, around: Surroundings, order: Order | None) -> Array:
        """Return the acceleration (2, n_samples) [m/s2] but for what is carried.

        Parameters
        ----------
        factors : (n_columns,) what columns are multiplied with.
        order : of the expansion of rho0/rho, None for none.
        """
        nu, beta = around.kinematic_viscosity, around.amplitude
        push = self._pressure @ factors + nu * (self._laplacian @ factors)
        push += nu * self._wall_speed(around) * self._drag + beta * self._head
        share, more = self._share @ factors, beta * (self._more @ factors)
        if order is None:
            return (push + more) / (1.0 + share) + beta * self._force
        if order == 0:
            return push + beta * self._force
        return push * (1.0 - share) + more + beta * self._force


class SampledModel:
    """All rates, from samples alone, with nothing expanded.

    Parameters
    ----------
    splines : of the basis, whose gradients then advect; by default sums over the points do.
    samples : (n_samples,) the points to sample.

    Raises
    ------
    ValueError
        When the samples don't tell the modes apart.
    """

    def __init__(
        self,
        points: FixedPoints,
        basis: TrialBasis,
        splines: ModeSplines | None,
        samples: Indices,
    ) -> None:
        fields = columns(basis, points)
        self._fields, self._sound_speed = fields, points.sound_speed
        self._push = _Push(points, fields, samples)
        diffusion = points.diffusion(fields.scaled_density)
        self._state = np.stack((fields.scaled_density[samples], *fields.velocity[:, samples]))
        self._slopes = column_gradients(points, fields, splines)(samples)
        self._diffusion = diffusion[samples]
        self._mean = _MeanContinuity(points, fields, diffusion) if points.fixed_volume else None
        self._fit = _fit(basis, fields, samples)

    def __call__(self, coordinates: Array, surroundings: Surroundings) -> Array:
        """Return the rates (n_modes,) of the generalized coordinates."""
        factors = self._fields.coefficients(coordinates)
        q, u, v = self._state @ factors
        slopes = self._slopes @ factors
        rates = -u * slopes[:, 0] - v * slopes[:, 1]
        rates[0] += self._diffusion @ factors
        rates[0] -= (self._sound_speed + q) * (self._push.divergence @ factors)
        if self._mean is not None:
            rates[0] -= self._mean(factors)
        rates[1:] += self._push.acceleration(factors, surroundings, None)
        return self._fit @ rates.ravel()


class Remainder:
    """What the expansion of rho0/rho leaves out of the acceleration at some points.

    Parameters
    ----------
    order : of the expansion that is completed.
    samples : (n_samples,) those points.
    """

    def __init__(
        self, points: FixedPoints, basis: TrialBasis, order: Order, samples: Indices
    ) -> None:
        self._fields, self._order = columns(basis, points), order
        self._push = _Push(points, self._fields, samples)

    def __call__(self, coordinates: Array, surroundings: Surroundings) -> Array:
        """Return it (2, n_samples) [m/s2] of coordinates (n_modes,)."""
        factors = self._fields.coefficients(coordinates)
        exact, expanded = (
            self._push.acceleration(factors, surroundings, order) for order in (None, self._order)
        )
        return exact - expanded


def remainder_modes(
    points: FixedPoints,
    basis: TrialBasis,
    order: Order,
    states: Array,
    surroundings: Sequence[Surroundings],
    n_modes: int,
) -> Array:
    """Return weighted modes (n_points, 2, n_found) of remainders, at most `n_modes`.

    Parameters
    ----------
    states : (n_states, n_modes) training states.
    surroundings : in each of which each state's remainder is taken.
    """
    remainder = Remainder(points, basis, order, np.arange(points.n_points))
    found = [remainder(state, around).T for state in states for around in surroundings]
    weighted = np.stack(found, axis=-1) * np.sqrt(basis.weights)[:, None, None]
    left, values, _ = np.linalg.svd(weighted.reshape(-1, len(found)), full_matrices=False)
    n_found = max(1, min(n_modes, int(np.sum(values > REMAINDER_TOLERANCE * values[0]))))
    return left[:, :n_found].reshape(-1, 2, n_found)


class SampledRemainder:
    """What the expansion of rho0/rho leaves out of the rates, from samples.

    Parameters
    ----------
    modes : (n_points, 2, n_found) of remainders, weighted.

    The others are those of `Remainder`, what is raised that of `SampledModel`.
    """

    def __init__(
        self, points: FixedPoints, basis: TrialBasis, order: Order, modes: Array, samples: Indices
    ) -> None:
        self._remainder = Remainder(points, basis, order, samples)
        overlap = np.einsum("ndm,ndk->mk", weighted_modes(basis)[:, 1:], modes)
        fit = gappy_projection(modes[samples]) * np.sqrt(basis.weights[samples])[:, None]
        self._fit = overlap @ fit.transpose(0, 2, 1).reshape(len(fit), -1)

    def __call__(self, coordinates: Array, surroundings: Surroundings) -> Array:
        """Return what is left out of the rates (n_modes,)."""
        return np.asarray(self._fit @ self._remainder(coordinates, surroundings).ravel())


class _MeanContinuity:
    """The mean over all points of what continuity adds, which is quadratic and needs no samples."""

    def __init__(self, points: FixedPoints, fields: Columns, diffusion: Array) -> None:
        density, n_points = fields.scaled_density, points.n_points
        divergence = points.divergence(fields.velocity)
        self._linear = diffusion.mean(axis=0) - points.sound_speed * divergence.mean(axis=0)
        self._quadratic = -(density.T @ divergence) / n_points

    def __call__(self, factors: Array) -> float:
        return float(factors @ (self._linear + self._quadratic @ factors))


def _fit(basis: TrialBasis, fields: Columns, samples: Indices) -> Array:
    """Return what gives rates of coordinates from those of q, u and v (n_modes, 3 n_samples)."""
    fit = (
        gappy_projection(weighted_modes(basis)[samples]) * np.sqrt(basis.weights[samples])[:, None]
    )
    fit[..., 0] /= fields.density_ratio
    return np.ascontiguousarray(fit.transpose(0, 2, 1).reshape(len(fit), -1))


@dataclass(frozen=True)
class Drive:
    """What surrounds the fluid over time."""

    kinematic_viscosity: float
    """[m2/s]."""
    amplitude: Callable[[float], float] = lambda time: 0.0
    """Of the body force, or of driven walls, at a time [s]."""

    def at(self, time: float) -> Surroundings:
        """Return what surrounds the fluid at a time [s]."""
        return Surroundings(self.kinematic_viscosity, amplitude=self.amplitude(time))


def integrate(
    rates: Rates,
    start: Array,
    schedule: Schedule,
    steps_per_snapshot: int,
    drive: Drive,
    advance: Callable[[int], None] = lambda n_snapshots: None,
) -> Runs:
    """Advance coordinates (n_modes,) by Runge-Kutta steps (Eq. 2.18), for any rates.

    `advance` is called with one after each snapshot.
    """
    time_step = schedule.interval / steps_per_snapshot
    out = np.full((1, schedule.n_snapshots, len(start)), np.nan)
    out[0, 0] = state = start
    diverged, step = np.nan, 0

    def functional(coordinates: Array, time: float) -> Array:
        return rates(coordinates, drive.at(time))

    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for snapshot in range(1, schedule.n_snapshots):
            for _ in range(steps_per_snapshot):
                time = schedule.start_time + step * time_step
                state = runge_kutta_step(functional, state, time, time_step)
                if not np.linalg.norm(state) <= schedule.largest_norm:
                    return Runs(schedule.time, out, np.array([time_step]), np.array([time]))
                step += 1
            out[0, snapshot] = state
            advance(1)
    return Runs(schedule.time, out, np.array([time_step]), np.array([diverged]))
