"""The reduced model on moving particles: Alg. 3.4, Galerkin and adjoint Petrov-Galerkin.

The state is a vector: the generalized coordinates (n_modes,), the mean density if it is separate,
then the positions x and y of all particles [m]. Each evaluation computes the modes at the particles
by splines, reconstructs the fields, evaluates the full functional, removes the advection (Eq. 3.4)
and projects. Galerkin projection (Eq. 3.21) uses the rates directly. Adjoint Petrov-Galerkin
(Eq. 3.22, Alg. 3.5; Parish, Wentland and Duraisamy 2020) adds the effect of the residual.

Advection is removed in one of two ways. `paper` subtracts Eq. 3.5-3.6, which advect with u and
leave the shifting terms in. `consistent` subtracts (u + delta u) . grad of the reduced field by the
modes' splines, because points move with u + delta u while coordinates belong to fixed modes.

A separate mean density is subtracted from the snapshots, so no mode contains it. The model carries
it as one more coordinate, whose mode is a constant density.

Fields at particles are (3, n_particles): the state's first field and two components of velocity.
The basis at particles is (n_particles, n_modes, 3).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from sphrom.arrays import Array
from sphrom.errors import UnstableError
from sphrom.kernels import projection
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.trial_basis import InnerProduct
from sphrom.sph.domain import first_of
from sphrom.sph.functional import Functional, Rates
from sphrom.sph.time_loop import Snapshot

JACOBIAN_STEP = 1e-5
"""epsilon of Eq. 3.22: the step of the finite difference over the size of the state, per field."""


def relative_step(state: Array, direction: Array) -> float:
    """Return the largest step that changes no field by more than its own size.

    Density and velocity differ by orders of magnitude: no constant step (Eq. 3.22) suits both.
    """
    norms = [
        [math.sqrt(np.sum(fields[f] ** 2)) for fields in (state, direction)]
        for f in (slice(0, 1), slice(1, 3))
    ]
    return min((size / length for size, length in norms if size > 0.0 < length), default=0.0)


class Projector:
    """The weighted pseudo-inverse of a basis at particles.

    With `separate_mean`, the last vector of the basis is a constant first field without velocity.
    """

    def __init__(self, basis: Array, weights: Array, *, separate_mean: bool = False) -> None:
        self._basis, self._weights, self._separate_mean = basis, weights, separate_mean
        self._n_vectors = basis.shape[1] + separate_mean
        n_chunks = projection.N_CHUNKS
        n = self._n_vectors
        partial = np.empty((n_chunks, n, n))
        scratch = np.empty((n_chunks, n, 3 * projection.BLOCK))
        projection.gram(basis, weights, separate_mean, scratch, partial)
        self._factor = cho_factor(partial.sum(axis=0), lower=True)

    def __call__(self, fields: Array) -> Array:
        """Return the coordinates (n_vectors,) of the best approximation of `fields`."""
        partial = np.empty((projection.N_CHUNKS, self._n_vectors))
        projection.products(self._basis, self._weights, self._separate_mean, fields, partial)
        return np.asarray(cho_solve(self._factor, partial.sum(axis=0)))

    def orthogonal(self, fields: Array) -> Array:
        """Return the residual of the projection, Pi' f (Alg. 3.5)."""
        remainder = np.empty_like(fields)
        projection.leave_out(self._basis, self._separate_mean, self(fields), fields, remainder)
        return remainder


@dataclass(frozen=True)
class ReducedFields:
    """The fields that the generalized coordinates represent at the particles."""

    density_fluctuation: Array
    """(n_particles,) [kg/m3]."""
    velocity: Array
    """(2, n_particles) [m/s]."""
    gradient: Array
    """(n_particles, 3, 2) of the state's first field and the velocity."""


class ParticleModel:
    """A reduced model whose modes are evaluated at moving particles.

    Parameters
    ----------
    modes : splines of 3 n_modes columns: the state's first field and the velocity of mode 1, of
        mode 2, ...
    separate_mean : whether the mean density is a separate variable.
    memory_length : tau of the closure (Eq. 3.22) [s]; None for Galerkin projection.
    """

    def __init__(
        self,
        functional: Functional,
        modes: ModeSplines,
        product: InnerProduct,
        *,
        advection: Literal["consistent", "paper"] = "consistent",
        separate_mean: bool = False,
        memory_length: float | None = None,
    ) -> None:
        self.functional = functional
        self.domain = functional.domain
        self.neighbourhood = functional.neighbourhood
        self.modes = modes
        self._basis = np.empty((0, modes.n_columns))
        self.product = product
        self.n_modes = modes.n_columns // 3
        self.advection = advection
        self.separate_mean = separate_mean
        self.memory_length = memory_length

    @property
    def n_coordinates(self) -> int:
        """Number of unknowns beside positions: coordinates, and the mean density if separate."""
        return self.n_modes + self.separate_mean

    def initial_state(
        self, coordinates: Array, position: Array, mean_density_fluctuation: float = 0.0
    ) -> Array:
        """Return the state with coordinates (n_modes,) and positions (n_particles, 2) [m]."""
        mean = [self._scale * mean_density_fluctuation] if self.separate_mean else []
        return np.concatenate((coordinates, mean, position[:, 0], position[:, 1]))

    def coordinates(self, state: Array) -> Array:
        """Return the generalized coordinates (n_modes,)."""
        return state[: self.n_modes]

    def mean_density_fluctuation(self, state: Array) -> float:
        """Return the separate mean density fluctuation [kg/m3], or zero."""
        return float(state[self.n_modes]) / self._scale if self.separate_mean else 0.0

    def position(self, state: Array) -> Array:
        """Return the positions (2, n_particles) [m]."""
        return state[self.n_coordinates :].reshape(2, -1)

    def fields(self, state: Array) -> ReducedFields:
        """Reconstruct the fields at the particles (Eq. 3.7 and 3.20)."""
        combined = self.modes.combine(np.kron(self.coordinates(state)[:, None], np.eye(3)))
        values, gradient = combined.values_and_gradients(self.position(state).T)
        return ReducedFields(
            density_fluctuation=self.product.density_fluctuation(values[:, 0])
            + self.mean_density_fluctuation(state),
            velocity=np.ascontiguousarray(values[:, 1:].T),
            gradient=gradient,
        )

    def wrapped(self, state: Array) -> Array:
        """Return the state with its particles wrapped into the box; reset the neighbour search."""
        self.neighbourhood.rebuild_at(None)
        position = self.domain.wrap(self.position(state).T)
        mean = self.mean_density_fluctuation(state)
        return self.initial_state(self.coordinates(state), position, mean)

    def snapshot(self, state: Array) -> Snapshot:
        """Reconstruct the fields of a state as a snapshot."""
        fields = self.fields(state)
        return Snapshot(
            self.position(state),
            fields.density_fluctuation,
            fields.velocity,
            self.coordinates(state),
            self.mean_density_fluctuation(state),
        )

    def remedy(self, state: Array, time_step: float) -> str:
        """Return a suggestion for a run that became unstable near a state."""
        return "another number of modes or a smaller time step may help"

    def rates(self, state: Array, time: float = 0.0) -> Array:
        """Return the rates of the state at a time [s] (Eq. 3.21 or 3.22, and 3.23).

        Raises UnstableError if a density is not positive and finite.
        """
        position = self.position(state)
        fields = self.fields(state)
        density = self.functional.fluid.reference_density + fields.density_fluctuation
        # A comparison with NaN is false, so every bad particle is found.
        bad = np.flatnonzero(~((density > 0.0) & (density < np.inf)))
        if bad.size:
            where = first_of(bad, position)
            value = density[bad[0]]
            raise UnstableError(f"{where} has a density of {value:.3g} kg/m3")
        full = self.functional.evaluate(position, fields.density_fluctuation, fields.velocity, time)
        # f-bar (3, N) of Eq. 3.1 in the state's scaling.
        rates = self._without_advection(position, fields, full, time)
        projector = self._projector(position, fields.density_fluctuation)
        if self.memory_length is not None:
            # The effect of the residual, matrix-free (Eq. 3.22, Alg. 3.5).
            change = self._derivative(position, fields, rates, projector.orthogonal(rates), time)
            rates = rates + self.memory_length * change
        carrier = fields.velocity + full.shifting_velocity
        return np.concatenate((projector(rates), carrier.ravel()))

    @property
    def _scale(self) -> float:
        return self.product.density_scale

    def _projector(self, position: Array, density_fluctuation: Array) -> Projector:
        shape = (position.shape[1], 3 * self.n_modes)
        # Kept, because allocating so much memory takes as long as filling it.
        if self._basis.shape != shape:
            self._basis = np.empty(shape)
        self.modes.values(position.T, self._basis)
        basis = self._basis.reshape(-1, self.n_modes, 3)
        weights = self.product.weights(self.functional.volume(density_fluctuation))
        return Projector(basis, weights, separate_mean=self.separate_mean)

    def _without_advection(
        self, position: Array, fields: ReducedFields, full: Rates, time: float
    ) -> Array:
        """Return the rates (3, N), in the state's scaling, without their advective part."""
        rates = np.vstack((self._scale * full.density, full.velocity))
        if self.advection == "paper":
            carried = self.functional.advection(
                position, fields.density_fluctuation, fields.velocity, time
            )
            carried[0] *= self._scale
            return rates - carried
        carrier = fields.velocity + full.shifting_velocity
        projection.take_out_advection(fields.gradient, carrier, rates)
        return rates

    def _derivative(
        self, position: Array, fields: ReducedFields, rates: Array, along: Array, time: float
    ) -> Array:
        """Return the derivative of f-bar along a field, by a finite difference (Alg. 3.5, 3).

        The particles do not move. The gradient is the renormalised one, from values at particles.
        """
        state = np.vstack((self._scale * fields.density_fluctuation, fields.velocity))
        if (step := JACOBIAN_STEP * relative_step(state, along)) == 0.0:
            return np.zeros_like(rates)
        density = fields.density_fluctuation + step * along[0] / self._scale
        velocity = fields.velocity + step * along[1:]
        wanted = along if self.advection == "consistent" else None
        full = self.functional.evaluate(position, density, velocity, time, wanted)
        gradient = fields.gradient
        if full.slopes is not None:
            gradient = gradient + step * full.slopes
        moved = ReducedFields(density, velocity, gradient)
        return (self._without_advection(position, moved, full, time) - rates) / step


def reduced_jacobian(model: ParticleModel, state: Array, time: float = 0.0) -> Array:
    """Return the reduced rates' Jacobian (n_coordinates, n_coordinates) [1/s], by differences.

    The step is 1e-6 of the size of the coordinates, or at rest of that of a flow at U_max.
    """
    n = model.n_coordinates
    base = model.rates(state, time)[:n]
    functional = model.functional
    weights = model.product.weights(functional.volume(model.fields(state).density_fluctuation))
    of_flow = functional.fluid.max_speed * math.sqrt(float(np.sum(weights)))
    change = 1e-6 * (float(np.linalg.norm(state[:n])) or of_flow)
    jacobian = np.empty((n, n))
    for m in range(n):
        moved = state.copy()
        moved[m] += change
        jacobian[:, m] = (model.rates(moved, time)[:n] - base) / change
    return jacobian
