"""Stokes flows around walls that move one at a time; with them, forces on walls become integrals.

Let w be a velocity field without divergence that moves with one wall as a rigid body and vanishes
at all others. The momentum equation of an incompressible fluid, tested with w, gives the force
along that motion (`docs/forces.md`). Any such field is valid. Errors of the velocity have the least
effect if w itself is a flow without inertia, because its stress then does no work on errors that
have no divergence and vanish at walls. Finite element codes evaluate drag and lift as integrals of
this kind (John and Matthies, Int. J. Numer. Meth. Fluids 37, 2001).

Damping of the fluid at a rate lambda adds -rho int lambda u . w to the force, and lambda/nu w^2 to
the minimised dissipation. In the strip of an open flow w is held at zero, so that the forcing that
keeps the flow rate there does not enter the force.

The stream function of w is a tensor product of quartic B-splines. It minimises the dissipation at
the points of a lattice, moves with the wall at places along it, and is kept smooth behind it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_array, diags_array, eye_array, hstack, vstack
from scipy.sparse.linalg import splu
from scipy.spatial import KDTree

from sphrom.arrays import Array, Indices, Mask
from sphrom.sph.domain import Domain

DEGREE = 4
"""Degree of the stream function's splines, such that strain rates are smooth."""
CELL = 2.0
"""Size of the splines' cells over the spacing of points; smaller cells contain too few points."""
PENALTY, SMOOTHING, REGULARIZATION = 1e4, 1.0, 1e-10
"""Weights, relative to the dissipation, of the wall conditions, of third derivatives times the
spacing, and of the coefficients."""
LEAK = 0.1
"""Largest flow through a wall, or motion into a touching wall, relative to the wall's motion."""

TOUCHING = 2.0
"""Distance of walls that touch each other, in spacings."""


@dataclass(frozen=True)
class StokesFields:
    """The fields w of a wall's motion along x, along y, and of its rotation."""

    follows: Mask
    """(3,) whether there is such a field, without flow through walls. There is none if a wall
    leaves no room for the fluid that it displaces, or lifts off a wall that it touches; it may
    slide along that wall."""
    value: Array
    """(3, n_points, 2) [1], of the rotation [m]."""
    gradient: Array
    """(3, n_points, 2, 2): the component, then the direction of the derivative [1/m], [1]."""


def stokes_fields(
    domain: Domain,
    position: Array,
    ghosts: Array,
    spacing: float,
    names: Iterable[str],
    slowing: Array | None = None,
    strip: Mask | None = None,
) -> dict[str, StokesFields]:
    """Return the fields of some walls of a domain.

    Parameters
    ----------
    position : (n_points, 2) [m] in the fluid, with a volume of `spacing` squared each.
    ghosts : (n_ghosts, 2) [m] behind walls, on the same lattice.
    spacing : of the points [m].
    names : of the walls.
    slowing : (n_points,) the damping rate of the fluid over its viscosity [1/m2].
    strip : (n_points,) whether a point is in the strip of an open flow.
    """
    wrapped = domain.wrap(ghosts)
    wall = domain.nearest_wall(wrapped)
    on_wall = domain.on_wall(wrapped)
    normal = domain.distance_and_normal(wrapped)[1]
    depth, inward = domain.distance_and_normal(position)
    beside = np.flatnonzero(depth < spacing)
    mirrored = position[beside] - 2.0 * depth[beside, None] * inward[beside]
    behind = domain.nearest_wall(domain.wrap(mirrored))
    everywhere = np.concatenate((position, ghosts))
    stream, sides, around = (
        _Stream(domain, places, everywhere, spacing) for places in (position, on_wall, everywhere)
    )
    dissipation = _squares(2.0 * stream.of(1, 1), stream.of(0, 2) - stream.of(2, 0))
    size = dissipation.diagonal().mean()
    third = [math.sqrt(math.comb(3, k)) * around.of(k, 3 - k) for k in range(4)]
    smooth = SMOOTHING * spacing**2 * _squares(*third)
    at_walls = vstack((sides.of(0, 1), -sides.of(1, 0)), format="csr")
    held = at_walls.T @ at_walls
    weight = PENALTY * size / held.diagonal().mean()
    if slowing is not None:
        roots = diags_array(np.sqrt(slowing))
        dissipation = dissipation + _squares(roots @ stream.of(0, 1), roots @ stream.of(1, 0))
    if strip is not None:
        still = diags_array(strip.astype(float))
        smooth = smooth + weight * _squares(still @ stream.of(0, 1), still @ stream.of(1, 0))
    small = REGULARIZATION * size * eye_array(held.shape[0])
    system = (dissipation + smooth + weight * held + small).tocsc()
    # Symmetric and positive definite: ordered for sparse factors, without pivoting.
    symmetric = {"SymmetricMode": True}
    solved = splu(system, "MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=symmetric)
    fields = {}
    for name in names:
        moving = wall == domain.wall_names.index(name)
        motions = np.zeros((3, 2, len(ghosts)))
        x, y = domain.arms(name, on_wall[moving]).T
        motions[0, 0, moving] = motions[1, 1, moving] = 1.0
        motions[2][:, moving] = -y, x
        wanted = motions.reshape(3, -1).T
        coefficients = solved.solve(weight * (at_walls.T @ wanted))
        wrong = (at_walls @ coefficients - wanted).reshape(2, -1, 3)[:, moving]
        through = np.sum(np.einsum("dgm,gd->gm", wrong, normal[moving]) ** 2, axis=0)
        follows = through < LEAK**2 * np.sum(motions**2, axis=(1, 2))
        if strip is not None:  # no wall's motion is possible there
            follows &= not np.any(strip[beside] & (behind == domain.wall_names.index(name)))
        if moving.any():
            # Normals beside the fluid belong to sides; those behind a corner do not.
            others = beside[behind != domain.wall_names.index(name)]
            foot = position[others] - depth[others, None] * inward[others]
            distance, nearest = KDTree(on_wall[moving]).query(foot)
            moved = motions[..., np.flatnonzero(moving)[nearest]]
            lifted = np.abs(np.einsum("mdg,gd->mg", moved, inward[others]))
            follows &= lifted[:, distance < TOUCHING * spacing].max(axis=1, initial=0.0) < LEAK
        fields[name] = StokesFields(follows, *stream.fields(coefficients))
    return fields


def _squares(*rows: csr_array) -> csr_array:
    """Return the matrix of the sum of squares of `rows` times coefficients."""
    return sum(matrix.T @ matrix for matrix in rows)


class _Stream:
    """Derivatives of the stream function at places, as matrices on its coefficients.

    The splines cover the box and all points. Along a periodic axis the stream function is periodic
    except for a mean flow across it, which has a coefficient of its own.
    """

    def __init__(self, domain: Domain, place: Array, points: Array, spacing: float) -> None:
        self._n_places = len(place)
        self._means = [d for d in range(2) if domain.periodic[1 - d]]
        lower = np.array(domain.lower)
        upper = np.array(domain.upper)
        free = ~np.array(domain.periodic)
        lower[free] = np.minimum(lower, points.min(axis=0))[free]
        upper[free] = np.maximum(upper, points.max(axis=0))[free]
        self._axes = [
            _Axis(place[:, d], lower[d], upper[d], domain.periodic[d], spacing) for d in range(2)
        ]

    def of(self, along_x: int, along_y: int) -> csr_array:
        """Return the matrix (n_places, n_coefficients) of a derivative."""
        x, y = self._axes
        columns = x.index[:, :, None] * y.n_functions + y.index[:, None, :]
        values = x.values(along_x)[:, :, None] * y.values(along_y)[:, None, :]
        first = np.arange(0, values.size + 1, (DEGREE + 1) ** 2)
        shape = (self._n_places, x.n_functions * y.n_functions)
        splines = csr_array((values.ravel(), columns.ravel(), first), shape=shape)
        # The mean of u is the slope of the stream function along y, that of v its fall along x.
        slopes = {(0, 1): (1.0, 0.0), (1, 0): (0.0, -1.0)}.get((along_x, along_y), (0.0, 0.0))
        means = np.tile([slopes[d] for d in self._means], (self._n_places, 1))
        return hstack((splines, csr_array(means)), format="csr") if self._means else splines

    def fields(self, coefficients: Array) -> tuple[Array, Array]:
        """Return the velocities of stream functions (n_coefficients, 3), and their gradients."""

        def stacked(*matrices: csr_array) -> Array:
            return np.stack([matrix @ coefficients for matrix in matrices]).transpose(2, 1, 0)

        mixed = self.of(1, 1)
        gradient = stacked(mixed, self.of(0, 2), -self.of(2, 0), -mixed)
        return stacked(self.of(0, 1), -self.of(1, 0)), gradient.reshape(*gradient.shape[:2], 2, 2)


class _Axis:
    """Splines along one axis, at some places."""

    index: Indices
    """(n_places, DEGREE + 1), the splines that are not zero at each place."""

    def __init__(
        self, place: Array, lower: float, upper: float, periodic: bool, spacing: float
    ) -> None:
        n_cells = max(DEGREE + 1, round((upper - lower) / (CELL * spacing)))
        self._cell = (upper - lower) / n_cells
        along = (place - lower) / self._cell
        if periodic:
            along = np.mod(along, n_cells)
        first = np.clip(np.floor(along), 0, n_cells - 1).astype(np.int64)
        self.n_functions = n_cells if periodic else n_cells + DEGREE
        self.index = (first[:, None] + np.arange(DEGREE + 1)) % self.n_functions
        self._within = (along - first)[:, None] + DEGREE - np.arange(DEGREE + 1)

    def values(self, order: int) -> Array:
        """Return a derivative of these splines (n_places, DEGREE + 1)."""
        spline = BSpline.basis_element(np.arange(DEGREE + 2.0), extrapolate=False)
        spline = spline.derivative(order) if order else spline
        return np.nan_to_num(spline(self._within)) / self._cell**order
