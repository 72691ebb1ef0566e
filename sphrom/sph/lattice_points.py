"""The right-hand side at the points of a lattice that fills a three-dimensional box.

The terms are those of `sphrom.sph.fixed_points`. All points have the same neighbours, so there are
no matrices: sums run over one stencil, and states are read once per sum. Fluid beyond a plane wall
is the image of the fluid in front of it, reflected, and the lattice continues there. Sums of the
kernel's gradient over all neighbours are therefore zero, and c is the same for all points:

    G q = sum_j q_j grad W V,      D u = -G^T u = sum_j u_j . grad W V,
    V u = -2 c sum_j F V (u_j - u_i).

In G an image has the q of its point, and the head (x_g - x_j) . b of a body force; in D its
velocity is reflected; in V it is 2 U - u, with the wall's velocity U, and beyond two walls u.
Diffusion takes images, too.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from sphrom.arrays import Array
from sphrom.kernels import lattice_sums
from sphrom.kernels.wendland import LAPLACIAN_SHAPE_IN_SPACE, gradient_factor
from sphrom.sph.domain import Domain, Walls
from sphrom.sph.fixed_points import EVERYWHERE, FixedPoints, Rows, scaled
from sphrom.sph.fluid import Discretization
from sphrom.sph.lattice import Lattice, lattice_order

N_DIM = 3
FACTOR = slice(N_DIM, N_DIM + 1)
"""The column of weights after those of the gradient: the gradient's factor times the volume."""
FRICTION = slice(N_DIM + 1, N_DIM + 2)
"""The factor times the weight of the Laplacian."""


class LatticePoints(FixedPoints):
    """The operators of one scene at the points of a lattice, x fastest, then y.

    Raises ValueError if the points are not such a lattice.
    """

    def _prepare(self, domain: Domain, discretization: Discretization, walls: Walls | None) -> None:
        shape, order = lattice_order(self.position, domain)
        if not np.array_equal(order, np.arange(len(order))):
            raise ValueError("points of a lattice must be in its order")
        pitches = np.divide(domain.lengths, shape)
        depth = math.ceil(discretization.support_radius / pitches.min() - 1e-9)
        self._lattice = Lattice(domain, shape, depth)
        steps = np.arange(-depth, depth + 1)
        stencil = np.array([*itertools.product(steps, repeat=N_DIM)])[:, ::-1]
        offset = -stencil * pitches
        square = np.sum(offset**2, axis=1)
        near = (square > 0.0) & (square < discretization.support_radius**2)
        self._stencil = np.ascontiguousarray(stencil[near])
        offset = offset[near]
        square = square[near]
        inverse_length = 1.0 / discretization.smoothing_length
        distances = np.sqrt(square).tolist()
        factor = np.array([gradient_factor(r, inverse_length, N_DIM) for r in distances])
        factor *= pitches.prod()
        friction = factor * (1.0 - LAPLACIAN_SHAPE_IN_SPACE * square * inverse_length**2)
        self._weights = np.column_stack((factor[:, None] * offset, factor, friction))
        self._c = -N_DIM / float(friction @ square)
        self._renormalization = -1.0 / (factor @ offset**2)
        self._walls = walls

    def _sums(
        self,
        fields: Array,
        columns: slice,
        rows: Rows = EVERYWHERE,
        factors: tuple[Array | float, ...] = (1.0,) * N_DIM,
    ) -> Array:
        """Return sums (n_sums, n, n_fields) of fields (n_points, n_fields) at some points.

        `columns` are those of the weights, and `factors` by axis are those of images.
        """
        targets = np.arange(self.n_points)[rows]
        flat = np.ascontiguousarray(fields.reshape(self.n_points, -1))
        weights = np.ascontiguousarray(self._weights[:, columns])
        out = np.empty((weights.shape[1], targets.size, flat.shape[1]))
        images = self._lattice.images(*factors)
        lattice_sums.sums(targets, flat, self._stencil, weights, images, out)
        return out.reshape(*out.shape[:2], *fields.shape[1:])

    def divergence(self, velocity: Array) -> Array:
        return self._flux(velocity, EVERYWHERE)

    def _flux(self, vectors: Array, rows: Rows) -> Array:
        """Return the sums of vectors times the kernel's gradient; images are reflected."""
        total = np.zeros(())
        for axis, component in enumerate(vectors):
            factors = tuple(np.where(np.arange(N_DIM) == axis, -1.0, 1.0).tolist())
            total = total + self._sums(component, slice(axis, axis + 1), rows, factors)[0]
        return np.asarray(total)

    def _pushed(self, scaled_density: Array, rows: Rows) -> Array:
        return self._sums(scaled_density, slice(N_DIM), rows)

    def _rubbed(self, velocity: Array, rows: Rows) -> Array:
        total = self._weights[:, FRICTION].sum()
        images = (-1.0,) * N_DIM
        sums = [self._sums(u, FRICTION, rows, images)[0] for u in velocity]
        return -2.0 * self._c * (np.stack(sums) - total * velocity[:, rows])

    def gradients(self, fields: Array, rows: Rows = EVERYWHERE) -> Array:
        return scaled(self._renormalization, self._sums(fields, slice(N_DIM), rows))

    def diffusion(self, scaled_density: Array) -> Array:
        if self._diffusivity == 0.0:
            return np.zeros_like(scaled_density)
        total = self._sums(scaled_density, FACTOR)[0]
        total -= self._weights[:, FACTOR].sum() * scaled_density
        total += 0.5 * self._flux(self.gradients(scaled_density), EVERYWHERE)
        return -2.0 * self._diffusivity * total

    def head_push(self, body_force: Array, rows: Rows = EVERYWHERE) -> Array:
        total = np.zeros_like(body_force[:, rows])
        for axis, component in enumerate(body_force):
            if self._lattice.domain.periodic[axis]:
                continue
            index, _ = self._lattice.reach(axis)
            moved = np.arange(index.size) - self._lattice.depth - index
            factors: list[Array | float] = [1.0] * N_DIM
            factors[axis] = moved * self._lattice.pitches[axis]
            heads = self._sums(component, slice(N_DIM), rows, tuple(factors))
            total -= heads
        return total

    @property
    def wall_friction(self) -> Array | None:
        return None if self._walls is None else self.friction_of(self._walls.velocity.T)

    def friction_of(self, wall_velocity: Array) -> Array:
        """Return w (3, n_points) [1/(m s)] for walls' velocities (3, n_ghosts) [m/s]."""
        assert self._walls is not None
        normal = self._walls.normal
        assert normal is not None
        lattice = self._lattice
        depth = np.where(lattice.domain.periodic, 0, lattice.depth)
        shape = tuple((np.array(lattice.shape) + 2 * depth).tolist())
        inner = tuple(slice(d, n - d) for d, n in zip(depth, shape, strict=True))[::-1]
        cells = (self._walls.position - lattice.domain.lower) / lattice.pitches - 0.5 + depth
        index = np.rint(cells).astype(np.int64)
        within = ((index >= 0) & (index < shape)).all(axis=1)
        number = index[within] @ np.cumprod((1, *shape[:-1]))
        moving = np.zeros((math.prod(shape), N_DIM))
        # Images beyond two walls have the velocity of their points.
        odd = normal.sum(axis=1) % 2.0
        moving[number] = (odd[:, None] * wall_velocity.T)[within]
        whole = Lattice(lattice.domain, shape, lattice.depth)
        out = np.empty((1, *moving.shape))
        weights = np.ascontiguousarray(self._weights[:, FRICTION])
        targets = np.arange(len(moving))
        images = whole.images(0.0, 0.0, 0.0)
        lattice_sums.sums(targets, moving, self._stencil, weights, images, out)
        found = out[0].reshape(*shape[::-1], N_DIM)[inner].reshape(-1, N_DIM)
        return -4.0 * self._c * found.T
