"""The closure of adjoint Petrov-Galerkin on fixed points, as a polynomial (Eq. 3.22).

The reduced rates are Phi^T W (f + tau J r), where f are the rates at all points, r = Pi' f is their
residual after projection, and J the Jacobian of f. With b = (1, a), e_0 the constant part of a
state and e_m the modes, f is the sum of b_k b_l F_kl over k <= l. F_kl is S(e_k, e_l), halved
for k = l; with k = 0 it also contains L e_l, and with k = l = 0 the constant sources. L is the
linear part here, and S(x, y) = B(x, y) + B(y, x) that of products. As J x = L x + S(u, x),

    Phi^T W J r = sum_m sum_{k <= l} b_m b_k b_l Phi^T W (S(e_m, R_kl) + [m = 0] L R_kl)

where R_kl = Pi' F_kl. Symmetrised over its indices this is one tensor of the third degree in b: a
cubic polynomial in a, which needs neither residual nor Jacobian online. It has n^4/6 entries for
n modes and is quadratic in the viscosity. With a body force or driven walls, L and the sources have
a part proportional to the amplitude, and the polynomial contains its first two powers.

A residual is not a combination of modes, so its gradients are sums over points (Eq. 2.11), as for
moving particles.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement, permutations

import numpy as np

from sphrom.arrays import Array
from sphrom.declaration import Tensors
from sphrom.reduction.mode_fields import (
    BLOCK_VALUES,
    ModeFields,
    blocks,
    mode_fields,
    mode_gradients,
    weighted_rows,
)
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.reduced_operators import MemoryOperators
from sphrom.reduction.reduced_rates import Polynomial
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import EVERYWHERE, FixedPoints, Terms

Pairs = list[tuple[int, int]]


@dataclass(frozen=True)
class _States:
    """Some states, with their linear terms and gradients, from which rates are computed."""

    scaled_density: Array
    """(n_points, n_states)."""
    velocity: Array
    """(2, n_points, n_states)."""
    slopes: Array
    """(3, 2, n_points, n_states)."""
    terms: Terms

    def only(self, k: int) -> _States:
        """Return one of the states."""
        one, t = (..., slice(k, k + 1)), self.terms
        slowing = None if t.slowing is None else t.slowing[one]
        terms = Terms(
            t.divergence[one], t.pressure_gradient[one], t.laplacian[one], slowing=slowing
        )
        return _States(self.scaled_density[one], self.velocity[one], self.slopes[one], terms)


class _Rates:
    """The parts of f at one viscosity: sources, L and B."""

    def __init__(self, points: FixedPoints, kinematic_viscosity: float) -> None:
        self.points = points
        self.viscosity = kinematic_viscosity
        drag = points.wall_friction
        self.drag = None if drag is None else kinematic_viscosity * drag
        self.head = None if points.body_force is None else points.head_push(points.body_force)

    @property
    def n_powers(self) -> int:
        """Number of powers of the amplitude in the sources and L, including the zeroth."""
        return 1 + (self.head is not None or self.points.walls_driven)

    def _dragged(self, power: int) -> Array | None:
        """Return the friction of moving walls if it varies with this power of the amplitude."""
        return self.drag if power == int(self.points.walls_driven) else None

    def source(self, power: int) -> Array:
        """Return the sources at rest (3, n_points) [m/s2]."""
        out = np.zeros((3, self.points.n_points))
        if (drag := self._dragged(power)) is not None:
            out[1:] = drag
        if power == 1 and self.head is not None and self.points.body_force is not None:
            out[1:] += self.points.body_force + self.head
        return out

    def linear(self, states: _States, power: int) -> Array:
        """Return L applied to states (3, n_points, n_states) [m/s2]."""
        points, terms, speed = self.points, states.terms, self.points.sound_speed
        share, out = states.scaled_density / speed, np.zeros_like(states.slopes[:, 0])
        if power == 0:
            out[0] = points.diffusion(states.scaled_density) - speed * terms.divergence
            out[0] = self._kept(out[0])
            out[1:] = self.viscosity * terms.laplacian - speed * terms.pressure_gradient
            if terms.slowing is not None:
                out[1:] += terms.slowing
        elif self.head is not None and points.body_force is not None:
            out[1:] = points.head_push(points.body_force[..., None] * share)
            out[1:] -= self.head[..., None] * share
        if (drag := self._dragged(power)) is not None:
            out[1:] -= drag[..., None] * share
        return out

    def products(self, one: _States, others: _States) -> Array:
        """Return S of one state with others (3, n_points, n_states) [m/s2]."""
        return self._products(one, others) + self._products(others, one)

    def _products(self, carrier: _States, carried: _States) -> Array:
        """Return B of a carrier, which advects and is compressed, and of the carried states."""
        (u, v), q, terms = carrier.velocity, carrier.scaled_density, carried.terms
        out = -u * carried.slopes[:, 0] - v * carried.slopes[:, 1]
        out[0] -= self._kept(q * terms.divergence)
        drag = self.viscosity / self.points.sound_speed * terms.laplacian
        out[1:] += q * (terms.pressure_gradient - drag)
        return out

    def _kept(self, rates: Array) -> Array:
        """Return rates (n_points, n_states), less their mean if the fluid's volume is fixed."""
        return rates - rates.mean(axis=0) if self.points.fixed_volume else rates


def project_memory(
    points: FixedPoints,
    basis: TrialBasis,
    splines: ModeSplines | None = None,
    *,
    kinematic_viscosity: float,
) -> Polynomial:
    """Return Phi^T W J r, the term of Eq. 3.22 per unit of memory length.

    Other parameters: see `sphrom.reduction.operator_projection.project_operators`.
    """
    rates = _Rates(points, kinematic_viscosity)
    fields = mode_fields(basis, points)
    states = _all_states(points, fields, splines)
    weights = weighted_rows(basis, fields, EVERYWHERE)
    weights = weights.reshape(len(weights), -1)
    n = fields.n_modes + 1
    pairs = list(combinations_with_replacement(range(n), 2))
    sums = np.zeros((2 * rates.n_powers - 1, n - 1, n, len(pairs)))
    for some in blocks(len(pairs), BLOCK_VALUES // (9 * points.n_points)):
        for power in range(rates.n_powers):
            left = _left_over(rates, states, pairs[some], power, weights, fields)
            q, velocity = np.ascontiguousarray(left[0]), np.ascontiguousarray(left[1:])
            slopes = np.stack([points.gradients(field) for field in (q, *velocity)])
            residuals = _States(q, velocity, slopes, points.terms(q, velocity))
            for m in range(n):
                change = rates.products(states.only(m), residuals)
                sums[power, :, m, some] += _projected(weights, change)
            for other in range(rates.n_powers):
                change = rates.linear(residuals, other)
                sums[power + other, :, 0, some] += _projected(weights, change)
    # Higher powers of the amplitude multiply lower degrees in the coordinates.
    return Polynomial(
        tuple(_tensors(total, pairs)[: 4 - power] for power, total in enumerate(sums))
    )


def _all_states(points: FixedPoints, fields: ModeFields, splines: ModeSplines | None) -> _States:
    """Return the constant part of a state, which may be zero, followed by the modes."""

    def ordered(values: Array) -> Array:
        rest = values[..., fields.n_modes :]
        first = rest if rest.shape[-1] else np.zeros((*values.shape[:-1], 1))
        return np.concatenate((first, values[..., : fields.n_modes]), axis=-1)

    q, velocity = ordered(fields.scaled_density), ordered(fields.velocity)
    slopes = ordered(mode_gradients(points, fields, splines)(slice(0, points.n_points)))
    return _States(q, velocity, slopes, points.terms(q, velocity))


def _left_over(
    rates: _Rates, states: _States, pairs: Pairs, power: int, weights: Array, fields: ModeFields
) -> Array:
    """Return R = Pi' F (3, n_points, n_pairs) of some pairs, in q and the velocity (Alg. 3.5)."""
    out = np.zeros((3, rates.points.n_points, len(pairs)))
    for column, (k, l) in enumerate(pairs):
        first, second = states.only(k), states.only(l)
        if power == 0:
            products = rates.products(first, second)[..., 0]
            out[..., column] += products * (0.5 if k == l else 1.0)
        if k == 0:
            out[..., column] += rates.linear(second, power)[..., 0]
        if l == 0:
            out[..., column] += rates.source(power)
    coordinates = _projected(weights, out)
    modes = slice(fields.n_modes)
    out[0] -= fields.scaled_density[:, modes] @ coordinates
    out[1:] -= fields.velocity[..., modes] @ coordinates
    return out


def _projected(weights: Array, rates: Array) -> Array:
    return np.asarray(weights @ rates.reshape(weights.shape[1], -1))


def _tensors(sums: Array, pairs: Pairs) -> Tensors:
    """Return symmetric tensors by degree, from sums (n_modes, n, n_pairs) over b_m b_k b_l."""
    n = sums.shape[1]
    whole = np.zeros((len(sums), n, n, n))
    for p, (k, l) in enumerate(pairs):
        whole[:, :, k, l] = whole[:, :, l, k] = sums[:, :, p] * (1.0 if k == l else 0.5)
    turned = [whole.transpose(0, *axes) for axes in permutations((1, 2, 3))]
    whole = np.mean(turned, axis=0)
    modes = slice(1, None)
    return (
        whole[:, 0, 0, 0],
        3.0 * whole[:, modes, 0, 0],
        3.0 * whole[:, modes, modes, 0],
        whole[:, modes, modes, modes],
    )


def project_memory_operators(
    points: FixedPoints, basis: TrialBasis, splines: ModeSplines | None, *, largest_viscosity: float
) -> MemoryOperators:
    """Interpolate the operators from three viscosities: zero, half the largest, the largest."""
    nu = largest_viscosity
    low, middle, high = (
        project_memory(points, basis, splines, kinematic_viscosity=share * nu)
        for share in (0.0, 0.5, 1.0)
    )
    slope = low.scaled(-3.0 / nu).plus(middle, 4.0 / nu).plus(high, -1.0 / nu)
    curvature = low.scaled(2.0 / nu**2).plus(middle, -4.0 / nu**2).plus(high, 2.0 / nu**2)
    by_amplitude = zip(low.powers, slope.powers, curvature.powers, strict=True)
    stacked = [tuple(map(np.stack, zip(*powers, strict=True))) for powers in by_amplitude]
    return MemoryOperators(**dict(zip(("steady", "force", "force_squared"), stacked, strict=False)))
