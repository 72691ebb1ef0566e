"""Wendland's C2 kernel in two or three dimensions, with smoothing length h and support radius 2 h.

W = 7 / (4 pi h^2) (1 - q/2)^4 (2 q + 1) with q = r/h in two dimensions (Wendland 1995); in three,
the factor is 21 / (16 pi h^3). Its gradient is a factor times the offset, so neither needs a
division by the distance. Both vanish beyond the support without a branch. All have the precision of
the distance.
"""

from __future__ import annotations

import math

from numba import prange

from sphrom.arrays import Array
from sphrom.kernels.jit import like, parallel, term

LAPLACIAN_SHAPE = 55.0 / 84.0
"""b of `laplacian_weight`, in two dimensions: the integral of q^5 (1 - q/2)^3 divided by that of
q^7."""
LAPLACIAN_SHAPE_IN_SPACE = 33.0 / 56.0
"""The same in three dimensions: the integral of q^6 (1 - q/2)^3 divided by that of
q^8."""


@term
def kernel(distance: float, inverse_length: float, n_dim: int = 2) -> float:
    """Return W [m^-n] at a distance [m], from 1/h [1/m]."""
    one = like(1.0, distance)
    reach = max(like(0.0, one), one - like(0.5, one) * distance * inverse_length)
    square = reach * reach
    norm = like(7.0 / (4.0 * math.pi), one) * inverse_length * inverse_length
    if n_dim == 3:
        norm *= like(0.75, one) * inverse_length
    return norm * square * square * (like(2.0, one) * distance * inverse_length + one)


@term
def gradient_factor(distance: float, inverse_length: float, n_dim: int = 2) -> float:
    """Return F [m^-(n+2)], where the kernel's gradient is F times the offset x_i - x_j."""
    one = like(1.0, distance)
    reach = max(like(0.0, one), one - like(0.5, one) * distance * inverse_length)
    square = inverse_length * inverse_length
    norm = like(-35.0 / (4.0 * math.pi), one) * square * square
    if n_dim == 3:
        norm *= like(0.75, one) * inverse_length
    return norm * reach * reach * reach


@term
def laplacian_weight(square: float, inverse_length: float, n_dim: int = 2) -> float:
    """Return the weight 1 - b q^2 of F in sums for the Laplacian, at a squared distance [m2].

    Without the weight the sums are of second order in h, because of their fourth moment. The weight
    makes it vanish: the sums are of fourth order, and still damp waves of any length.
    """
    shape = LAPLACIAN_SHAPE if n_dim == 2 else LAPLACIAN_SHAPE_IN_SPACE
    return like(1.0, square) - like(shape, square) * square * inverse_length * inverse_length


@parallel
def weigh(distance: Array, inverse_length: float, values: Array, factors: Array) -> None:
    """Compute W [1/m2] and F [1/m4] (n_pairs,) at distances (n_pairs,) [m]."""
    for k in prange(distance.size):
        values[k] = kernel(distance[k], inverse_length)
        factors[k] = gradient_factor(distance[k], inverse_length)
