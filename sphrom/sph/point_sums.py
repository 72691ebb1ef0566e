"""Sums over the neighbours of points that never move, as sparse matrices.

Matrices have a row per point and a column per source unless stated otherwise; the contributions of
a source's periodic images are added.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from sphrom.arrays import Array
from sphrom.kernels import mirror_fits
from sphrom.kernels.wendland import LAPLACIAN_SHAPE, weigh
from sphrom.sph.domain import Domain, Walls
from sphrom.sph.fluid import Discretization
from sphrom.sph.neighbourhood import periodic_images, sort_sources

Matrix = Any
"""A sparse matrix in compressed rows."""

N_BLOCK_POINTS = 4096
"""Number of points whose pairs are found at once."""


@dataclass(frozen=True)
class FluidSums:
    """Sums over the fluid's points; matrices are (n_points, n_points)."""

    gradient: tuple[Matrix, Matrix]
    """The kernel's gradient times the volume, by component [1/m]."""
    factor: Matrix
    """The gradient's factor times the volume [1/m2]."""
    friction: Matrix
    """The factor times the weight of the Laplacian [1/m2]."""
    support: Array
    """(2, n_points), the sums of the gradient [1/m]."""
    factor_sum: Array
    """(n_points,) [1/m2]."""
    moment: Array
    """(n_points,) trace of the second moment of the friction."""
    renormalization: Array
    """(2, 2, n_points) L of Eq. 2.11."""


@dataclass(frozen=True)
class GhostSums:
    """Sums over ghosts, (n_points, n_ghosts), and over the points around them."""

    gradient: tuple[Matrix, Matrix]
    support: Array
    """(2, n_points)."""
    friction: Matrix
    """The factor times the weight of the Laplacian and the stretch of extrapolated velocities."""
    moment: Array
    """(n_points,) the second moment of the friction, without extrapolation."""
    mean: Matrix
    """S (n_ghosts, n_points)."""
    head: tuple[Matrix, Matrix] | None
    """(n_ghosts, n_points) S times the offset of a ghost from a point, by component [m]; if any."""
    velocity: Array
    """(2, n_ghosts) of the walls [m/s]."""

    def heads(self, body_force: Array) -> Array:
        """Return ghosts' heads (n_ghosts, ...) [m2/s2] of a force (2, n_points, ...) (Eq. 2.15)."""
        if self.head is None:
            return np.zeros((self.mean.shape[0], *body_force.shape[2:]))
        return np.asarray(sum(self.head[d] @ body_force[d] for d in range(2)))


@dataclass(frozen=True)
class _PairBlock:
    """The pairs of a block of points with their sources."""

    n_rows: int
    first: int
    """Index of the first target."""
    row: NDArray[np.int64]
    """(n_pairs,) within the block."""
    column: NDArray[np.int64]
    offset: Array
    """(2, n_pairs) [m]."""
    square: Array
    """(n_pairs,) of the distance [m2]."""
    kernel: Array
    factor: Array
    """Times the volume."""
    friction: Array
    """The factor times the weight of the Laplacian."""

    def row_sums(self, values: Array) -> Array:
        """Return the sums (n_rows,) of values (n_pairs,) over the pairs of each target."""
        return np.asarray(np.bincount(self.row, values, self.n_rows), dtype=np.float64)

    def matrix(self, values: Array, n_columns: int) -> Matrix:
        """Return the matrix of values (n_pairs,); those of images are added."""
        return sparse.csr_matrix((values, (self.row, self.column)), (self.n_rows, n_columns))


def _pair_blocks(
    targets: Array, sources: Array, domain: Domain, discretization: Discretization
) -> Iterator[_PairBlock]:
    """Find the pairs of targets (n_targets, 2) with sources (n_sources, 2) and their images [m]."""
    reach = discretization.support_radius
    particle, image = periodic_images(sources.T, domain, reach)
    images = sources[particle] + image.T
    tree = cKDTree(images)
    for first in range(0, len(targets), N_BLOCK_POINTS):
        some = targets[first : first + N_BLOCK_POINTS]
        found = cKDTree(some).sparse_distance_matrix(tree, reach, output_type="coo_matrix")
        kernel = np.empty_like(found.data)
        factor = np.empty_like(found.data)
        weigh(found.data, 1.0 / discretization.smoothing_length, kernel, factor)
        factor *= discretization.particle_spacing**2
        offset = np.ascontiguousarray((some[found.row] - images[found.col]).T)
        square = found.data**2
        weight = 1.0 - LAPLACIAN_SHAPE * square / discretization.smoothing_length**2
        column = particle[found.col]
        yield _PairBlock(
            len(some), first, found.row, column, offset, square, kernel, factor, factor * weight
        )


def fluid_sums(position: Array, domain: Domain, discretization: Discretization) -> FluidSums:
    """Return the sums between points (n_points, 2) [m]."""
    blocks, moments = [], []
    for pairs in _pair_blocks(position, position, domain, discretization):
        x, y = pairs.offset
        wx, wy = pairs.factor * x, pairs.factor * y
        matrices = (wx, wy, pairs.factor, pairs.friction)
        blocks.append([pairs.matrix(values, len(position)) for values in matrices])
        products = (wx * x, wx * y, wy * y, pairs.friction * pairs.square)
        moments.append([pairs.row_sums(values) for values in products])
    gradient_x, gradient_y, factor, friction = _stacked(blocks)
    xx, xy, yy, moment = (np.concatenate(m) for m in zip(*moments, strict=True))
    return FluidSums(
        gradient=(gradient_x, gradient_y),
        factor=factor,
        friction=friction,
        support=np.stack((row_sums(gradient_x), row_sums(gradient_y))),
        factor_sum=row_sums(factor),
        moment=moment,
        renormalization=np.array([[-yy, xy], [xy, -xx]]) / (xx * yy - xy * xy),
    )


def ghost_sums(
    position: Array, walls: Walls, domain: Domain, discretization: Discretization
) -> GhostSums:
    """Return the sums between points (n_points, 2) [m] and the ghosts of walls."""
    blocks, moments = [], []
    rule = discretization.walls.rule
    nearest = rule.nearest * discretization.particle_spacing
    distance = np.maximum(domain.wall_distance(position), nearest)
    depth = rule.depths(domain, walls.position, discretization)
    for pairs in _pair_blocks(position, walls.position, domain, discretization):
        x, y = pairs.offset
        stretch = 1.0 + depth[pairs.column] / distance[pairs.first + pairs.row]
        weights = (pairs.factor * x, pairs.factor * y, pairs.friction * stretch)
        means = (pairs.kernel, -pairs.kernel * x, -pairs.kernel * y)
        blocks.append([pairs.matrix(v, len(walls.position)) for v in (*weights, *means)])
        moments.append(pairs.row_sums(pairs.friction * pairs.square))
    gradient_x, gradient_y, friction, kernel, head_x, head_y = _stacked(blocks)
    total = row_sums(kernel.T)
    # Ghosts beyond the fluid's reach get zero.
    share = sparse.diags(np.divide(1.0, total, out=np.zeros_like(total), where=total > 0.0))
    mean, mean_x, mean_y = ((share @ m.T).tocsr() for m in (kernel, head_x, head_y))
    return GhostSums(
        gradient=(gradient_x, gradient_y),
        support=np.stack((row_sums(gradient_x), row_sums(gradient_y))),
        friction=friction,
        moment=np.concatenate(moments),
        mean=mean,
        head=(mean_x, mean_y),
        velocity=np.ascontiguousarray(walls.velocity.T),
    )


def mirror_matrix(
    position: Array, mirror: Array, way: Array, domain: Domain, discretization: Discretization
) -> Matrix:
    """Return the matrix (n_ghosts, n_points) of the fits in `sphrom.kernels.mirror_fits`.

    Parameters
    ----------
    position : (n_points, 2) [m] of the fluid.
    mirror, way : (2, n_ghosts) [m] mirror points, and the ways from there to ghosts.
    """
    length = discretization.smoothing_length
    reach = discretization.support_radius
    near = sort_sources(
        np.ascontiguousarray(position.T), domain, reach, discretization.particle_spacing
    )
    n = mirror.shape[1]
    x, y = way / length
    mirrors = mirror_fits.Mirrors(mirror, np.arange(n + 1), np.arange(n), way / length)
    inverse = np.empty((6, n))
    values_of_x = np.empty(n)
    search = near.search(reach, length)
    mirror_fits.fits(mirrors, near.place, near.place[0], search, inverse, values_of_x)
    fits = inverse[:3] + inverse[[1, 3, 4]] * x + inverse[[2, 4, 5]] * y
    blocks = []
    for pairs in _pair_blocks(mirror.T, position, domain, discretization):
        x, y = -pairs.offset / length
        a, bx, by = fits[:, pairs.first + pairs.row]
        values = length**2 * pairs.kernel * (a + bx * x + by * y)
        blocks.append(pairs.matrix(values, len(position)))
    return sparse.vstack(blocks, "csr")


def _stacked(blocks: Iterable[Sequence[Matrix]]) -> list[Matrix]:
    """Return matrices of all points from those of blocks of points."""
    return [sparse.vstack(block, "csr") for block in zip(*blocks, strict=True)]


def row_sums(matrix: Matrix) -> Array:
    """Return the sums (n_rows,) of a matrix's rows."""
    return np.asarray(matrix.sum(axis=1)).ravel()
