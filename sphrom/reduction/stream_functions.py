"""Velocity fields with a stream function, below a surface that is the graph of an elevation.

A stream function psi is a tensor product of quartic B-splines on a box, and the velocity is
u = (d_y psi, -d_x psi): free of divergence, and tangential to the left, right and bottom walls,
where psi is zero. A fit to particles minimises the mean square difference of velocities and a
penalty on the third derivatives, which continues the field smoothly above the surface.

The elevation y = eta(x) has coordinates: those of cosines j pi x/L, j >= 1, about the mean depth.
A cosine has no mean, so that the volume is exact.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from sphrom.arrays import Array
from sphrom.declaration import Record, attribute

DEGREE = 4
"""Degree of the splines."""
SMOOTHING = 1.25e-7
"""Weight of the penalty, relative to the square of the box's area."""


class StreamSpace(Record):
    """Stream functions (n_coefficients,) on a box, zero on its left, right and bottom sides."""

    left: float = attribute("m", "left wall")
    right: float = attribute("m", "right wall")
    bottom: float = attribute("m", "bottom wall")
    top: float = attribute("m", "upper end of the splines, above the highest crest")
    n_columns: int = attribute("1", "cells along x")
    n_rows: int = attribute("1", "cells along y")

    @property
    def width(self) -> float:
        """Distance between the walls [m]."""
        return self.right - self.left

    @property
    def n_coefficients(self) -> int:
        """The number of splines."""
        return (self.n_columns + DEGREE - 2) * (self.n_rows + DEGREE - 1)

    def derivatives(self, points: Array, *orders: tuple[int, int]) -> list[Array]:
        """Return matrices (n_points, n_coefficients) of derivatives along x and y at points."""
        along_x = {k: self._along_x(points[:, 0], k) for k in {k for k, _ in orders}}
        along_y = {k: self._along_y(points[:, 1], k) for k in {k for _, k in orders}}
        return [
            np.einsum("pi,pj->pij", along_x[i], along_y[j]).reshape(len(points), -1)
            for i, j in orders
        ]

    def velocity(self, coefficients: Array, points: Array) -> Array:
        """Return velocities (..., n_points, 2) [m/s] of coefficients (..., n_coefficients)."""
        d_x, d_y = self.derivatives(points, (1, 0), (0, 1))
        return np.stack([coefficients @ d_y.T, -(coefficients @ d_x.T)], axis=-1)

    def along(
        self, modes: Array, factors: Array, x: Array, y: Array, *orders: tuple[int, int]
    ) -> list[Array]:
        """Return derivatives (n, n_places, n_heights) of n sums of modes along vertical lines.

        Parameters
        ----------
        modes : (n_modes, n_coefficients) stream functions.
        factors : (n, n_modes), which multiply the modes.
        x : (n_places,) [m], of the lines.
        y : (n, n_places, n_heights) [m], the heights for each sum and line.
        """
        middles, along_y = _rows(self)
        along = (y - self.bottom) * (self.n_rows / (self.top - self.bottom))
        row = np.clip(along, 0, self.n_rows - 1).astype(np.intp)
        lines = np.arange(row[..., 0].size).reshape(*row.shape[:2], 1)
        places = lines * self.n_rows + row
        grid = modes.reshape(len(modes), self.n_columns + DEGREE - 2, -1)
        found = []
        for i, j in orders:
            of_modes = self._along_x(x, i) @ (grid @ polyder(along_y, j))
            of_rows = factors @ of_modes.reshape(*of_modes.shape[:2], -1)
            taken = np.take(of_rows.reshape(len(of_rows), -1), places, axis=1)
            values = polyval(y - middles[row], taken, tensor=False)
            found.append(np.asarray(values, dtype=np.float64))
        return found

    def fit(self, position: Array, velocity: Array) -> tuple[Array, float]:
        """Return coefficients of a snapshot (n_particles, 2), and the residual's relative norm.

        All particles have the same weight. The residual is the noise floor of the snapshot.
        """
        d_x, d_y = self.derivatives(position, (1, 0), (0, 1))
        normal = (d_x.T @ d_x + d_y.T @ d_y) / len(position) + _penalty(self)
        right_side = (d_y.T @ velocity[:, 0] - d_x.T @ velocity[:, 1]) / len(position)
        coefficients = np.linalg.solve(normal, right_side)
        difference = velocity - np.stack([d_y @ coefficients, -(d_x @ coefficients)], axis=-1)
        norm = float(np.linalg.norm(velocity))
        residual = float(np.linalg.norm(difference)) / norm if norm > 0.0 else 0.0
        return np.asarray(coefficients), residual

    def _along_x(self, x: Array, order: int) -> Array:
        return _splines(x, _breaks(self.left, self.right, self.n_columns), order)[:, 1:-1]

    def _along_y(self, y: Array, order: int) -> Array:
        return _splines(y, _breaks(self.bottom, self.top, self.n_rows), order)[:, 1:]


@lru_cache(maxsize=8)
def _rows(space: StreamSpace) -> tuple[Array, Array]:
    """Return the middles (n_rows,) of rows, and splines as polynomials of y about them."""
    breaks = _breaks(space.bottom, space.top, space.n_rows)
    middles = 0.5 * (breaks[:-1] + breaks[1:])
    derivatives = [space._along_y(middles, k).T[None] for k in range(DEGREE + 1)]
    along_y = [each / math.factorial(k) for k, each in enumerate(derivatives)]
    return middles, np.stack(along_y)


@lru_cache(maxsize=8)
def _penalty(space: StreamSpace) -> Array:
    """Return the matrix of the integral of |D^3 psi|^2, weighted."""
    x, x_weights = _gauss(_breaks(space.left, space.right, space.n_columns))
    y, y_weights = _gauss(_breaks(space.bottom, space.top, space.n_rows))
    total = np.zeros(())
    for order in range(4):
        along_x = space._along_x(x, order)
        along_y = space._along_y(y, 3 - order)
        products = [(along_x.T * x_weights) @ along_x, (along_y.T * y_weights) @ along_y]
        total = total + math.comb(3, order) * np.kron(*products)
    return SMOOTHING * space.width * (space.top - space.bottom) * np.asarray(total)


def cosine_coordinates(elevation: Array, n_cosines: int) -> Array:
    """Return the amplitudes (..., n_cosines) [m] of elevations (..., n_columns) at midpoints."""
    n_columns = elevation.shape[-1]
    phase = math.pi * (np.arange(n_columns) + 0.5) / n_columns
    return np.asarray(elevation @ np.cos(np.outer(phase, np.arange(1, n_cosines + 1)))) * (
        2 / n_columns
    )


def _breaks(start: float, end: float, n_cells: int) -> Array:
    return np.linspace(start, end, n_cells + 1)


def _splines(places: Array, breaks: Array, order: int) -> Array:
    """Return derivatives of all B-splines at places; beyond the breaks, polynomials go on."""
    knots = np.concatenate([[breaks[0]] * DEGREE, breaks, [breaks[-1]] * DEGREE])
    from scipy.interpolate import BSpline  # it takes long to load, and few scenes need it

    spline = BSpline(knots, np.eye(len(knots) - DEGREE - 1), DEGREE)
    return np.asarray(spline(places, nu=order))


def _gauss(breaks: Array) -> tuple[Array, Array]:
    """Return points and weights that integrate the square of a spline exactly."""
    nodes, weights = np.polynomial.legendre.leggauss(DEGREE + 1)
    half = np.diff(breaks)[:, None] / 2
    return (breaks[:-1, None] + half * (1 + nodes)).ravel(), (half * weights).ravel()
