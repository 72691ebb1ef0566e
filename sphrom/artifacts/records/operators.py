"""Projected right-hand sides with the data for error estimates, and splines of modes."""

from __future__ import annotations

from collections.abc import Mapping

from sphrom.artifacts.declaration import (
    Array,
    Indices,
    Record,
    Tensors,
    attribute,
    dataset,
    part,
    tensors,
)

VISCOSITY = " per m2/s of viscosity"
WALLS = f"{VISCOSITY}, at the walls' speed"
FORCE = " per amplitude of the body force"
VALUE = ", per unit of the parameter"
_RATES = "of the modes, /s"
_LOADS = "N/m, N of the torque, of the terms"
_PART = "part of the reduced rates by"
_CLOSURE = (
    "part of what a closure with so many modes adds, per memory length, by the power of the "
    "viscosity [m2/s]"
)
_LEFT_OUT = (
    "what projection leaves out of the rates by {}: times monomials of coordinates, a vector with "
    "the residual's norm"
)
_UNHELD = (
    "root mean square error of the best approximation over the change {}, of training snapshots "
    "left out of a basis of 1, 2, ... modes; of the velocity, then of c0 rho'/rho0 less its mean"
)
_OF_FIELDS = ", of velocity and of c0 rho'/rho0 less its mean"


class DriveRates(Record):
    """The reduced rates that one parameter gives by walls and by the body force."""

    walls: Tensors | None = tensors(
        1, _RATES + WALLS + VALUE, f"{_PART} walls", "Eq. 3.21", symbols="cA", default=None
    )
    force: Tensors | None = tensors(
        1, _RATES + FORCE + VALUE, f"{_PART} force", "Eq. 3.21", symbols="cA", default=None
    )


class Rates(Record):
    """The reduced rates of one basis, as polynomials of its coordinates."""

    inertia: Tensors = tensors(2, _RATES, f"{_PART} inertia", "Eq. 3.21", symbols="cAH")
    viscosity: Tensors = tensors(
        2, _RATES + VISCOSITY, f"{_PART} viscosity", "Eq. 3.21", symbols="cAH"
    )
    walls: Tensors | None = tensors(
        1, _RATES + WALLS, f"{_PART} walls", "Eq. 3.21", symbols="cA", default=None
    )
    force: Tensors | None = tensors(
        1, _RATES + FORCE, f"{_PART} force", "Eq. 3.21", symbols="cA", default=None
    )
    acoustic: Array = dataset(
        "mode mode", _RATES, "what pressure and divergence alone are of the linear part",
        equation="Eq. 3.21",
    )
    drives: Mapping[str, DriveRates] = part(default_factory=dict)


class DriveForce(Record):
    """The force and the torque that one parameter gives by walls and by the body force."""

    walls: Array | None = dataset(
        "load", _LOADS + WALLS + VALUE, "by walls that move", default=None
    )
    force: Array | None = dataset(
        "load term", _LOADS + FORCE + VALUE, "by the heads of the body force", default=None
    )


class WallForce(Record):
    """The force along x and y [N/m] and the torque [N] on a wall, linear in the coordinates.

    Terms are one, the mean of the density fluctuation that is carried apart, and the coordinates.
    """

    pressure: Array = dataset("load term", _LOADS, "by the pressure")
    viscous: Array = dataset("load term", _LOADS + VISCOSITY, "by the viscosity")
    walls: Array = dataset("load", _LOADS + WALLS, "by walls that move")
    body_force: Array | None = dataset(
        "load term", _LOADS + FORCE, "by the heads of the body force at walls", default=None
    )
    training_loads: Array = dataset(
        "run snapshot part load",
        "N/m, N of the torque",
        "pressure's and viscous force in the full runs that it learnt from, to calibrate with",
    )
    drives: Mapping[str, DriveForce] = part(default_factory=dict)


class MeasuredTerms(Record):
    """What is measured in the fluid, linear in the terms that forces have too."""

    flow_rate: Array | None = dataset(
        "term", "m2/s, of the terms", "flow through a section", default=None
    )
    velocity: Array | None = dataset(
        "place component term", "m/s, of the terms", "velocity at places", default=None
    )
    pressure: Array | None = dataset(
        "place term", "Pa, of the terms", "pressure at places", default=None
    )


class Memory(Record):
    """What a closure with so many modes adds to the rates."""

    steady: Tensors = tensors(
        3, "of the modes, /s2", _CLOSURE, "Eq. 3.22", by="viscosity_power", at=""
    )
    force: Tensors | None = tensors(
        2, f"of the modes, /s2{FORCE}", _CLOSURE, "Eq. 3.22", by="viscosity_power", default=None
    )
    force_squared: Tensors | None = tensors(
        1, "of the modes, /s2 per squared amplitude of the body force", _CLOSURE, "Eq. 3.22",
        by="viscosity_power", default=None,
    )


class DriveResidual(Record):
    """What projection leaves out of the rates that one parameter gives."""

    walls: Array | None = dataset(
        "direction linear_monomial",
        f"of the inner product, /s{WALLS}{VALUE}",
        _LEFT_OUT.format("walls"),
        default=None,
    )
    force: Array | None = dataset(
        "direction linear_monomial",
        f"of the inner product, /s{FORCE}{VALUE}",
        _LEFT_OUT.format("force"),
        default=None,
    )


class Residual(Record):
    """What projection leaves out of the rates."""

    inertia: Array = dataset(
        "direction monomial", "of the inner product, /s", _LEFT_OUT.format("inertia")
    )
    viscosity: Array = dataset(
        "direction monomial", f"of the inner product, /s{VISCOSITY}", _LEFT_OUT.format("viscosity"),
    )
    walls: Array | None = dataset(
        "direction linear_monomial", f"of the inner product, /s{WALLS}", _LEFT_OUT.format("walls"),
        default=None,
    )
    force: Array | None = dataset(
        "direction linear_monomial", f"of the inner product, /s{FORCE}", _LEFT_OUT.format("force"),
        default=None,
    )
    drives: Mapping[str, DriveResidual] = part(default_factory=dict)


class Unheld(Record):
    """What bases hold of training snapshots that they haven't learnt."""

    parameters: Array = dataset(
        "size field", "m/s over the inner product's",
        _UNHELD.format("from the other training runs"),
    )
    time: Array = dataset(
        "run size field", "m/s over the inner product's", _UNHELD.format("since half time")
    )


class Estimate(Record):
    """What estimates of errors are fitted to."""

    unheld: Unheld = part()
    start: Array = dataset(
        "training_run mode", "of the inner product",
        "coordinates at the start of each training run",
    )
    gram: Array = dataset(
        "field column column", "of the modes",
        "mean products of modes and of the constant part of states with each other" + _OF_FIELDS,
    )
    projections: Array = dataset(
        "training_run compared_snapshot field column", "of the modes",
        "mean products of some training snapshots with them" + _OF_FIELDS,
    )
    squares: Array = dataset(
        "training_run compared_snapshot field", "m2/s2",
        "mean squares of those snapshots" + _OF_FIELDS,
    )


class HeldOut(Record):
    """Models that training runs, each held out in turn, choose; calibrated ones with Galerkin."""

    integrated: Indices = dataset(
        "size", "1",
        "number of modes to integrate of models with 1, 2, ... modes; training runs predict the "
        "others",
    )
    error: Array | None = dataset(
        "size field", "1",
        "error over the field's size of such models calibrated without the run held out, where a "
        "model asks for the number of modes" + _OF_FIELDS, default=None,
    )


class BasisOperators(Record):
    """The operators of one basis."""

    rates: Rates = part(at="")
    states: Array = dataset(
        "state mode", "of the inner product",
        "coordinates of some training snapshots, around which steps have to be stable", "omega-hat",
        "Eq. 3.11",
    )
    training_runs: Array | None = dataset(
        "run snapshot mode", "of the inner product",
        "coordinates of all snapshots that the basis learnt from, to calibrate and correct with",
        "omega-hat", "Eq. 3.11", default=None,
    )
    training_means: Array | None = dataset(
        "run snapshot",
        "kg/m3",
        "mean density fluctuations of these snapshots that are carried apart, with forces",
        default=None,
    )
    residual: Residual | None = part(default=None)
    estimate: Estimate | None = part(default=None)
    held_out: HeldOut | None = part(default=None)
    memory: Mapping[str, Memory] = part()
    wall_force: Mapping[str, WallForce] = part(default_factory=dict)
    measure: Mapping[str, MeasuredTerms] = part(default_factory=dict)
    skewness: float = attribute("1", "of the acoustic part; zero is skew")
    expansion_error: float = attribute("1", "largest that expanding 1/rho makes in rates")


class Starts(Record):
    """Starts of runs, mapped onto the reference points."""

    parameters: Array = dataset(
        "start parameter", "1", "values of the parameters that each start belongs to"
    )
    density_fluctuation: Array = dataset(
        "start particle", "kg/m3", "density minus the reference density", "rho'", "Eq. 3.15"
    )
    velocity: Array = dataset("start particle component", "m/s", "velocity", "u", "Eq. 3.15")


class Operators(Record, kind="sphrom/operators"):
    """Right-hand side on the reference points, projected onto each basis."""

    bases: Mapping[str, BasisOperators] = part(at_least_one=True)
    starts: Starts | None = part(default=None)
    density_order: int = attribute("", "to which 1/rho is expanded")
    walls_driven: int = attribute("", "1 where the amplitude is that of the walls' speed, else 0")


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
