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

import numpy as np
import scipy.linalg
from scipy.interpolate import BSpline

from sphrom.arrays import Array
from sphrom.declaration import Record, attribute
from sphrom.errors import SphromError

DEGREE = 4
"""Of the splines."""
SMOOTHING = 1.25e-7
"""Weight of the penalty, over the square of the box's area."""


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

    def fit(self, position: Array, velocity: Array) -> tuple[Array, float]:
        """Return coefficients of a snapshot (n_particles, 2), and the residual's relative norm.

        All particles have the same weight. The residual is the noise floor of the snapshot.
        """
        d_x, d_y = self.derivatives(position, (1, 0), (0, 1))
        normal = (d_x.T @ d_x + d_y.T @ d_y) / len(position) + self._penalty()
        right_side = (d_y.T @ velocity[:, 0] - d_x.T @ velocity[:, 1]) / len(position)
        coefficients = scipy.linalg.solve(normal, right_side, assume_a="pos")
        difference = velocity - np.stack([d_y @ coefficients, -(d_x @ coefficients)], axis=-1)
        norm = float(np.linalg.norm(velocity))
        residual = float(np.linalg.norm(difference)) / norm if norm > 0.0 else 0.0
        return np.asarray(coefficients), residual

    def _penalty(self) -> Array:
        """Return the matrix of the integral of |D^3 psi|^2, weighted."""
        x, x_weights = _gauss(_breaks(self.left, self.right, self.n_columns))
        y, y_weights = _gauss(_breaks(self.bottom, self.top, self.n_rows))
        total = np.zeros(())
        for order in range(4):
            along_x, along_y = self._along_x(x, order), self._along_y(y, 3 - order)
            products = [(along_x.T * x_weights) @ along_x, (along_y.T * y_weights) @ along_y]
            total = total + math.comb(3, order) * np.kron(*products)
        return SMOOTHING * self.width * (self.top - self.bottom) * np.asarray(total)

    def _along_x(self, x: Array, order: int) -> Array:
        return _splines(x, _breaks(self.left, self.right, self.n_columns), order)[:, 1:-1]

    def _along_y(self, y: Array, order: int) -> Array:
        return _splines(y, _breaks(self.bottom, self.top, self.n_rows), order)[:, 1:]


def find_elevation(
    position: Array, volume: Array, columns: Array, radius: float, walls: tuple[float, float, float]
) -> Array:
    """Return the heights (n_columns,) [m] where the particles' kernels sum up to one half.

    Parameters
    ----------
    position, volume : (n_particles, 2) [m], (n_particles,) [m2].
    columns : (n_columns,) [m], along x.
    radius : of the kernel's support [m].
    walls : left, right and bottom [m]; images of the particles complete the sums there.

    Raises
    ------
    SphromError
        If a column has no fluid or more than one surface; the message says where.
    """
    left, right, bottom = walls
    mirrored = [position, position * [-1, 1] + [2 * left, 0], position * [-1, 1] + [2 * right, 0]]
    points = np.concatenate(mirrored)
    points = np.concatenate([points, points * [1, -1] + [0, 2 * bottom]])
    volumes = np.tile(volume, 6)
    heights = np.arange(bottom, position[:, 1].max() + radius, radius / 16)
    out = np.empty(len(columns))
    for number, x in enumerate(columns):
        near = np.abs(points[:, 0] - x) < radius
        offset = np.hypot(points[near, 0] - x, heights[:, None] - points[near, 1]) / radius
        within = np.clip(1 - offset, 0, None)
        kernel = 7 / (math.pi * radius**2) * within**4 * (1 + 4 * offset)
        excess = kernel @ volumes[near] - 0.5
        crossings = np.flatnonzero((excess[:-1] > 0) != (excess[1:] > 0))
        if len(crossings) != 1 or excess[0] <= 0:
            found = "no fluid" if excess.max() <= 0 else "more than one surface"
            raise SphromError(f"The column x = {x:.4g} m has {found}.")
        at = crossings[0]
        share = excess[at] / (excess[at] - excess[at + 1])
        out[number] = heights[at] + share * (heights[at + 1] - heights[at])
    return out


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
    spline = BSpline(knots, np.eye(len(knots) - DEGREE - 1), DEGREE)
    return np.asarray(spline(places, nu=order))


def _gauss(breaks: Array) -> tuple[Array, Array]:
    """Return points and weights that integrate the square of a spline exactly."""
    nodes, weights = np.polynomial.legendre.leggauss(DEGREE + 1)
    half = np.diff(breaks)[:, None] / 2
    return (breaks[:-1, None] + half * (1 + nodes)).ravel(), (half * weights).ravel()
