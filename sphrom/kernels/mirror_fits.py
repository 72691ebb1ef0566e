"""Linear fits of the fluid's fields around the mirror points of ghosts, which continue them there.

A ghost at x_g has its mirror point m_g in the fluid. The fit weighs the fluid by the kernel around
m_g, and its value at x_g is sum_j W(m_g - x_j) (a_g + b_g . (x_j - m_g)) f_j. Offsets are over the
smoothing length h, and W is the kernel times h^2, so that a_g and b_g have no units. `source` is
laid out as in `sphrom.kernels.fields`.
"""

from __future__ import annotations

from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.cells import Search
from sphrom.kernels.fields import VOLUME, X, vector_at
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.pairs import kernel_of
from sphrom.kernels.sums import over_rows
from sphrom.kernels.vectors import Vector, element, minus, times

Sums = tuple[float, ...]

LEAST_SPREAD = 1e-3
"""Determinant of the covariance, over h^4, below which fluid is too sparse for a slope."""


@term
def _moment_row(
    total: Sums,
    place: Vector,
    target: None,
    source: Array,
    columns: slice,
    given: None,
    inverse_length: float,
) -> Sums:
    places = vector_at(source, X, columns)
    s = sx = sy = sxx = sxy = syy = 0.0
    for k in range(places[0].size):
        ox, oy = times(inverse_length, minus(element(places, k), place))
        w = kernel_of((ox, oy), 1.0)
        s += w
        sx += w * ox
        sy += w * oy
        sxx += w * ox * ox
        sxy += w * ox * oy
        syy += w * oy * oy
    return (
        total[0] + s,
        total[1] + sx,
        total[2] + sy,
        total[3] + sxx,
        total[4] + sxy,
        total[5] + syy,
    )


@parallel
def mirror_fits(mirror: Array, way: Array, source: Array, search: Search, out: Array) -> None:
    """Compute the coefficients of the fits.

    Where the fluid is too sparse for a slope, the fit is its mean; without fluid it is zero.

    Parameters
    ----------
    mirror : (2, n_ghosts) mirror points [m].
    way : (2, n_ghosts) from there to the ghosts [m].
    out : (3, n_ghosts) a, b_x, b_y.
    """
    for i in prange(mirror.shape[1]):
        zeros = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        sums = over_rows(_moment_row, zeros, vector_at(mirror, 0, i), None, source, search, None)
        s, sx, sy, sxx, sxy, syy = sums
        a = bx = by = 0.0
        if s > 0.0:
            mean_x = sx / s
            mean_y = sy / s
            xx = sxx / s - mean_x * mean_x
            xy = sxy / s - mean_x * mean_y
            yy = syy / s - mean_y * mean_y
            spread = xx * yy - xy * xy
            if spread > LEAST_SPREAD:
                ex = way[0, i] * search.inverse_length - mean_x
                ey = way[1, i] * search.inverse_length - mean_y
                bx = (yy * ex - xy * ey) / (spread * s)
                by = (xx * ey - xy * ex) / (spread * s)
            a = 1.0 / s - bx * mean_x - by * mean_y
        out[0, i] = a
        out[1, i] = bx
        out[2, i] = by


@term
def _continued_row(
    total: float,
    place: Vector,
    target: Vector,
    source: Array,
    columns: slice,
    values: Array,
    inverse_length: float,
) -> float:
    places = vector_at(source, X, columns)
    some = values[columns]
    a, bx, by = target
    value = 0.0
    for k in range(some.size):
        ox, oy = times(inverse_length, minus(element(places, k), place))
        value += kernel_of((ox, oy), 1.0) * (a + bx * ox + by * oy) * some[k]
    return total + value


@parallel
def continued(
    mirror: Array, fits: Array, source: Array, values: Array, search: Search, out: Array
) -> None:
    """Compute the values (n_ghosts,) at ghosts of some values (n_sources,) of the fluid."""
    for i in prange(mirror.shape[1]):
        fit = fits[0, i], fits[1, i], fits[2, i]
        place = vector_at(mirror, 0, i)
        out[i] = over_rows(_continued_row, 0.0, place, fit, source, search, values)


@term
def _returned_row(
    total: float,
    place: Vector,
    target: None,
    source: Array,
    columns: slice,
    given: None,
    inverse_length: float,
) -> float:
    places = vector_at(source, 0, columns)
    a = source[2, columns]
    bx = source[3, columns]
    by = source[4, columns]
    value = 0.0
    for k in range(a.size):
        ox, oy = times(inverse_length, minus(place, element(places, k)))
        value += kernel_of((ox, oy), 1.0) * (a[k] + bx[k] * ox + by[k] * oy)
    return total + value


@parallel
def give_back(
    particle: Indices, targets: Indices, source: Array, mirrored: Array, search: Search, out: Array
) -> None:
    """Subtract the transposed continuation of some quantity of ghosts from the fluid, per volume.

    Parameters
    ----------
    particle, targets : (n_sources,), (n_targets,) as in `fields.BesideWalls`.
    mirrored : (5, n_mirrored) the sorted mirror points [m], and their fits times the quantity.
    search : the cells of the mirror points.
    out : (n_particles,) [1/s] for a quantity in [m2/s].
    """
    for t in prange(targets.size):
        j = targets[t]
        place = vector_at(source, X, j)
        value = over_rows(_returned_row, 0.0, place, None, mirrored, search, None)
        out[particle[j]] -= value / source[VOLUME, j]
