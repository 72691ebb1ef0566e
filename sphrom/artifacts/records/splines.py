"""Splines of the modes."""

from __future__ import annotations

from collections.abc import Mapping

from sphrom.artifacts.declaration import Array, Indices, Record, attribute, dataset, part


class CellSplines(Record):
    """The local polyharmonic splines of one basis."""

    cell_shape: Indices = dataset(
        "component", "1", "number of cells along each direction", equation="Alg. 3.2"
    )
    cell_start: Indices = dataset(
        "cell_boundary", "1", "first point of each cell's system, and one past the last",
        equation="Alg. 3.3",
    )
    points: Array = dataset(
        "component point", "cell widths", "points of each cell's system, from the cell's centre",
        "x_G", "Eq. 3.17",
    )
    radial_weights: Array = dataset(
        "column point", "of the modes",
        "weights of the radial functions, a column for each mode and field", "xi", "Eq. 3.19",
    )
    polynomial_weights: Array = dataset(
        "cell term column", "of the modes", "weights of the polynomial", "eta", "Eq. 3.19"
    )
    condition_number: Array = dataset(
        "cell", "1",
        "condition number of each cell's system; zero where a cell in the solid has none",
        equation="Eq. 3.19",
    )


class Spline(Record, kind="sphrom/spline"):
    """Local polyharmonic splines of the modes, by cell."""

    bases: Mapping[str, CellSplines] = part(at_least_one=True)
    spline_order: int = attribute("1", "k of Eq. 3.18")
    polynomial_degree: int = attribute("1", "degree of the polynomial of Eq. 3.17")


class LatticeSplines(Record):
    """The B-splines of one basis."""

    lattice_shape: Indices = dataset(
        "component", "1", "number of reference points along each direction"
    )
    coefficients: Array = dataset(
        "node_row node column", "of the modes",
        "what the B-splines around each point are multiplied with, for each mode and field",
        equation="Eq. 3.20",
    )


class BSpline(Record, kind="sphrom/b-spline"):
    """Tensor-product cubic B-splines of the modes, on a lattice."""

    bases: Mapping[str, LatticeSplines] = part(at_least_one=True)
