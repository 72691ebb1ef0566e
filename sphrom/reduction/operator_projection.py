"""The right-hand side of the reference points, and forces on walls, in generalized coordinates.

The rates of `sphrom.sph.fixed_points` are quadratic once rho0/rho is expanded, so that their
Galerkin projection (Eq. 3.21) is quadratic in the generalized coordinates: see
`sphrom.reduction.reduced_operators`.

Operators are computed for the modes and the constant part of a state alike, and the latter is then
folded into the former. Points are visited in blocks: memory holds the basis, its copy as fields,
and the diffusion of q, a third of it.

States of a basis with a separate mean have no mean density here: no velocity follows from it, and
fixed points keep it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

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
from sphrom.reduction.reduced_measures import DriveForce, ReducedForce
from sphrom.reduction.reduced_operators import DriveRates, ReducedOperators
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import FixedPoints, Terms
from sphrom.sph.fluid import NONE
from sphrom.sph.wall_forces import TORQUE, MeasuredWall

Array = NDArray[np.float64]


def project_operators(
    points: FixedPoints,
    basis: TrialBasis,
    splines: ModeSplines | None = None,
    *,
    advance: Callable[[int], None] = lambda n_points: None,
) -> ReducedOperators:
    """Project the rates of fixed points onto a basis (Eq. 3.21).

    Parameters
    ----------
    splines : of the basis, whose gradients then advect; by default sums over the points do.
    advance : called with the number of points that have been done.
    """
    fields = mode_fields(basis, points)
    gradients = mode_gradients(points, fields, splines)
    diffusion = points.diffusion(fields.scaled_density)
    sums = _Sums(points, basis, fields)
    for rows in blocks(points.n_points, BLOCK_VALUES // (6 * fields.n_fields)):
        sums.add(rows, gradients(rows), diffusion[rows])
        advance(rows.stop - rows.start)
    return sums.folded()


class _Sums:
    """Sums of the operators of all fields over blocks of points.

    A point has four rates: the advection of q, then the rest of continuity, whose mean may be taken
    out, and two of the velocity.
    """

    def __init__(self, points: FixedPoints, basis: TrialBasis, fields: ModeFields) -> None:
        m, k = fields.n_modes, fields.n_fields
        self.points, self.basis, self.fields = points, basis, fields
        self.acoustic = np.zeros((m, k))
        self.inertia = np.zeros(m), np.zeros((m, k)), np.zeros((m, k, k))
        self.viscosity = np.zeros(m), np.zeros((m, k)), np.zeros((m, k, k))
        self._drags, self._forces = drags_and_forces(points)
        self.driven = {
            part: (np.zeros(m), np.zeros((m, k))) for part in (*self._drags, *self._forces)
        }
        self._divergence = points.divergence(fields.velocity)
        self._mean_weight = np.zeros(m)
        if points.fixed_volume:
            # Taking the mean out of rates is the same as taking it out of what weighs them.
            total = basis.density_modes @ basis.weights
            self._mean_weight = total / (fields.density_ratio * points.n_points)

    def add(self, rows: slice, slopes: Array, diffusion: Array) -> None:
        """Add the contribution of a block of points.

        Parameters
        ----------
        slopes : (3, 2, n, n_fields) the gradients of the fields there.
        diffusion : (n, n_fields).
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
        driven = {part: drag_rates(self.points, fields, d, rows) for part, d in self._drags.items()}
        for part, force in self._forces.items():
            driven[part] = force_rates(self.points, fields, force, rows)
        for part, (constant, lighter) in driven.items():
            into = self.driven[part]
            into[0][...] += _projected(weights[:, 2:], constant[..., None])[:, 0]
            into[1][...] += _projected(weights[:, 2:], lighter)

    def _weights(self, rows: slice) -> Array:
        """Return the weights of the rates (n_modes, 4, n)."""
        tests = weighted_rows(self.basis, self.fields, rows)
        continuity = tests[:, :1] - self._mean_weight[:, None, None]
        return np.concatenate((tests[:, :1], continuity, tests[:, 1:]), axis=1)

    def _add_products(self, rows: slice, weights: Array, terms: Terms, slopes: Array) -> None:
        """Add the products of each field, as carrier or compressed density, with all fields."""
        for k in range(self.fields.n_fields):
            inertia, viscosity = product_rates(self.points, self.fields, k, rows, terms, slopes)
            self.inertia[2][:, k] += _projected(weights, inertia)
            self.viscosity[2][:, k] += _projected(weights[:, 2:], viscosity)

    def folded(self) -> ReducedOperators:
        """Return the operators of the modes, with the constant part folded in."""
        n_modes = self.fields.n_modes
        driven = {part: folded(sums, n_modes) for part, sums in self.driven.items()}
        return ReducedOperators(
            inertia=folded(self.inertia, n_modes),
            viscosity=folded(self.viscosity, n_modes),
            walls=driven.get("walls"),
            force=driven.get("force"),
            acoustic=self.acoustic[:, :n_modes],
            walls_driven=self.points.walls_driven,
            drives={
                name: DriveRates(
                    walls=driven.get(f"walls/{name}"), force=driven.get(f"force/{name}")
                )
                for name in self.points.drives
            },
        )


def drags_and_forces(points: FixedPoints) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the friction of moving walls, and body forces (2, n_points), by part.

    Parts are such as `walls`, and `walls/lid` of a parameter.
    """
    drags = {} if points.wall_friction is None else {"walls": points.wall_friction}
    forces = {} if points.body_force is None else {"force": points.body_force}
    for name, drive in points.drives.items():
        if drive.walls is not None:
            drags[f"walls/{name}"] = points.friction_of(drive.walls.T)
        if drive.force is not None:
            forces[f"force/{name}"] = drive.force
    return drags, forces


def product_rates(
    points: FixedPoints,
    fields: ModeFields,
    k: int,
    rows: slice,
    terms: Terms,
    slopes: Array,
) -> tuple[Array, Array]:
    """Return the products of a field, as carrier or compressed density, with all fields.

    Those of the inertia (4, n, n_fields): the advection of q, the rest of continuity, and the
    velocity; and those of the viscosity (2, n, n_fields). `terms` and `slopes` are those of the
    `rows`.
    """
    q, (u, v) = fields.scaled_density[rows, k, None], fields.velocity[:, rows, k, None]
    products = np.empty((4, *terms.divergence.shape))
    products[1] = -q * terms.divergence
    products[[0, 2, 3]] = -u * slopes[:, 0] - v * slopes[:, 1]
    products[2:] += q * terms.pressure_gradient
    return products, -q / points.sound_speed * terms.laplacian


def drag_rates(
    points: FixedPoints, fields: ModeFields, drag: Array, rows: slice
) -> tuple[Array, Array]:
    """Return the rates of the velocity by moving walls' friction, as `force_rates` does."""
    share = fields.scaled_density[rows] / points.sound_speed
    return drag[:, rows], -drag[:, rows, None] * share


def force_rates(
    points: FixedPoints, fields: ModeFields, force: Array, rows: slice
) -> tuple[Array, Array]:
    """Return the rates of the velocity by a body force (2, n_points), per amplitude.

    The constant (2, n), and the part that is linear in the fields (2, n, n_fields).
    """
    head, density = points.head_push(force, rows), fields.scaled_density
    more = points.head_push(force[..., None] * density, rows) - head[..., None] * density[rows]
    return force[:, rows] + head, more / points.sound_speed


def _projected(weights: Array, rates: Array) -> Array:
    """Sum rates (n_rows, n, n_fields) over points, with weights (n_modes, n_rows, n)."""
    n_modes, n_fields = len(weights), rates.shape[2]
    return np.asarray(weights.reshape(n_modes, -1) @ rates.reshape(-1, n_fields))


def folded(tensors: Tensors, n_modes: int) -> Tensors:
    """Return tensors of fields (n, ...) as symmetric tensors of modes.

    The coordinate of the constant part, which stands last, is one.
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


def project_forces(
    points: FixedPoints,
    basis: TrialBasis,
    wall: MeasuredWall,
    circulations: Mapping[str, float] = NONE,
) -> ReducedForce:
    """Project the force on a wall onto a basis.

    `circulations` [m2/s] are those of the walls' velocity that a parameter gives per unit.

    Raises ValueError where there are no walls.
    """
    fields = mode_fields(basis, points)
    uniform = np.full((points.n_points, 1), points.density_scale)

    def terms(of_fields: Array, of_mean: Array) -> Array:
        """Return loads (3, n_terms): of the constant part, of a uniform density, of the modes."""
        of_columns, n = wall.loads(of_fields), fields.n_modes
        constant = of_columns[:, n:].sum(axis=1, keepdims=True)
        return np.hstack((constant, wall.loads(of_mean), of_columns[:, :n]))

    still = np.zeros((2, points.n_points, 1))
    density = fields.scaled_density

    def heads(force: Array | None) -> Array | None:
        if force is None:
            return None
        head, share = force[..., None], 1.0 / points.sound_speed
        found = terms(
            points.ghost_heads(head * density * share),
            points.ghost_heads(head * uniform * share),
        )
        found[:, 0] += wall.loads(points.ghost_heads(force))
        return found

    def drag(ghost_drag: Array, circulation: float) -> Array:
        found = wall.loads(ghost_drag)
        found[TORQUE] -= points.reference_density * circulation
        return found

    drives = {}
    for name, drive in points.drives.items():
        walls = None
        if drive.walls is not None:
            walls = drag(points.drag_of(drive.walls.T), circulations[name])
        drives[name] = DriveForce(walls=walls, force=heads(drive.force))
    return ReducedForce(
        pressure=terms(
            points.ghost_pressures(density, fields.velocity),
            points.ghost_pressures(uniform, still),
        ),
        viscous=terms(points.ghost_friction(fields.velocity), points.ghost_friction(still)),
        walls=drag(points.ghost_drag, wall.circulation),
        body_force=heads(points.body_force),
        drives=drives,
    )
