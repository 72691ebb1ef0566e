"""The right-hand side on points that never move, as sparse operators (Eq. 2.6-2.12, 2.15-2.16).

Reduced states belong to fixed modes, so their rates can be evaluated at the reference points. There
neighbours, kernels and volumes (V = dx^2, the same for all) are constant, no shifting is needed,
and every sum of the functional is a matrix. With q = c0 rho'/rho0 [m/s] for the density,

    dq/dt = -(c0 + q) D u + delta h c0 L q - u . grad q
    du/dt = (rho0/rho) (-c0 G (q - alpha h D u) + nu (V u + s w) + beta K (1 + q/c0) b) + beta b
            - u . grad u

where the advective terms arise because the points are fixed (Eq. 3.1-3.6), and alpha h D u is the
acoustic damper. Ghosts depend linearly on the fluid: S is Shepard interpolation to them (Eq. 2.15).
Their q is S q, plus a head if there is a body force beta b. If S stands for linear fits instead, it
is exact for linear q, and there are no heads: K = 0. Their velocity is extrapolated from each point
through walls that move with s U, at distances d_i and d_g from the wall. With sums over the fluid's
points j and ghosts g, and with Laplacian weights F normalised by c,

    G q = sum_j (q_j + q_i) grad W V + sum_g ((S q)_g + q_i) grad W V
    D u = -G^T u
    V u = -sum_j (c_i + c_j) F V (u_j - u_i) + 2 c_i sum_g (1 + d_g/d_i) F V u_i
    w   = -2 c_i sum_g (1 + d_g/d_i) F V U_g
    K b = -sum_g grad W V (S (x_g - x_j) . b)_g

D is the continuity equation with walls that return the flux into them. Sound neither gains nor
loses energy for any arrangement of points, and the damper -G D only removes some. The only factor
that is not a polynomial is rho0/rho = 1 / (1 + q/c0). To first order it is 1 - q/c0, and products
of three fields are neglected; to zeroth order K (1 + q/c0) b is K b too.

Resistance adds -lambda u and its head, -K lambda u, to du/dt, and in porous bodies to nu V u; heads
are computed with the density rho0. The terms of a user, A u and B(u, u), likewise have heads. A
strip (`sphrom.sph.fluid`) subtracts the mean e (e . a) from G q, V u and w: as D = -G^T and V =
V^T, by products of q with -D e and of u with V e.

Ghosts take as much momentum as they give. Per unit of time and depth, with m = rho0 V, the force
on a ghost g of a wall is

    m c0 sum_i ((S q)_g + q_i - alpha h ((S D u)_g + (D u)_i)) grad W V
    + m beta (S (x_g - x_j) . (1 + q/c0) b)_g sum_i grad W V
    + 2 m nu sum_i c_i (1 + d_g/d_i) F V (s U_g - u_i),

which is linear in the state at constant volumes, as rho0/rho cancels.

Scalars are (n_points, n_fields), vectors (2, n_points, n_fields): columns are states or modes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from sphrom.arrays import Array, Mask
from sphrom.sph.domain import Domain, Walls
from sphrom.sph.fluid import Discretization, Fluid, Resistance, UnitForcing
from sphrom.sph.point_sums import GhostSums, Matrix, fluid_sums, row_sums
from sphrom.sph.terms import Term

Rows = slice | NDArray[np.int64]
"""Some of the points."""

EVERYWHERE = slice(None)

N_BLOCK_FIELDS = 8
"""Number of fields whose diffusion is computed at once."""


def some_rows(matrix: Matrix, rows: Rows) -> Matrix:
    """Return some rows of a matrix, without a copy if it is all of them."""
    return matrix if rows is EVERYWHERE else matrix[rows]


def scaled(values: Array, fields: Array) -> Array:
    """Multiply fields (n, ...) by one value (n,) per point."""
    return values.reshape(-1, *(1,) * (fields.ndim - 1)) * fields


@dataclass(frozen=True)
class Terms:
    """The terms of the rates that are linear in some fields, at some points."""

    divergence: Array
    """D u (n, n_fields) [1/s]."""
    pressure_gradient: Array
    """G (q - alpha h D u) (2, n, n_fields) [1/s]."""
    laplacian: Array
    """V u (2, n, n_fields) [1/(m s)]."""
    damping: Array | None = None
    """-alpha h G D u, the damper's part of the pressure gradient; None without a damper."""


@dataclass(frozen=True)
class _Held:
    """The strip that holds the flow rate: e, and the vectors that give e . G q and e . V u."""

    axis: int
    unit: Array
    of_density: Array
    of_velocity: Array

    def release(self, vectors: Array, along: Array, rows: Rows) -> None:
        """Subtract e times its products with vectors from vectors at some points, in place."""
        vectors[self.axis] -= np.multiply.outer(self.unit[rows], along)


class FixedPoints:
    """The operators of one scene at points that represent equal areas.

    Parameters
    ----------
    position : (n_points, 2), in the fluid [m].
    walls : the ghosts of the scene's walls, if it has any.
    body_force : (2, n_points) the acceleration b at the points [m/s2] per unit amplitude, if any.
    walls_driven : whether walls move with the amplitude, rather than steadily.
    drives : by parameter, per unit of its value, the velocity of ghosts' walls (n_ghosts, 2) [m/s]
        and the body force (2, n_points) [m/s2], in addition to those above.
    resistance : the resistance that slows the fluid, if any.
    terms : linear and quadratic terms that a user adds to the acceleration.

    Attributes
    ----------
    particle_mass : of the fluid that a point represents [kg/m].
    density_scale : c0/rho0, q over the density fluctuation [m4/(kg s)].
    fixed_volume : whether the mean of the continuity equation is subtracted.
    linear_term, quadratic_term : the sums of A (2, 2, n_points) [1/s] and of B
        (2, 2, 2, n_points) [1/m] of the terms; None if there are none.

    Callers must refuse pair viscosity, and rules of walls without matrices (`WallKind`).
    """

    def __init__(
        self,
        position: Array,
        fluid: Fluid,
        discretization: Discretization,
        domain: Domain,
        walls: Walls | None = None,
        body_force: Array | None = None,
        walls_driven: bool = False,
        drives: Mapping[str, UnitForcing[Array]] | None = None,
        resistance: Resistance | None = None,
        terms: Sequence[Term] = (),
    ) -> None:
        self.position = domain.wrap(position)
        self.sound_speed = fluid.sound_speed
        self.fluid = fluid
        self.density_scale = fluid.sound_speed / fluid.reference_density
        self.fixed_volume = discretization.fixed_volume
        self.body_force = body_force
        self.walls_driven = walls_driven
        self.drives = dict(drives or {})
        delta = discretization.diffusion_coefficient
        length = discretization.smoothing_length
        self._diffusivity = delta * length * fluid.sound_speed
        self._damping_length = discretization.acoustic_damping * length
        volume = discretization.particle_spacing ** position.shape[1]
        self.particle_mass = fluid.reference_density * volume
        self._prepare(domain, discretization, walls)
        self._slow_down(resistance)
        linear = [term.matrices(self.position) for term in terms if term.linear]
        quadratic = [term.products(self.position) for term in terms if term.quadratic]
        self.linear_term = sum(linear) if linear else None
        self.quadratic_term = sum(quadratic) if quadratic else None

    def _prepare(self, domain: Domain, discretization: Discretization, walls: Walls | None) -> None:
        """Store the sums over neighbours."""
        self._fluid = fluid_sums(self.position, domain, discretization)
        rule = discretization.walls.rule
        self._ghosts = (
            None if walls is None else rule.sums_at(self.position, walls, domain, discretization)
        )
        moment = self._fluid.moment + (0.0 if self._ghosts is None else self._ghosts.moment)
        self._viscous = -2.0 / moment
        self._laplacian = self._viscous_matrix()

    def _viscous_matrix(self) -> Matrix:
        """Return V (n_points, n_points), alike for both components, without the strip's mean."""
        c = self._viscous
        friction = self._fluid.friction
        diagonal = c * row_sums(friction) + friction @ c
        if self._ghosts is not None:
            diagonal += 2.0 * c * row_sums(self._ghosts.friction)
        factors = sparse.diags_array(c)
        pairs = factors @ friction + friction @ factors
        return (sparse.diags_array(diagonal) - pairs).tocsr()

    def _slow_down(self, resistance: Resistance | None) -> None:
        """Store the resistance at the points, and products of the strip's vector."""
        self.slowing_rate = self.inverse_permeability = None
        self._held: _Held | None = None
        if resistance is None:
            return
        position = self.position.T
        if resistance.own is not None or resistance.strip is not None:
            self.slowing_rate = resistance.steady(position)
        if resistance.inverse_permeability is not None:
            self.inverse_permeability = resistance.inverse_permeability(position)
        if (strip := resistance.strip) is not None:
            rates = strip.rates(position)
            vector = np.zeros((2, self.n_points, 1))
            vector[strip.axis, :, 0] = rates / np.linalg.norm(rates)
            of_density = -self.divergence(vector)[:, 0]
            of_velocity = self._rubbed(vector, EVERYWHERE)[strip.axis, :, 0]
            unit = vector[strip.axis, :, 0]
            self._held = _Held(strip.axis, unit, of_density, of_velocity)

    def slowed_over(self, viscosity: float) -> tuple[Array | None, Mask | None]:
        """Return resistance over viscosity [1/m2], and whether points are in the strip, if any."""
        inverse = self.inverse_permeability
        rate = self.slowing_rate
        if rate is not None:
            inverse = rate / viscosity + (0.0 if inverse is None else inverse)
        return inverse, None if self._held is None else self._held.unit > 0.0

    @property
    def n_points(self) -> int:
        """Number of points."""
        return len(self.position)

    @property
    def wall_friction(self) -> Array | None:
        """w (2, n_points) [1/(m s)], the contribution of moving walls to the Laplacian."""
        return None if self._ghosts is None else self.friction_of(self._ghosts.velocity)

    def friction_of(self, wall_velocity: Array) -> Array:
        """Return w (2, n_points) [1/(m s)] for walls' velocities (2, n_ghosts) [m/s]."""
        drag = -2.0 * self._viscous
        friction = self._beside_walls.friction
        out = np.stack([drag * (friction @ u) for u in wall_velocity])
        if self._held is not None:
            along = self._held.unit @ out[self._held.axis]
            self._held.release(out, along, EVERYWHERE)
        return out

    def terms(
        self,
        scaled_density: Array,
        velocity: Array,
        rows: Rows = EVERYWHERE,
        divergence: Array | None = None,
    ) -> Terms:
        """Return the linear terms at some points, of fields at all points.

        `scaled_density` is q (n_points, n_fields), `velocity` (2, n_points, n_fields), both [m/s].
        `divergence` is D u (n_points, n_fields), if the caller has computed it already.
        """
        if divergence is None:
            divergence = self.divergence(velocity)
        push = self._pushed(scaled_density, rows)
        damping = None
        if self._damping_length > 0.0:
            damping = -self._damping_length * self._pushed(divergence, rows)
            push += damping
        laplacian = self._rubbed(velocity, rows)
        if self.inverse_permeability is not None:
            slowed = self.inverse_permeability[:, None] * velocity
            laplacian -= slowed[:, rows] + self.head_push(slowed, rows)
        return Terms(divergence[rows], push, laplacian, damping)

    def divergence(self, velocity: Array) -> Array:
        """Return D u (n_points, n_fields) [1/s] of velocities (2, n_points, n_fields) [m/s]."""
        fluid = self._fluid
        ghosts = self._ghosts
        support = fluid.support if ghosts is None else fluid.support + ghosts.support
        out = sum(
            fluid.gradient[d] @ velocity[d] - scaled(support[d], velocity[d]) for d in range(2)
        )
        if ghosts is not None:
            flux = sum(ghosts.gradient[d].T @ velocity[d] for d in range(2))
            out -= ghosts.mean.T @ flux
        return np.asarray(out)

    def _pushed(self, scaled_density: Array, rows: Rows) -> Array:
        """Return G q (2, n, n_fields) [1/s] at some points."""
        fluid = self._fluid
        ghosts = self._ghosts
        q = scaled_density[rows]
        out = np.stack(
            [
                some_rows(fluid.gradient[d], rows) @ scaled_density
                + scaled(fluid.support[d, rows], q)
                for d in range(2)
            ]
        )
        if ghosts is not None:
            mean = ghosts.mean @ scaled_density
            for d in range(2):
                out[d] += some_rows(ghosts.gradient[d], rows) @ mean
                out[d] += scaled(ghosts.support[d, rows], q)
        if (held := self._held) is not None:
            held.release(out, held.of_density @ scaled_density, rows)
        return out

    def _rubbed(self, velocity: Array, rows: Rows) -> Array:
        """Return V u (2, n, n_fields) [1/(m s)] at some points."""
        matrix = some_rows(self._laplacian, rows)
        out = np.stack([matrix @ u for u in velocity])
        if (held := self._held) is not None:
            held.release(out, held.of_velocity @ velocity[held.axis], rows)
        return out

    def gradients(self, fields: Array, rows: Rows = EVERYWHERE) -> Array:
        """Return the renormalised gradients (2, n, n_fields) of fields at some points (Eq. 2.11).

        They are sums over the fluid only, and exact for linear fields.
        """
        fluid = self._fluid
        plain = [
            some_rows(fluid.gradient[d], rows) @ fields
            - scaled(fluid.support[d, rows], fields[rows])
            for d in range(2)
        ]
        return np.einsum("dei,ei...->di...", fluid.renormalization[:, :, rows], np.stack(plain))

    def diffusion(self, scaled_density: Array) -> Array:
        """Return delta h c0 L q (n_points, n_fields) [m/s2] (Eq. 2.10)."""
        out = np.zeros_like(scaled_density)
        fluid = self._fluid
        if self._diffusivity == 0.0:
            return out
        for first in range(0, scaled_density.shape[1], N_BLOCK_FIELDS):
            some = slice(first, first + N_BLOCK_FIELDS)
            q = np.ascontiguousarray(scaled_density[:, some])
            slope = self.gradients(q)
            total = fluid.factor @ q - scaled(fluid.factor_sum, q)
            for d in range(2):
                total += 0.5 * (scaled(fluid.support[d], slope[d]) + fluid.gradient[d] @ slope[d])
            out[:, some] = -2.0 * self._diffusivity * total
        return out

    def head_push(self, body_force: Array, rows: Rows = EVERYWHERE) -> Array:
        """Return K b (2, n, ...) [m/s2] at some points, for a force (2, n_points, ...) (Eq. 2.15).

        It is due to the heads of ghosts, and zero if there are none.
        """
        ghosts = self._ghosts
        if ghosts is None:
            return np.zeros_like(body_force[:, rows])
        head = ghosts.heads(body_force)
        push = np.stack([-(some_rows(ghosts.gradient[d], rows) @ head) for d in range(2)])
        if (held := self._held) is not None:
            held.release(push, -(ghosts.gradient[held.axis].T @ held.unit) @ head, rows)
        return push

    def ghost_pressures(self, scaled_density: Array, velocity: Array) -> Array:
        """Return the pressure force on ghosts (2, n_ghosts, n_fields) [N/m], without heads.

        `scaled_density` is q (n_points, n_fields), `velocity` (2, n_points, n_fields), both [m/s].
        """
        ghosts = self._beside_walls
        q = scaled_density - self._damping_length * self.divergence(velocity)
        mean = ghosts.mean @ q
        scale = self.particle_mass * self.sound_speed
        push = scale * np.stack([scaled(row_sums(g.T), mean) + g.T @ q for g in ghosts.gradient])
        if self.slowing_rate is not None:
            push -= self.ghost_heads(self.slowing_rate[:, None] * velocity)
        return push

    def ghost_heads(self, body_force: Array) -> Array:
        """Return the force of heads on ghosts (2, n_ghosts, ...) [N/m], for (2, n_points, ...)."""
        ghosts = self._beside_walls
        head = ghosts.heads(body_force)
        push = np.stack([scaled(row_sums(g.T), head) for g in ghosts.gradient])
        return self.particle_mass * push

    def ghost_friction(self, velocity: Array) -> Array:
        """Return the viscous force on ghosts at rest (2, n_ghosts, n_fields) [N/m], per viscosity.

        Velocities are (2, n_points, n_fields) [m/s].
        """
        back = self._beside_walls.friction.T
        drag = np.stack([back @ scaled(self._viscous, u) for u in velocity])
        drag = -2.0 * self.particle_mass * drag
        if self.inverse_permeability is not None:
            drag -= self.ghost_heads(self.inverse_permeability[:, None] * velocity)
        return drag

    @property
    def ghost_drag(self) -> Array:
        """The viscous force on ghosts (2, n_ghosts) [N/m] of moving walls in fluid at rest.

        It is per viscosity, at the walls' velocity.
        """
        return self.drag_of(self._beside_walls.velocity)

    def drag_of(self, wall_velocity: Array) -> Array:
        """Return `ghost_drag` for walls' velocities (2, n_ghosts) [m/s]."""
        back = self._beside_walls.friction.T
        return 2.0 * self.particle_mass * (back @ self._viscous) * wall_velocity

    @property
    def _beside_walls(self) -> GhostSums:
        assert self._ghosts is not None
        return self._ghosts
