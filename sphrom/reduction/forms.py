"""The rates at fixed points, defined once: named parts, each a polynomial of the fields.

With rho0/rho expanded, the rates of `sphrom.sph.fixed_points` are quadratic in the state u, which
consists of q and the velocity:

    f(u) = sum_p theta_p (c_p + L_p u + B_p(u, u)).

A part p has a source c, a linear form L and a bilinear form B(carrier, carried), whose first
argument advects and is compressed. The factors theta are those of `sphrom.reduction.affine`. From
these parts follow the projected operators, the columns of the residual and the closure.

The states of a reduced model are sums of b_k e_k with b = (1, a), where e_0 is the constant part of
a state and the others are the modes. A part of f is then the sum of b_k b_l F_kl over the pairs
k <= l. F_kl is S(e_k, e_l) = B(e_k, e_l) + B(e_l, e_k), halved for k = l; with k = 0 it also
contains L e_l, and with k = l = 0 the source. The products of b are the monomials of a.

Forms have a row for the continuity equation (from which the mean may be subtracted) without
advection, one for the advection of q, and one for each component of the velocity. Forms that
concern the velocity only have the latter. A form is (n_rows, n_fields, n) at n points.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, groupby
from typing import Any, ClassVar

import numpy as np

from sphrom.arrays import Array
from sphrom.reduction.mode_fields import Gradients, mode_fields, mode_gradients
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import FixedPoints, Terms


@dataclass(frozen=True, kw_only=True)
class LocalFields(Terms):
    """Some fields at some points, as arguments of forms.

    Points are the last axis here, also of the terms: products of fields are faster then.
    """

    rows: slice
    """The points."""
    all_density: Array
    """q (n_fields, n_points) at all points [m/s]."""
    all_velocity: Array
    """(n_dim, n_fields, n_points) at all points [m/s]."""
    scaled_density: Array
    """q (n_fields, n) [m/s]."""
    velocity: Array
    """(n_dim, n_fields, n) [m/s]."""
    slopes: Array
    """(1 + n_dim, n_dim, n_fields, n), the gradients of q and of the velocity [1/s]."""
    diffusion: Array
    """delta h c0 L q (n_fields, n) [m/s2]."""

    def some(self, first: int, last: int) -> LocalFields:
        """Return some successive fields."""
        arrays: dict[str, Any] = {
            name: values[..., first : last + 1, :]
            for name, values in vars(self).items()
            if isinstance(values, np.ndarray)
        }
        return replace(self, **arrays)


Pairs = list[tuple[int, int]]
"""The indices k <= l of pairs of fields, in the order of the monomials."""


class PointFields:
    """Some fields at all points; `at` computes the arguments of forms in blocks of points.

    Parameters
    ----------
    scaled_density, velocity : q (n_points, n_fields) and (n_dim, n_points, n_fields) [m/s].
    slopes : their gradients.
    """

    def __init__(
        self, points: FixedPoints, scaled_density: Array, velocity: Array, slopes: Gradients
    ) -> None:
        self._points = points
        self._density = scaled_density
        self._velocity = velocity
        self._slopes = slopes
        self._diffusion = points.diffusion(scaled_density)
        self._divergence = points.divergence(velocity)
        self.n_points, self.n_fields = scaled_density.shape

    @classmethod
    def of_states(
        cls, points: FixedPoints, basis: TrialBasis, splines: ModeSplines | None
    ) -> PointFields:
        """Return the constant part of a state, which may be zero, followed by the modes.

        Gradients are those of splines; by default, sums over the points (Eq. 2.11).
        """
        fields = mode_fields(basis, points)
        slopes_of = mode_gradients(points, fields, splines)

        def ordered(values: Array) -> Array:
            modes, rest = np.split(values, [fields.n_modes], axis=-1)
            return np.concatenate((rest.sum(axis=-1, keepdims=True), modes), axis=-1)

        return cls(
            points,
            ordered(fields.scaled_density),
            ordered(fields.velocity),
            lambda rows: ordered(slopes_of(rows)),
        )

    def at(self, rows: slice) -> LocalFields:
        """Return the fields at some points."""
        terms = self._points.terms(self._density, self._velocity, rows, self._divergence)
        arrays: dict[str, Any] = {
            "scaled_density": self._density[rows],
            "velocity": self._velocity[:, rows],
            "slopes": self._slopes(rows),
            "diffusion": self._diffusion[rows],
            **{name: term for name, term in vars(terms).items() if term is not None},
        }
        turned = {name: np.ascontiguousarray(x.swapaxes(-1, -2)) for name, x in arrays.items()}
        return LocalFields(
            rows=rows,
            all_density=self._density.T,
            all_velocity=self._velocity.swapaxes(1, 2),
            **turned,
        )


class Part(ABC):
    """A part of the rates."""

    is_quadratic: ClassVar[bool] = False

    def __init__(self, points: FixedPoints, source: Array | None = None) -> None:
        self.points = points
        self.sound_speed = points.sound_speed
        self.source = source
        """(n_dim, n_points), the rates of the velocity in fluid at rest; None if they are zero."""

    @abstractmethod
    def linear(self, of: LocalFields) -> Array:
        """Return L of fields."""

    def bilinear(self, by: LocalFields, of: LocalFields) -> Array:
        """Return B of carriers and carried fields; one of the two may be a single field.

        Only parts that are quadratic have it.
        """
        raise NotImplementedError

    def push_of_heads(self, accelerations: Array, rows: slice) -> Array:
        """Return K a (n_dim, n_fields, n) at some points, of those at all points."""
        return self.points.head_push(accelerations.swapaxes(1, 2), rows).swapaxes(1, 2)

    def products(self, one: LocalFields, others: LocalFields) -> Array:
        """Return S of one field with others."""
        return self.bilinear(one, others) + self.bilinear(others, one)

    def pairs(self, n_fields: int) -> Pairs:
        """Return the pairs of fields that this part has."""
        pairs = list(combinations_with_replacement(range(n_fields), 2))
        return pairs if self.is_quadratic else pairs[:n_fields]

    def columns(self, fields: LocalFields, pairs: Pairs) -> Array:
        """Return F (n_rows, n_pairs, n) of successive pairs of fields."""
        columns = []
        for k, run in groupby(pairs, key=lambda pair: pair[0]):
            seconds = [l for _, l in run]
            first = fields.some(k, k)
            others = fields.some(seconds[0], seconds[-1])
            rows: Array | float = 0.0
            if self.is_quadratic:
                rows = self.products(first, others)
                if seconds[0] == k:
                    rows[:, 0] *= 0.5
            if k == 0:
                rows = rows + self.linear(others)
                if self.source is not None and seconds[0] == 0:
                    rows[-len(self.source) :, 0] += self.source[:, fields.rows]
            columns.append(np.asarray(rows))
        return np.concatenate(columns, axis=1)


class Sound(Part):
    """The linear share of pressure and divergence alone."""

    def linear(self, of: LocalFields) -> Array:
        """Return -c0 D u and -c0 G q."""
        push = of.pressure_gradient if of.damping is None else of.pressure_gradient - of.damping
        return _rows(-self.sound_speed * of.divergence, -self.sound_speed * push)


class Inertia(Part):
    """Pressure, diffusion, damping, resistance, the terms of a user, and advection."""

    is_quadratic = True

    def linear(self, of: LocalFields) -> Array:
        """Return -c0 D u + delta h c0 L q, and -c0 G (q - alpha h D u) + (1 + K) (A - lambda) u."""
        velocity = -self.sound_speed * of.pressure_gradient
        if (rate := self.points.slowing_rate) is not None:
            velocity -= rate[of.rows] * of.velocity
            velocity -= self.push_of_heads(rate * of.all_velocity, of.rows)
        if (matrix := self.points.linear_term) is not None:
            added = np.einsum("ijn,jkn->ikn", matrix, of.all_velocity)
            velocity += added[..., of.rows] + self.push_of_heads(added, of.rows)
        return _rows(of.diffusion - self.sound_speed * of.divergence, velocity)

    def bilinear(self, by: LocalFields, of: LocalFields) -> Array:
        """Return -q D u - u . grad q, and q G (q - alpha h D u) - u . grad u + (1 + K) B(u, u)."""
        q = by.scaled_density
        compression = -q * of.divergence
        rows = np.empty((2 + len(by.velocity), *compression.shape))
        rows[0] = compression
        rows[1:] = -by.velocity[0] * of.slopes[:, 0]
        for d in range(1, len(by.velocity)):
            rows[1:] -= by.velocity[d] * of.slopes[:, d]
        rows[2:] += q * of.pressure_gradient
        if (tensor := self.points.quadratic_term) is not None:
            pairs = by.all_velocity[:, None] * of.all_velocity
            added = np.einsum("ijkn,jkmn->imn", tensor, pairs)
            rows[2:] += added[..., of.rows] + self.push_of_heads(added, of.rows)
        return rows


class Viscosity(Part):
    """Friction of the fluid, (1 - q/c0) V u."""

    is_quadratic = True

    def linear(self, of: LocalFields) -> Array:
        """Return V u."""
        return of.laplacian

    def bilinear(self, by: LocalFields, of: LocalFields) -> Array:
        """Return -q/c0 V u."""
        return -by.scaled_density / self.sound_speed * of.laplacian


class MovingWalls(Part):
    """Friction of moving walls, (1 - q/c0) w; the source is w."""

    def linear(self, of: LocalFields) -> Array:
        """Return -q/c0 w."""
        assert self.source is not None
        return -self.source[:, None, of.rows] * (of.scaled_density / self.sound_speed)


class BodyForce(Part):
    """A body force b and its head, b + (1 - q/c0) K (1 + q/c0) b."""

    def __init__(self, points: FixedPoints, force: Array) -> None:
        self._force = force
        self._head = points.head_push(force)
        super().__init__(points, force + self._head)

    def linear(self, of: LocalFields) -> Array:
        """Return K (q/c0 b) - q/c0 K b."""
        push = self.push_of_heads(self._force[:, None] * of.all_density, of.rows)
        return (push - self._head[:, None, of.rows] * of.scaled_density) / self.sound_speed


def parts_of(points: FixedPoints) -> dict[str, Part]:
    """Return the parts of the rates by name, such as `walls`, or `walls/lid` for a parameter."""
    parts: dict[str, Part] = {"inertia": Inertia(points), "viscosity": Viscosity(points)}
    if points.wall_friction is not None:
        parts["walls"] = MovingWalls(points, points.wall_friction)
    if points.body_force is not None:
        parts["force"] = BodyForce(points, points.body_force)
    for parameter, drive in points.drives.items():
        if drive.walls is not None:
            friction = points.friction_of(drive.walls.T)
            parts[f"walls/{parameter}"] = MovingWalls(points, friction)
        if drive.force is not None:
            parts[f"force/{parameter}"] = BodyForce(points, drive.force)
    return parts


def _rows(continuity: Array, velocity: Array) -> Array:
    """Return the rows of a form without advection."""
    return np.concatenate((continuity[None], np.zeros_like(continuity)[None], velocity))


def weighted(weights: Array, rows: Array) -> Array:
    """Return sums (n_weights, n_fields) over the points of the rows of a form, or of rates.

    Weights are (n_weights, n_rows, n); of a form with fewer rows, they have the others too.
    """
    used = weights[:, -len(rows) :].swapaxes(0, 1)
    return np.asarray(sum(w @ row.T for w, row in zip(used, rows, strict=True)))


def rates_of(rows: Array, n_dim: int) -> Array:
    """Return the rates (1 + n_dim, ...) of q and the velocity from the rows of a form."""
    first = rows[0] + rows[1] if len(rows) > n_dim else np.zeros_like(rows[0])
    return np.concatenate((first[None], rows[-n_dim:]))
