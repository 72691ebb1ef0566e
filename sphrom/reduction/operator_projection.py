"""Projection of rates, their residual, and forces on walls from the reference points, done once.

The rates of `sphrom.sph.fixed_points` are quadratic once rho0/rho is expanded, so their Galerkin
projection (Eq. 3.21) is quadratic in the generalized coordinates. As in
`sphrom.reduction.reduced_operators`, the columns of the residual are replaced by the triangular
factor of their QR decomposition, without directions that no state near the training states reaches.

Everything is computed alike for the modes and the constant part of a state, and the constant part
is then folded into the modes. Points are read in blocks; the memory holds the basis, its copy as
fields, and the diffusion of q, a third of that size.

With a separate mean, states have no mean density here: it drives no flow, and is conserved.

The closure of adjoint Petrov-Galerkin (Eq. 3.22) is a polynomial too. Its rates are
Phi^T W (f + tau J r), where f are the rates at all points, r = Pi' f is their residual after
projection, and J the Jacobian of f. With b = (1, a), e_0 the constant part of a state and e_m the
modes, f is the sum of b_k b_l F_kl over k <= l. F_kl is S(e_k, e_l), halved for k = l; with k = 0
it also contains L e_l, and with k = l = 0 the constant sources. L is the linear part here, and
S(x, y) = B(x, y) + B(y, x) that of products. As J x = L x + S(u, x),

    Phi^T W J r = sum_m sum_{k <= l} b_m b_k b_l Phi^T W (S(e_m, R_kl) + [m = 0] L R_kl)

where R_kl = Pi' F_kl. Symmetrised over its indices this is one tensor of the third degree in b: a
cubic polynomial in a, which needs neither residual nor Jacobian online. It has n^4/6 entries for
n modes and is quadratic in the viscosity. With a body force or driven walls, L and the sources have
a part proportional to the amplitude, and the polynomial contains its first two powers. A residual
is no combination of modes, so its gradients are sums over points (Eq. 2.11).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement, permutations
from typing import Any

import numpy as np

from sphrom.arrays import Array
from sphrom.declaration import Tensors
from sphrom.metrics.measures import TORQUE
from sphrom.reduction.mode_fields import (
    BLOCK_VALUES,
    ModeFields,
    blocks,
    mode_fields,
    mode_gradients,
    weighted_rows,
)
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.reduced_measures import DriveForce, MomentumBalance, ReducedForce
from sphrom.reduction.reduced_operators import (
    DriveRates,
    DriveResidual,
    MemoryOperators,
    Polynomial,
    ReducedOperators,
    ResidualFactor,
    monomials,
    pack,
)
from sphrom.reduction.stokes_fields import StokesFields
from sphrom.reduction.trial_basis import TrialBasis
from sphrom.sph.fixed_points import EVERYWHERE, FixedPoints, Terms
from sphrom.sph.fluid import NONE
from sphrom.sph.functional import MeasuredWall

Advance = Callable[[int], None]
"""Called with the number of points that were completed."""

DROPPED = 1e-5
"""Directions are dropped if their singular value, over the largest, is below this."""


def project_operators(
    points: FixedPoints,
    basis: TrialBasis,
    splines: ModeSplines | None = None,
    *,
    advance: Advance = lambda n_points: None,
) -> ReducedOperators:
    """Project the rates of fixed points onto a basis (Eq. 3.21).

    Advection uses the gradients of `splines`, those of the basis; by default, sums over the points.
    """
    sums = _Sums(points, basis, splines)
    for rows in blocks(points.n_points, BLOCK_VALUES // (6 * sums.fields.n_fields)):
        sums.add(rows)
        advance(rows.stop - rows.start)
    return sums.folded()


def residual_factor(
    points: FixedPoints,
    basis: TrialBasis,
    operators: ReducedOperators,
    splines: ModeSplines | None = None,
    *,
    largest: Array | None = None,
    scales: Mapping[str, float] | None = None,
    advance: Advance = lambda n_points: None,
) -> ResidualFactor:
    """Factorise the columns of the residual, block by block.

    Parameters
    ----------
    operators : projected with the same points, basis and splines.
    largest : (n_modes,) largest coordinates that states reach; by default one each. Directions
        whose residuals are below `DROPPED` for these coordinates are dropped.
    scales : values of the parameters by part for this purpose; by default one.
    """
    residuals = _Residuals(points, basis, operators, splines)
    triangle = np.zeros((0, sum(residuals.widths)))
    for rows in blocks(points.n_points, triangle.shape[1]):
        block = np.concatenate((triangle, residuals.columns(rows)))
        triangle = np.asarray(np.linalg.qr(block, mode="r"))
        advance(rows.stop - rows.start)
    reached = np.ones(basis.n_modes) if largest is None else largest
    # Every coordinate counts at least a little.
    floor = np.finfo(float).eps * float(np.max(reached))
    size = monomials(np.maximum(reached, floor)[None])[0]
    factors = [(scales or {}).get(part, 1.0) for part in residuals.parts]
    scale = np.concatenate(
        [factor * size[:n] for factor, n in zip(factors, residuals.widths, strict=True)]
    )
    # The fewest rows that give the same norms.
    _, values, directions = np.linalg.svd(triangle * scale, full_matrices=False)
    kept = values > DROPPED * values[0]
    reduced = np.asarray(values[kept, None] * directions[kept] / scale)
    parts = np.split(reduced, np.cumsum(residuals.widths)[:-1], axis=1)
    by_part = dict(zip(residuals.parts, parts, strict=True))
    fields = _fields_of(by_part, operators.drives, DriveResidual)
    return ResidualFactor(**fields, walls_driven=points.walls_driven)


def _fields_of(
    by_part: Mapping[str, Any], names: Iterable[str], drive: type[DriveRates | DriveResidual]
) -> dict[str, Any]:
    """Return the fields of a record from arrays by part; driving parameters have nested records."""
    own = {part: by_part.get(part) for part in ("inertia", "viscosity", "walls", "force")}
    drives = {
        name: drive(walls=by_part.get(f"walls/{name}"), force=by_part.get(f"force/{name}"))
        for name in names
    }
    return {**own, "drives": drives}


class _Fields:
    """The modes as fields, and their rates at some points.

    Rates by moving walls and body forces are named `walls`, or `walls/lid` for a parameter `lid`.
    """

    def __init__(self, points: FixedPoints, basis: TrialBasis, splines: ModeSplines | None) -> None:
        self.points = points
        self.basis = basis
        self.fields = mode_fields(basis, points)
        self.slopes = mode_gradients(points, self.fields, splines)
        self.diffusion = points.diffusion(self.fields.scaled_density)
        self.divergence = points.divergence(self.fields.velocity)
        self.drags = {} if points.wall_friction is None else {"walls": points.wall_friction}
        self.forces = {} if points.body_force is None else {"force": points.body_force}
        for name, drive in points.drives.items():
            if drive.walls is not None:
                self.drags[f"walls/{name}"] = points.friction_of(drive.walls.T)
            if drive.force is not None:
                self.forces[f"force/{name}"] = drive.force

    def terms(self, rows: slice) -> Terms:
        """Return the linear terms of the fields."""
        fields = self.fields
        return self.points.terms(fields.scaled_density, fields.velocity, rows, self.divergence)

    def products(self, k: int, rows: slice, terms: Terms, slopes: Array) -> tuple[Array, Array]:
        """Return the products of a field, as carrier or compressed density, with all fields.

        The first result is the inertia (4, n, n_fields): the advection of q, the rest of the
        continuity equation, and the velocity. The second is the viscosity (2, n, n_fields).
        """
        q, (u, v) = (
            self.fields.scaled_density[rows, k, None],
            self.fields.velocity[:, rows, k, None],
        )
        products = np.empty((4, *terms.divergence.shape))
        products[1] = -q * terms.divergence
        products[[0, 2, 3]] = -u * slopes[:, 0] - v * slopes[:, 1]
        products[2:] += q * terms.pressure_gradient
        return products, -q / self.points.sound_speed * terms.laplacian

    def driven(self, rows: slice) -> dict[str, tuple[Array, Array]]:
        """Return the rates of the velocity caused by moving walls and body forces, by part.

        A part has a constant (2, n) and a term that is linear in the fields (2, n, n_fields).
        """
        density = self.fields.scaled_density
        rates = {}
        for part, drag in self.drags.items():
            share = density[rows] / self.points.sound_speed
            rates[part] = drag[:, rows], -drag[:, rows, None] * share
        for part, force in self.forces.items():
            head = self.points.head_push(force, rows)
            more = self.points.head_push(force[..., None] * density, rows)
            more = more - head[..., None] * density[rows]
            rates[part] = force[:, rows] + head, more / self.points.sound_speed
        return rates


class _Sums(_Fields):
    """Sums of the operators of all fields over blocks of points.

    A point has four rates: the advection of q, the rest of the continuity equation (from which the
    mean may be subtracted), and two components of the velocity.
    """

    def __init__(self, points: FixedPoints, basis: TrialBasis, splines: ModeSplines | None) -> None:
        super().__init__(points, basis, splines)
        m = self.fields.n_modes
        k = self.fields.n_fields
        self.acoustic = np.zeros((m, k))
        self.inertia = np.zeros(m), np.zeros((m, k)), np.zeros((m, k, k))
        self.viscosity = np.zeros(m), np.zeros((m, k)), np.zeros((m, k, k))
        self.by_part = {
            part: (np.zeros(m), np.zeros((m, k))) for part in (*self.drags, *self.forces)
        }
        self._mean_weight = np.zeros(m)
        if points.fixed_volume:
            # Subtracting the mean from rates is the same as subtracting it from their weights.
            total = basis.density_modes @ basis.weights
            self._mean_weight = total / (self.fields.density_ratio * points.n_points)

    def add(self, rows: slice) -> None:
        """Add the contribution of a block of points."""
        speed = self.points.sound_speed
        terms = self.terms(rows)
        slopes = self.slopes(rows)
        tests = weighted_rows(self.basis, self.fields, rows)
        continuity = tests[:, :1] - self._mean_weight[:, None, None]
        weights = np.concatenate((tests[:, :1], continuity, tests[:, 1:]), axis=1)
        sound = -speed * np.concatenate((terms.divergence[None], terms.pressure_gradient))
        linear = _projected(weights[:, 1:], sound)
        self.inertia[1][...] += linear + weights[:, 1] @ self.diffusion[rows]
        if terms.damping is not None:
            linear += speed * _projected(weights[:, 2:], terms.damping)
        self.acoustic[...] += linear
        if terms.slowing is not None:
            self.inertia[1][...] += _projected(weights[:, 2:], terms.slowing)
        self.viscosity[1][...] += _projected(weights[:, 2:], terms.laplacian)
        for k in range(self.fields.n_fields):
            inertia, viscosity = self.products(k, rows, terms, slopes)
            self.inertia[2][:, k] += _projected(weights, inertia)
            self.viscosity[2][:, k] += _projected(weights[:, 2:], viscosity)
        for part, (constant, lighter) in self.driven(rows).items():
            into = self.by_part[part]
            into[0][...] += _projected(weights[:, 2:], constant[..., None])[:, 0]
            into[1][...] += _projected(weights[:, 2:], lighter)

    def folded(self) -> ReducedOperators:
        """Return the operators of the modes, with the constant part folded in."""
        n_modes = self.fields.n_modes
        points = self.points
        parts = {"inertia": self.inertia, "viscosity": self.viscosity, **self.by_part}
        folded = {part: _folded(sums, n_modes) for part, sums in parts.items()}
        fields = _fields_of(folded, points.drives, DriveRates)
        acoustic = self.acoustic[:, :n_modes]
        return ReducedOperators(**fields, acoustic=acoustic, walls_driven=points.walls_driven)


def _projected(weights: Array, rates: Array) -> Array:
    """Sum rates (n_rows, n, n_fields) over points, with weights (n_modes, n_rows, n)."""
    n_modes = len(weights)
    n_fields = rates.shape[2]
    return np.asarray(weights.reshape(n_modes, -1) @ rates.reshape(-1, n_fields))


def _folded(tensors: Tensors, n_modes: int) -> Tensors:
    """Return tensors of fields (n, ...) as symmetric tensors of modes.

    The constant part is the last field; its coordinate is one.
    """
    constant, linear, *quadratic = tensors
    modes = slice(n_modes)
    one = slice(n_modes, None)
    constant = constant + linear[:, one].sum(axis=1)
    linear = linear[:, modes].copy()
    for product in quadratic:
        constant = constant + product[:, one, one].sum(axis=(1, 2))
        linear += product[:, modes, one].sum(axis=2) + product[:, one, modes].sum(axis=1)
    symmetric = [0.5 * (h + h.swapaxes(1, 2))[:, modes, modes] for h in quadratic]
    return (constant, linear, *symmetric)


class _Residuals(_Fields):
    """The residual's columns at points, orthogonal to the modes and weighted as in the product."""

    def __init__(
        self,
        points: FixedPoints,
        basis: TrialBasis,
        operators: ReducedOperators,
        splines: ModeSplines | None,
    ) -> None:
        super().__init__(points, basis, splines)
        tensors = {part: getattr(operators, part) for part in ("inertia", "viscosity")}
        for name, each in {"": operators, **operators.drives}.items():
            for part in ("walls", "force"):
                tensors[f"{part}/{name}" if name else part] = getattr(each, part)
        tensors = {part: each for part, each in tensors.items() if each is not None}
        self.parts = list(tensors)
        projected = [pack(each) for each in tensors.values()]
        self.widths = [p.shape[1] for p in projected]
        self._projected = np.concatenate(projected, axis=1)
        # The mean of the continuity equation, from the fields and from their products.
        self._means: tuple[Array | float, Array | float] = 0.0, 0.0
        if points.fixed_volume:
            linear = self.diffusion.sum(axis=0)
            linear -= points.sound_speed * self.divergence.sum(axis=0)
            products = -(self.fields.scaled_density.T @ self.divergence)
            self._means = linear / points.n_points, products / points.n_points

    def columns(self, rows: slice) -> Array:
        """Return the columns (3 n, n_columns) at some points."""
        tensors = self._by_part(rows)
        packed = []
        for part in self.parts:
            flat = tuple(tensor.reshape(-1, *tensor.shape[2:]) for tensor in tensors[part])
            packed.append(pack(_folded(flat, self.fields.n_modes)))
        n_columns = sum(self.widths)
        rates = np.concatenate(packed, axis=1).reshape(3, -1, n_columns)
        rates[0] /= self.fields.density_ratio
        rates[0] -= self.basis.density_modes[:, rows].T @ self._projected
        rates[1:] -= self.basis.velocity_modes[:, rows].transpose(2, 1, 0) @ self._projected
        rates *= np.sqrt(self.basis.weights[rows])[:, None]
        return rates.reshape(-1, n_columns)

    def _by_part(self, rows: slice) -> dict[str, Tensors]:
        """Return the rates of the columns at some points, by part and degree, as (3, n, ...)."""
        points = self.points
        terms = self.terms(rows)
        slopes = self.slopes(rows)
        constant = np.zeros((3, *terms.divergence.shape[:1]))
        sound, friction = np.zeros((2, 3, *terms.divergence.shape))
        sound[0] = self.diffusion[rows] - points.sound_speed * terms.divergence - self._means[0]
        sound[1:] = -points.sound_speed * terms.pressure_gradient
        if terms.slowing is not None:
            sound[1:] += terms.slowing
        friction[1:] = terms.laplacian
        inertia = np.empty((*sound.shape, self.fields.n_fields))
        viscosity = np.zeros_like(inertia)
        for k in range(self.fields.n_fields):
            own, light = self.products(k, rows, terms, slopes)
            inertia[:, :, k] = own[[0, 2, 3]]
            inertia[0, :, k] += own[1]
            viscosity[1:, :, k] = light
        inertia[0] -= self._means[1]
        by_part: dict[str, Tensors] = {
            "inertia": (constant, sound, inertia),
            "viscosity": (constant, friction, viscosity),
        }
        for part, rates in self.driven(rows).items():
            # They do not enter the continuity equation.
            by_part[part] = tuple(np.concatenate((np.zeros_like(t[:1]), t)) for t in rates)
        return by_part


def project_forces(
    points: FixedPoints,
    basis: TrialBasis,
    wall: MeasuredWall,
    circulations: Mapping[str, float] = NONE,
    balance: tuple[StokesFields, ModeSplines | None] | None = None,
) -> ReducedForce:
    """Project the force on a wall onto a basis.

    Parameters
    ----------
    circulations : of the wall velocity per unit of each driving parameter [m2/s].
    balance : the Stokes flows of the wall's motions and the splines of the modes, to project the
        balance of momentum too.
    """
    tested = None if balance is None else balance[0]

    def push(force: Array | None) -> Array | None:
        if tested is None or force is None:
            return None
        return points.particle_mass * np.einsum("lnd,dn->l", tested.value, force)

    fields = mode_fields(basis, points)
    uniform = np.full((points.n_points, 1), points.density_scale)

    def terms(of_fields: Array, of_mean: Array) -> Array:
        """Return loads (3, n_terms) of the constant part, of a uniform density, of the modes."""
        of_columns = wall.loads(of_fields)
        n = fields.n_modes
        constant = of_columns[:, n:].sum(axis=1, keepdims=True)
        return np.hstack((constant, wall.loads(of_mean), of_columns[:, :n]))

    still = np.zeros((2, points.n_points, 1))
    density = fields.scaled_density

    def heads(force: Array | None) -> Array | None:
        if force is None:
            return None
        head, share = force[..., None], 1.0 / points.sound_speed
        loads = terms(
            points.ghost_heads(head * density * share), points.ghost_heads(head * uniform * share)
        )
        loads[:, 0] += wall.loads(points.ghost_heads(force))
        return loads

    def drag(ghost_drag: Array, circulation: float) -> Array:
        loads = wall.loads(ghost_drag)
        loads[TORQUE] -= points.reference_density * circulation
        return loads

    drives = {}
    for name, drive in points.drives.items():
        walls = None
        if drive.walls is not None:
            walls = drag(points.drag_of(drive.walls.T), circulations[name])
        drives[name] = DriveForce(walls=walls, force=heads(drive.force), push=push(drive.force))
    return ReducedForce(
        pressure=terms(
            points.ghost_pressures(density, fields.velocity), points.ghost_pressures(uniform, still)
        ),
        viscous=terms(points.ghost_friction(fields.velocity), points.ghost_friction(still)),
        walls=drag(points.ghost_drag, wall.circulation),
        body_force=heads(points.body_force),
        balance=None
        if balance is None
        else _balance(points, basis, *balance, push(points.body_force)),
        drives=drives,
    )


def _balance(
    points: FixedPoints,
    basis: TrialBasis,
    tested: StokesFields,
    splines: ModeSplines | None,
    push: Array | None,
) -> MomentumBalance:
    """Project the terms of the balance of momentum, tested with Stokes flows."""
    fields = mode_fields(basis, points)
    n = basis.n_modes
    gradients_of = mode_gradients(points, fields, splines)
    momentum = np.zeros((3, n))
    strain = np.zeros((3, n))
    advection = np.zeros((3, n, n))
    for rows in blocks(points.n_points, BLOCK_VALUES // (6 * n)):
        velocity, gradient = fields.velocity[:, rows, :n], gradients_of(rows)[1:, ..., :n]
        value, slope = tested.value[:, rows], tested.gradient[:, rows]
        momentum += np.einsum("lni,ink->lk", value, velocity)
        strain += np.einsum("lnij,ijnk->lk", slope + slope.swapaxes(2, 3), gradient)
        carried = np.einsum("lnij,jnk->lnik", slope, velocity)
        advection += np.einsum("lnik,inm->lkm", carried, velocity, optimize=True)
    advection = 0.5 * (advection + advection.swapaxes(1, 2))
    mass = points.particle_mass

    def slowing(rate: Array | None) -> Array | None:
        if rate is None:
            return None
        slowed = np.einsum("lnd,n,dnk->lk", tested.value, rate, fields.velocity[..., :n])
        return np.asarray(mass * slowed)

    slowed = slowing(points.slowing_rate)
    viscous = slowing(points.inverse_permeability)
    return MomentumBalance(
        follows=tested.follows.astype(np.int64),
        momentum=mass * momentum,
        advection=mass * advection,
        strain=mass * strain + (0.0 if viscous is None else viscous),
        slowing=slowed,
        push=push,
    )


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
        one = (..., slice(k, k + 1))
        t = self.terms
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
        points = self.points
        terms = states.terms
        speed = self.points.sound_speed
        share = states.scaled_density / speed
        out = np.zeros_like(states.slopes[:, 0])
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
        u, v = carrier.velocity
        q = carrier.scaled_density
        terms = carried.terms
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

    Other parameters: see `project_operators`.
    """
    rates = _Rates(points, kinematic_viscosity)
    fields = mode_fields(basis, points)
    states = _all_states(points, fields, splines)
    weights = weighted_rows(basis, fields, EVERYWHERE)
    n = fields.n_modes + 1
    pairs = list(combinations_with_replacement(range(n), 2))
    sums = np.zeros((2 * rates.n_powers - 1, n - 1, n, len(pairs)))
    for some in blocks(len(pairs), BLOCK_VALUES // (9 * points.n_points)):
        for power in range(rates.n_powers):
            left = _left_over(rates, states, pairs[some], power, weights, fields)
            q = np.ascontiguousarray(left[0])
            velocity = np.ascontiguousarray(left[1:])
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

    q = ordered(fields.scaled_density)
    velocity = ordered(fields.velocity)
    slopes = ordered(mode_gradients(points, fields, splines)(slice(0, points.n_points)))
    return _States(q, velocity, slopes, points.terms(q, velocity))


def _left_over(
    rates: _Rates, states: _States, pairs: Pairs, power: int, weights: Array, fields: ModeFields
) -> Array:
    """Return R = Pi' F (3, n_points, n_pairs) of some pairs, in q and the velocity (Alg. 3.5)."""
    out = np.zeros((3, rates.points.n_points, len(pairs)))
    for column, (k, l) in enumerate(pairs):
        first = states.only(k)
        second = states.only(l)
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
