"""Projected operators: the right-hand side of the reference points in generalized coordinates.

Galerkin projection (Eq. 3.21) of the rates of `sphrom.sph.fixed_points`, which are quadratic once
rho0/rho is expanded, gives rates that are quadratic in the generalized coordinates,

    da/dt = sum_k theta_k (c_k + A_k a + H_k(a, a)),

with factors theta_k of the parameters: 1 for the inertia (pressure, diffusion, advection), the
kinematic viscosity nu, nu s for walls that move with s times their given velocity, and the
amplitude beta(t) of the body force. One set of operators serves all parameters. Driven walls move
with the amplitude: their factor is nu s beta(t).

Operators are built for all columns of a basis, what is constant among them, and then folded onto
the modes. Points are visited in blocks, so that beside the basis and its copy as columns only a
third of it, the diffusion's, is held.

States of a basis with a separate mean have no mean density here: no velocity follows from it, and
fixed points keep it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.columns import Columns, column_gradients, columns, weighted_rows
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.polynomial import Polynomial, Tensors
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import EVERYWHERE, FixedPoints, Order, Surroundings, Terms

Array = NDArray[np.float64]

BLOCK_VALUES = 2**21
"""Values of the columns' gradients that are held at once."""


PARTS = {"inertia": 2, "viscosity": 2, "walls": 1, "force": 1}
"""The parts of the operators, and the degrees of their polynomials."""


@dataclass(frozen=True)
class ReducedOperators:
    """Tensors (c, A, H) of degree 0, 1 and 2 by parameter; None where a scene lacks the term."""

    inertia: Tensors
    viscosity: Tensors
    """Per unit of kinematic viscosity."""
    walls: Tensors | None
    """Per unit of kinematic viscosity and of wall speed; of degree 0 and 1."""
    force: Tensors | None
    """Per unit of the body force's amplitude; of degree 0 and 1."""
    acoustic: Array
    """(n_modes, n_modes) [1/s] what pressure and divergence alone are of A."""
    order: Order
    """To which rho0/rho is expanded."""
    walls_driven: bool = False
    """Whether walls move with the amplitude."""

    @property
    def n_modes(self) -> int:
        """Number of generalized coordinates."""
        return len(self.acoustic)

    @property
    def skewness(self) -> float:
        """The largest entry of the acoustic part's symmetric part, over the part's largest.

        Zero but for rounding in the acoustic product: no sound is created by projection.
        """
        largest = float(np.max(np.abs(self.acoustic)))
        symmetric = float(np.max(np.abs(self.acoustic + self.acoustic.T)))
        return symmetric / largest if largest > 0.0 else 0.0

    def at(self, kinematic_viscosity: float, wall_speed: float = 1.0) -> Polynomial:
        """Return the rates at a viscosity [m2/s] and a speed of walls over the given one.

        The amplitude of the polynomial is that of the body force, or of driven walls.
        """
        own = tuple(
            first + kinematic_viscosity * second
            for first, second in zip(self.inertia, self.viscosity, strict=True)
        )
        walls = tuple(kinematic_viscosity * wall_speed * tensor for tensor in self.walls or ())
        driven = self.force or ()
        if self.walls_driven:
            driven = _summed(driven, walls)
        else:
            own = _summed(own, walls)
        return Polynomial((own, driven) if driven else (own,))


def _summed(first: Tensors, second: Tensors) -> Tensors:
    """Add tensors by degree, of which one may have fewer."""
    tensors = zip_longest(first, second, fillvalue=0.0)
    return tuple(np.asarray(one + other) for one, other in tensors)


def project_operators(
    points: FixedPoints,
    basis: TrialBasis,
    splines: ModeSplines | None = None,
    *,
    order: Order = 1,
    advance: Callable[[int], None] = lambda n_points: None,
) -> ReducedOperators:
    """Project the rates of fixed points onto a basis (Eq. 3.21).

    Parameters
    ----------
    splines : of the basis, whose gradients then advect; by default sums over the points do.
    order : to which rho0/rho is expanded.
    advance : called with the number of points that have been done.
    """
    fields = columns(basis, points)
    gradients = column_gradients(points, fields, splines)
    diffusion = points.diffusion(fields.scaled_density)
    sums = _Sums(points, basis, fields, order)
    for rows in blocks(points.n_points, BLOCK_VALUES // (6 * fields.n_columns)):
        sums.add(rows, gradients(rows), diffusion[rows])
        advance(rows.stop - rows.start)
    return sums.folded()


def blocks(n_points: int, size: int) -> Iterator[slice]:
    """Yield blocks of points, none of which is larger than a size, or than one point."""
    for first in range(0, n_points, max(1, size)):
        yield slice(first, min(first + max(1, size), n_points))


class _Sums:
    """The operators of all columns, summed up over blocks of points.

    Rates have four rows a point: of q what is carried, then what continuity adds, of which the mean
    may be taken out, and two of the velocity.
    """

    def __init__(
        self, points: FixedPoints, basis: TrialBasis, fields: Columns, order: Order
    ) -> None:
        m, k = fields.n_modes, fields.n_columns
        self.points, self.basis, self.fields, self.order = points, basis, fields, order
        self.acoustic = np.zeros((m, k))
        self.inertia = np.zeros(m), np.zeros((m, k)), np.zeros((m, k, k))
        self.viscosity = np.zeros(m), np.zeros((m, k)), np.zeros((m, k, k))
        self.walls = np.zeros(m), np.zeros((m, k))
        self.force = np.zeros(m), np.zeros((m, k))
        self._divergence = points.divergence(fields.velocity)
        self._drag = points.wall_friction
        self._mean_weight = np.zeros(m)
        if points.fixed_volume:
            # Taking the mean out of rates is the same as taking it out of what weighs them.
            total = basis.density_modes @ basis.weights
            self._mean_weight = total / (fields.density_ratio * points.n_points)

    def add(self, rows: slice, slopes: Array, diffusion: Array) -> None:
        """Add what a block of points contributes.

        Parameters
        ----------
        slopes : (3, 2, n, n_columns) the columns' gradients there.
        diffusion : (n, n_columns).
        """
        fields, speed = self.fields, self.points.sound_speed
        terms = self.points.terms(fields.scaled_density, fields.velocity, rows, self._divergence)
        weights = self._weights(rows)
        sound = -speed * np.concatenate((terms.divergence[None], terms.pressure_gradient))
        linear = _projected(weights[:, 1:], sound)
        self.inertia[1][...] += linear + weights[:, 1] @ diffusion
        if terms.damping is not None:
            linear += speed * _projected(weights[:, 2:], terms.damping)
        self.acoustic[...] += linear
        self.viscosity[1][...] += _projected(weights[:, 2:], terms.laplacian)
        self._add_products(rows, weights, terms, slopes)
        if self._drag is not None:
            self._add_drag(rows, weights[:, 2:], self._drag[:, rows])
        if self.points.body_force is not None:
            self._add_force(rows, weights[:, 2:], self.points.body_force)

    def _weights(self, rows: slice) -> Array:
        """Return what the rates are weighed with (n_modes, 4, n)."""
        tests = weighted_rows(self.basis, self.fields, rows)
        continuity = tests[:, :1] - self._mean_weight[:, None, None]
        return np.concatenate((tests[:, :1], continuity, tests[:, 1:]), axis=1)

    def _add_products(self, rows: slice, weights: Array, terms: Terms, slopes: Array) -> None:
        """Add the products of each column, as what carries or is compressed, with all columns."""
        for k in range(self.fields.n_columns):
            inertia, viscosity = product_rates(
                self.points, self.fields, k, rows, terms, slopes, self.order
            )
            self.inertia[2][:, k] += _projected(weights, inertia)
            if viscosity is not None:
                self.viscosity[2][:, k] += _projected(weights[:, 2:], viscosity)

    def _add_drag(self, rows: slice, weights: Array, drag: Array) -> None:
        """Add what walls do that move, with the friction `drag` (2, n)."""
        self.walls[0][...] += _projected(weights, drag[..., None])[:, 0]
        if self.order == 1:
            share = self.fields.scaled_density[rows] / self.points.sound_speed
            self.walls[1][...] -= _projected(weights, drag[..., None] * share)

    def _add_force(self, rows: slice, weights: Array, force: Array) -> None:
        """Add what a body force (2, n_points) does."""
        constant, linear = force_rates(self.points, self.fields, force, rows)
        self.force[0][...] += _projected(weights, constant[..., None])[:, 0]
        if self.order == 1:
            self.force[1][...] += _projected(weights, linear)

    def folded(self) -> ReducedOperators:
        """Return the operators of the modes, with what is constant folded in."""
        n_modes = self.fields.n_modes
        return ReducedOperators(
            inertia=folded(self.inertia, n_modes),
            viscosity=folded(self.viscosity, n_modes),
            walls=None if self._drag is None else folded(self.walls, n_modes),
            force=None if self.points.body_force is None else folded(self.force, n_modes),
            acoustic=self.acoustic[:, :n_modes],
            order=self.order,
            walls_driven=self.points.walls_driven,
        )


def product_rates(
    points: FixedPoints,
    fields: Columns,
    k: int,
    rows: slice,
    terms: Terms,
    slopes: Array,
    order: Order,
) -> tuple[Array, Array | None]:
    """Return the products of a column, as what carries or is compressed, with all columns.

    Those of the inertia (4, n, n_columns): of q what is carried and what continuity adds, and of
    the velocity; and of the viscosity (2, n, n_columns), None to zeroth order. `terms` and `slopes`
    are those of the `rows`.
    """
    q, (u, v) = fields.scaled_density[rows, k, None], fields.velocity[:, rows, k, None]
    products = np.empty((4, *terms.divergence.shape))
    products[1] = -q * terms.divergence
    products[[0, 2, 3]] = -u * slopes[:, 0] - v * slopes[:, 1]
    if order == 0:
        return products, None
    products[2:] += q * terms.pressure_gradient
    return products, -q / points.sound_speed * terms.laplacian


def force_rates(
    points: FixedPoints, fields: Columns, force: Array, rows: slice
) -> tuple[Array, Array]:
    """Return what a body force (2, n_points) does to the velocity, per amplitude.

    The constant (2, n), and to first order what is linear in the columns (2, n, n_columns).
    """
    head, density = points.head_push(force, rows), fields.scaled_density
    more = points.head_push(force[..., None] * density, rows) - head[..., None] * density[rows]
    return force[:, rows] + head, more / points.sound_speed


def _projected(weights: Array, rates: Array) -> Array:
    """Sum rates (n_rows, n, n_columns) over points, with weights (n_modes, n_rows, n)."""
    n_modes, n_columns = len(weights), rates.shape[2]
    return np.asarray(weights.reshape(n_modes, -1) @ rates.reshape(-1, n_columns))


def folded(tensors: Tensors, n_modes: int) -> Tensors:
    """Return tensors of columns (n, ...) as those of modes, the column after which stands for one.

    They are symmetric then.
    """
    constant, linear, *quadratic = tensors
    modes, one = slice(n_modes), slice(n_modes, None)
    constant = constant + linear[:, one].sum(axis=1)
    linear = linear[:, modes].copy()
    for product in quadratic:
        constant = constant + product[:, one, one].sum(axis=(1, 2))
        linear += product[:, modes, one].sum(axis=2) + product[:, one, modes].sum(axis=1)
    symmetric = [0.5 * (h + h.swapaxes(1, 2))[:, modes, modes] for h in quadratic]
    return (constant, linear, *symmetric)


class UnprojectedModel:
    """The rates of all points, evaluated for each state: what operators are checked with.

    Parameters are those of `project_operators`; an order of None expands nothing.
    """

    def __init__(
        self,
        points: FixedPoints,
        basis: TrialBasis,
        splines: ModeSplines | None = None,
        *,
        order: Order | None = None,
    ) -> None:
        self.points, self.basis, self.order = points, basis, order
        self._fields = columns(basis, points)
        self._slopes = column_gradients(points, self._fields, splines)(slice(0, points.n_points))

    def fields(self, coordinates: Array) -> tuple[Array, Array]:
        """Return q (n_points,) and the velocity (2, n_points) of coordinates (n_modes,) [m/s]."""
        factors = self._fields.coefficients(coordinates)
        return self._fields.scaled_density @ factors, self._fields.velocity @ factors

    def full_rates(self, coordinates: Array, surroundings: Surroundings) -> Array:
        """Return the rates (3, n_points) [m/s2] of q and of the velocity."""
        slopes = self._slopes @ self._fields.coefficients(coordinates)
        return self.points.rates(*self.fields(coordinates), slopes, surroundings, self.order)

    def __call__(self, coordinates: Array, surroundings: Surroundings) -> Array:
        """Return the rates (n_modes,) of the generalized coordinates."""
        rates = self.full_rates(coordinates, surroundings)
        weights = weighted_rows(self.basis, self._fields, EVERYWHERE)
        return np.einsum("mfn,fn->m", weights, rates)


def expansion_errors(
    points: FixedPoints,
    density_fluctuation: Array,
    velocity: Array,
    surroundings: Surroundings,
    order: Order,
) -> Array:
    """Return the relative L2 error (n_snapshots,) that expanding rho0/rho makes in the rates.

    Snapshots are (n_snapshots, n_points) [kg/m3] and (n_snapshots, n_points, 2) [m/s].
    """
    errors = []
    for fluctuation, flow in zip(density_fluctuation, velocity, strict=True):
        state = (points.density_scale * fluctuation, np.ascontiguousarray(flow.T))
        slopes = np.stack([points.gradients(field) for field in (state[0], *state[1])])
        exact, expanded = (points.rates(*state, slopes, surroundings, o) for o in (None, order))
        size = float(np.linalg.norm(exact))
        errors.append(float(np.linalg.norm(expanded - exact)) / size if size > 0.0 else 0.0)
    return np.array(errors)
