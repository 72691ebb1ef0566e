"""Kernel sums between points that never move, and between them and ghosts, as sparse matrices.

Volumes are all the same (V = dx^2). Matrices have a row for each point and a column for each source
unless they say otherwise; a source's periodic images are added up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from sphrom.kernels.pair_weights import weigh
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import Discretization
from sphrom.sph.neighbourhood import periodic_images
from sphrom.sph.walls import Walls

Array = NDArray[np.float64]
Matrix = Any
"""A sparse matrix in compressed rows."""

N_BLOCK_POINTS = 4096
"""Points whose pairs are found at once."""


@dataclass(frozen=True)
class FluidSums:
    """Sums over the fluid's points; matrices are (n_points, n_points)."""

    gradient: tuple[Matrix, Matrix]
    """The kernel's gradient times the volume, by component [1/m]."""
    factor: Matrix
    """The gradient's factor times the volume [1/m2]."""
    support: Array
    """(2, n_points) the gradient's sums [1/m]."""
    factor_sum: Array
    """(n_points,) [1/m2]."""
    renormalization: Array
    """(2, 2, n_points) L of Eq. 2.11."""


@dataclass(frozen=True)
class GhostSums:
    """Sums over ghosts, (n_points, n_ghosts), and over the points around them."""

    gradient: tuple[Matrix, Matrix]
    gradient_back: tuple[Matrix, Matrix]
    """Transposed."""
    factor: Matrix
    support: Array
    """(2, n_points)."""
    factor_sum: Array
    """(n_points,)."""
    mean: Matrix
    """S (n_ghosts, n_points)."""
    mean_back: Matrix
    """Transposed."""
    head: tuple[Matrix, Matrix]
    """(n_ghosts, n_points) S, times what a ghost is apart from a point, by component [m]."""
    velocity: Array
    """(2, n_ghosts) of the walls [m/s]."""


@dataclass(frozen=True)
class _PairBlock:
    """The pairs of a block of points with their sources."""

    n_rows: int
    row: NDArray[np.int64]
    """(n_pairs,) within the block."""
    column: NDArray[np.int64]
    offset: Array
    """(2, n_pairs) [m]."""
    kernel: Array
    factor: Array
    """Times the volume."""

    def matrix(self, values: Array, n_columns: int) -> Matrix:
        """Return the matrix of values (n_pairs,), those of images added up."""
        return sparse.csr_matrix((values, (self.row, self.column)), (self.n_rows, n_columns))


def _pair_blocks(
    targets: Array, sources: Array, domain: Domain, discretization: Discretization
) -> Iterator[_PairBlock]:
    """Find the pairs of targets (n_targets, 2) with sources (n_sources, 2) and their images [m]."""
    reach = discretization.support_radius
    particle, image = periodic_images(sources.T, domain, reach)
    place = sources[particle] + image.T
    tree = cKDTree(place)
    for first in range(0, len(targets), N_BLOCK_POINTS):
        some = targets[first : first + N_BLOCK_POINTS]
        near = cKDTree(some).sparse_distance_matrix(tree, reach, output_type="coo_matrix")
        kernel, factor = np.empty_like(near.data), np.empty_like(near.data)
        weigh(near.data, 1.0 / discretization.smoothing_length, kernel, factor)
        factor *= discretization.particle_spacing**2
        offset = np.ascontiguousarray((some[near.row] - place[near.col]).T)
        yield _PairBlock(len(some), near.row, particle[near.col], offset, kernel, factor)


def fluid_sums(position: Array, domain: Domain, discretization: Discretization) -> FluidSums:
    """Return the sums between points (n_points, 2) [m]."""
    blocks, moments = [], []
    for pairs in _pair_blocks(position, position, domain, discretization):
        x, y = pairs.offset
        wx, wy = pairs.factor * x, pairs.factor * y
        blocks.append([pairs.matrix(values, len(position)) for values in (wx, wy, pairs.factor)])
        moments.append(
            [np.bincount(pairs.row, values, pairs.n_rows) for values in (wx * x, wx * y, wy * y)]
        )
    gradient_x, gradient_y, factor = (sparse.vstack(b, "csr") for b in zip(*blocks, strict=True))
    xx, xy, yy = (np.concatenate(m) for m in zip(*moments, strict=True))
    return FluidSums(
        gradient=(gradient_x, gradient_y),
        factor=factor,
        support=np.stack((_row_sums(gradient_x), _row_sums(gradient_y))),
        factor_sum=_row_sums(factor),
        renormalization=np.array([[-yy, xy], [xy, -xx]]) / (xx * yy - xy * xy),
    )


def ghost_sums(
    position: Array, walls: Walls, domain: Domain, discretization: Discretization
) -> GhostSums:
    """Return the sums between points (n_points, 2) [m] and the ghosts of walls."""
    blocks = []
    for pairs in _pair_blocks(position, walls.position, domain, discretization):
        x, y = pairs.offset
        weights = (pairs.factor * x, pairs.factor * y, pairs.factor)
        means = (pairs.kernel, -pairs.kernel * x, -pairs.kernel * y)
        blocks.append([pairs.matrix(v, len(walls.position)) for v in (*weights, *means)])
    gradient_x, gradient_y, factor, kernel, head_x, head_y = (
        sparse.vstack(block, "csr") for block in zip(*blocks, strict=True)
    )
    total = _row_sums(kernel.T)
    # Ghosts out of the fluid's reach take nothing.
    share = sparse.diags(np.divide(1.0, total, out=np.zeros_like(total), where=total > 0.0))
    mean, mean_x, mean_y = ((share @ m.T).tocsr() for m in (kernel, head_x, head_y))
    return GhostSums(
        gradient=(gradient_x, gradient_y),
        gradient_back=(gradient_x.T.tocsr(), gradient_y.T.tocsr()),
        factor=factor,
        support=np.stack((_row_sums(gradient_x), _row_sums(gradient_y))),
        factor_sum=_row_sums(factor),
        mean=mean,
        mean_back=mean.T.tocsr(),
        head=(mean_x, mean_y),
        velocity=np.ascontiguousarray(walls.velocity.T),
    )


def _row_sums(matrix: Matrix) -> Array:
    return np.asarray(matrix.sum(axis=1)).ravel()
