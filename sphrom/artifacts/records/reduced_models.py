"""Trial bases, projected right-hand sides with the data for error estimates, and splines of modes:
the artifacts of the stages pod, operators and fit-psi.

Most fields are declared by records of the numerics. `sphrom.models` reads them.
"""

from __future__ import annotations

from collections.abc import Mapping

from sphrom.arrays import Array, Indices
from sphrom.artifacts.records.runs import REFERENCE_POSITION, Medium
from sphrom.declaration import Record, attribute, dataset, labelled, part
from sphrom.metrics.quantities import FROM_FIELDS, stored
from sphrom.reduction.held_out import OF_FIELDS, FieldProducts, OutputShares, UnheldShares
from sphrom.reduction.mode_splines import CellSplines, LatticeCoefficients
from sphrom.reduction.own_pressure import PressureSpace
from sphrom.reduction.reduced_measures import ReducedForce, ReducedMeasure
from sphrom.reduction.reduced_operators import MemoryOperators, ReducedOperators, ResidualFactor
from sphrom.reduction.surface_basis import SurfaceBasis, TrainedGraph
from sphrom.reduction.trained_basis import TrainedBasis
from sphrom.reduction.trial_basis import Modes, StoredBasis


class Basis(Medium, kind="sphrom/basis"):
    """Trial bases and their singular values."""

    reference_position: Array = labelled("particle component", REFERENCE_POSITION)
    volume: Array = dataset(
        "particle", "m2", "area or volume represented by each point", "V", "Eq. 3.15", in_space="m3"
    )
    mean_density_fluctuation: Mapping[str, Array] = dataset(
        "snapshot",
        "kg/m3",
        "spatial mean of each snapshot of a training run, if it is subtracted as a separate "
        "variable",
        default_factory=dict,
    )
    bases: Mapping[str, StoredBasis] = part()
    train: Mapping[str, Array] = dataset(
        "training_run parameter",
        "of the parameters",
        "parameter values of the training runs",
        "mu",
        "Eq. 2.17",
        at="bases/*/train",
    )
    lagrangian: Mapping[str, Modes] = part(default_factory=dict)
    lagrangian_position: Array | None = dataset(
        "particle component",
        "m",
        "start positions of the particles of the Lagrangian modes",
        "x",
        "Eq. 3.13",
        default=None,
    )
    inner_product: str = attribute("", "inner product of the modes")


class WallForce(ReducedForce):
    """A projected force, and the recorded forces of training runs."""

    training_loads: Array = dataset(
        "run snapshot part load",
        "N/m, N of the torque",
        "pressure and viscous force in the full training runs, for corrections",
    )


class TrainedMeasure(ReducedMeasure):
    """A projected measurement, and its recorded values in the full training runs."""

    training: Mapping[str, Array] = stored(
        FROM_FIELDS, "run snapshot", at="training_{}", meaning="of training runs: {}"
    )


class Estimate(FieldProducts):
    """The data to which error estimates are fitted."""

    unheld: UnheldShares = part()
    outputs: Mapping[str, OutputShares] = part(default_factory=dict)
    start: Array = dataset(
        "training_run mode",
        "of the inner product",
        "coordinates at the start of each training run",
    )


class HeldOut(Record):
    """Numbers of modes chosen by held-out training runs, for calibrated Galerkin models."""

    integrated: Indices = dataset(
        "size",
        "1",
        "number of modes to integrate in models with 1, 2, ... modes; the other modes are "
        "predicted from training runs",
    )
    error: Array = dataset(
        "size field",
        "1",
        "expected relative error of such models between training runs" + OF_FIELDS,
    )


class BasisOperators(Record):
    """The operators of one basis."""

    rates: ReducedOperators = part(at="")
    states: Array = dataset(
        "state mode",
        "of the inner product",
        "coordinates of some training snapshots, around which steps must be stable",
        "omega-hat",
        "Eq. 3.11",
    )
    training_runs: Array | None = dataset(
        "run snapshot mode",
        "of the inner product",
        "coordinates of all training snapshots of the basis, for calibration and correction",
        "omega-hat",
        "Eq. 3.11",
        default=None,
    )
    residual: ResidualFactor | None = part(default=None)
    estimate: Estimate | None = part(default=None)
    held_out: HeldOut | None = part(default=None)
    memory: Mapping[str, MemoryOperators] = part()
    wall_force: Mapping[str, WallForce] = part(default_factory=dict)
    measure: Mapping[str, TrainedMeasure] = part(default_factory=dict)
    pressure: PressureSpace | None = part(default=None)
    skewness: float = attribute("1", "asymmetry of the acoustic part; zero if it is skew")


class Starts(Record):
    """Starts of runs, mapped onto the reference points."""

    parameters: Array = dataset("start parameter", "1", "parameter values of each start")
    density_fluctuation: Array = dataset(
        "start particle", "kg/m3", "density minus the reference density", "rho'", "Eq. 3.15"
    )
    velocity: Array = dataset("start particle component", "m/s", "velocity", "u", "Eq. 3.15")


class PressureSplines(Record):
    """Splines of pressure modes, of one of two kinds."""

    cells: CellSplines | None = part(at="", default=None)
    lattice: LatticeCoefficients | None = part(at="", default=None)


class Operators(Record, kind="sphrom/operators"):
    """Right-hand side on the reference points, projected onto each basis."""

    bases: Mapping[str, BasisOperators] = part()
    starts: Starts | None = part(default=None)
    pressure_splines: Mapping[str, PressureSplines] = part(default_factory=dict)
    walls_driven: int = attribute("", "1 if the amplitude multiplies the walls' speed, else 0")


class HistoryTable(Record):
    """A measured history of a case, identified by its file's digest and its columns' names."""

    rows: Array = dataset(
        "column row",
        "s, of the history",
        "times and values, with a row before the first and after the last",
    )
    sha256: str = attribute("", "digest of the file")
    time: str | None = attribute("", "column of the times, if the case names one", default=None)
    value: str | None = attribute("", "column of the values, if the case names one", default=None)


class ModelFile(Medium):
    """Data of a case that its trained models need, too."""

    model: str = attribute("", "name of the model")
    histories: Mapping[str, HistoryTable] = part(default_factory=dict)


class TrainedModel(ModelFile, kind="sphrom/model"):
    """A trained model, with the data for runs at any parameters."""

    bases: Mapping[str, TrainedBasis] = part()
    modes: Mapping[str, StoredBasis] = part(at="modes/*")
    volume: Array = dataset(
        "particle", "m2", "area or volume represented by each point", "V", "Eq. 3.15", in_space="m3"
    )
    reference_position: Array = labelled("particle component", REFERENCE_POSITION)
    starts: Starts | None = part(default=None)


class Spline(Record, kind="sphrom/spline"):
    """Local polyharmonic splines of the modes, by cell."""

    bases: Mapping[str, CellSplines] = part()
    spline_order: int = attribute("1", "k of Eq. 3.18")
    polynomial_degree: int = attribute("1", "degree of the polynomial of Eq. 3.17")


class BSpline(Record, kind="sphrom/b-spline"):
    """Tensor-product cubic B-splines of the modes, on a lattice."""

    bases: Mapping[str, LatticeCoefficients] = part()


class StoredSurfaceBasis(SurfaceBasis):
    """A basis and the singular values of its snapshots."""

    singular_values: Mapping[str, Array] = dataset(
        "singular_value", "m2/s", "singular values of the snapshots", "sigma", "Eq. 3.16"
    )


class SurfaceBases(Medium, kind="sphrom/surface-basis"):
    """Modes of stream functions and elevations."""

    bases: Mapping[str, StoredSurfaceBasis] = part()


class SurfaceModels(Record, kind="sphrom/surface-operators"):
    """Reduced models of a flow with a free surface, trained for some numbers of modes."""

    sizes: Mapping[str, TrainedGraph] = part(at="sizes/*")


class SurfaceStarts(Record):
    """Starts of runs of a model with a free surface."""

    parameters: Array = dataset("start parameter", "1", "parameter values of each start")
    coordinates: Array = dataset(
        "start coordinate", "of the modes, m", "coordinates of the velocity and of the elevation"
    )


class TrainedSurfaceModel(ModelFile, kind="sphrom/surface-model"):
    """A trained model of a flow with a free surface, with the data for its runs."""

    basis: SurfaceBasis = part()
    graph: TrainedGraph = part()
    starts: SurfaceStarts | None = part(default=None)
