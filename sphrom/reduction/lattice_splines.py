"""Tensor-product cubic B-splines of the trial basis through the points of a lattice.

If the reference points form a lattice and the fluid fills a box, one spline for the whole box can
replace the polyharmonic splines of Eq. 3.17. It is twice continuously differentiable: an evaluation
uses 16 coefficients instead of the 81 points of a cell, and nothing jumps between cells. Both are
of fourth order in values and third order in gradients. In three dimensions it uses 64, and
the rows of nodes are in order of layers.

Points are cell centres, half a spacing from the edges of the box. Along a periodic axis the spline
is periodic. Along any other axis its third derivative is continuous at the second point from each
end (not a knot), and the polynomial of the first cell extends over the half spacing to the wall and
beyond it. Cubic polynomials are therefore reproduced exactly up to the walls.
"""

from __future__ import annotations

import math
from dataclasses import field, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_banded

from sphrom.arrays import Array
from sphrom.kernels import bspline, space_splines
from sphrom.reduction.mode_splines import LatticeCoefficients, ModeSplines, Vector
from sphrom.sph.domain import Domain
from sphrom.sph.lattice import lattice_order

NOT_A_KNOT = (1.0, -4.0, 6.0, -4.0, 1.0)
"""Combination of five successive coefficients that vanishes: the jump of the third derivative."""


class LatticeSplines(LatticeCoefficients, ModeSplines):
    """Splines of `n_columns` functions over a box.

    There are three more nodes than points along a periodic axis, two more along others. Raises
    ValueError if the coefficients do not fit such a lattice.
    """

    domain: Domain
    _axes: tuple[bspline.Axis, ...] = field(init=False, repr=False)
    _flat: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        shape = tuple(self.lattice_shape.tolist())
        nodes = tuple(
            n + (3 if periodic else 2)
            for n, periodic in zip(shape, self.domain.periodic, strict=True)
        )
        if min(shape) < 1 or self.coefficients.shape[:2] != (math.prod(nodes[1:]), nodes[0]):
            raise ValueError(
                f"coefficients {self.coefficients.shape} are not those of {shape} points"
            )
        object.__setattr__(self, "_axes", _cells(self.domain, shape))
        flat = np.ascontiguousarray(self.coefficients).reshape(*nodes[:0:-1], -1)
        object.__setattr__(self, "_flat", flat)

    @property
    def n_columns(self) -> int:
        return self.coefficients.shape[-1]

    def _fill(self, place: Vector, *out: Array) -> None:
        kernels = bspline if len(place) == 2 else space_splines
        sweep = kernels.evaluate if len(out) == 1 else kernels.evaluate_with_gradients
        sweep(*place, *self._axes, self._flat, *out)

    def combine(self, coefficients: ArrayLike) -> LatticeSplines:
        # Row by row: one large product would use several threads.
        return replace(self, coefficients=self.coefficients @ np.asarray(coefficients))

    def first(self, n_modes: int) -> LatticeSplines:
        n_columns = (1 + len(self.lattice_shape)) * n_modes
        return replace(self, coefficients=self.coefficients[..., :n_columns].copy())


def fit_lattice_splines(points: ArrayLike, values: ArrayLike, domain: Domain) -> LatticeSplines:
    """Fit splines through values at the points of a lattice, in any order.

    Parameters
    ----------
    points : (n_points, n_dim) the reference points [m].
    values : (n_points, n_columns), the values of the functions there, such as the modes by field.

    Raises ValueError if the points are not the cell centres of a lattice that fills the box.
    """
    shape, order = lattice_order(domain.wrap(np.asarray(points, dtype=np.float64)), domain)
    nodes = np.asarray(values)[order].reshape(*shape[::-1], -1)
    for axis, periodic in enumerate(domain.periodic[::-1]):
        nodes = _along_first_axis(nodes.swapaxes(0, axis), periodic).swapaxes(0, axis)
    return LatticeSplines(
        lattice_shape=np.array(shape, dtype=np.int64),
        coefficients=np.ascontiguousarray(nodes).reshape(-1, *nodes.shape[-2:]),
        domain=domain,
    )


def _cells(domain: Domain, shape: tuple[int, ...]) -> tuple[bspline.Axis, ...]:
    axes = []
    for lower, length, n_points, periodic in zip(
        domain.lower, domain.lengths, shape, domain.periodic, strict=True
    ):
        spacing = length / n_points
        axes.append(
            bspline.Axis(
                origin=lower + 0.5 * spacing,
                spacing=spacing,
                n_cells=n_points if periodic else n_points - 1,
                period=float(n_points) if periodic else 0.0,
            )
        )
    return tuple(axes)


def _along_first_axis(values: Array, periodic: bool) -> Array:
    """Return the coefficients of the spline through values (n_points, ...) at the points."""
    n_points = len(values)
    if periodic:
        angle = 2.0 * np.pi * np.arange(n_points // 2 + 1) / n_points
        response = (4.0 + 2.0 * np.cos(angle)) / 6.0
        spectrum = np.fft.rfft(values, axis=0) / response.reshape(-1, *(1,) * (values.ndim - 1))
        coefficients = np.fft.irfft(spectrum, n_points, axis=0)
        return coefficients[np.arange(-1, n_points + 2) % n_points]
    matrix = np.zeros((9, n_points + 2))
    # Column j of the matrix is column j of the banded form, and row i is its row 4 + i - j.
    for j, jump in enumerate(NOT_A_KNOT):
        matrix[4 - j, j] = jump
        matrix[8 - j, n_points - 3 + j] = jump
    for offset, weight in ((0, 1.0), (1, 4.0), (2, 1.0)):
        matrix[5 - offset, offset : n_points + offset] = weight / 6.0
    right = np.zeros((n_points + 2, values[0].size))
    right[1:-1] = values.reshape(n_points, -1)
    return np.asarray(solve_banded((4, 4), matrix, right)).reshape(-1, *values.shape[1:])
