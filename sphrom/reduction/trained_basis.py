"""A trained model with one basis, as one record: the data for runs at any parameters.

Training runs determine a model's calibration, the corrections of its coordinates and forces, the
linear parts of its steps, and the fit of its error estimates. `sphrom.models.points`
makes the record, and builds models at parameter points from it, without another look at training
runs.

A model that integrates only its leading modes has two sets of rates: those of all modes serve runs
that are longer than the training runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.declaration import Record, attribute, dataset, labelled, part
from sphrom.metrics.quantities import FROM_FIELDS, OF_WALLS, stored
from sphrom.reduction.calibration import Calibration
from sphrom.reduction.correction import PLACES, Correction
from sphrom.reduction.cycle_fits import Harmonics
from sphrom.reduction.error_calibration import ErrorCalibration
from sphrom.reduction.held_out import FieldProducts, OutputShares
from sphrom.reduction.limit_cycles import CycleClosure, TrainedCycles
from sphrom.reduction.own_pressure import OwnPressure
from sphrom.reduction.reduced_measures import ReducedForce, ReducedMeasure
from sphrom.reduction.reduced_operators import (
    MemoryOperators,
    Polynomial,
    ReducedOperators,
    ResidualFactor,
)
from sphrom.sph.fluid import Factors

if TYPE_CHECKING:
    from sphrom.reduction.exponential_steps import LinearPart

ALL_MODES, LEADING = "all", "leading"
"""The names of the rates of all modes, and of those of the modes that are integrated."""
_DIFFERENCE = "of held-out training runs, full minus predicted"


class TrainedRates(Record):
    """The rates of some modes with the terms that training runs add."""

    projected: ReducedOperators = part()
    walls_driven: int = attribute("", "1 if walls move with the amplitude, else 0")
    memory: MemoryOperators | None = part(default=None)
    calibration: Calibration | None = part(default=None)
    cycles: TrainedCycles | None = part(default=None)
    linear: Array = dataset(
        "run mode mode", "/s", "linear part of exponential steps near each training point", "L"
    )
    states: Array = dataset(
        "state mode", "of the inner product",
        "coordinates of some training snapshots, around which steps must be stable",
    )  # fmt: skip

    @cached_property
    def operators(self) -> ReducedOperators:
        """The projected rates."""
        return replace(self.projected, walls_driven=bool(self.walls_driven))

    @cached_property
    def closure(self) -> Calibration | CycleClosure | None:
        """The terms that training runs add to the rates."""
        if self.cycles is not None:
            return CycleClosure(self.operators, self.cycles)
        return self.calibration

    @cached_property
    def linear_parts(self) -> list[LinearPart]:
        """The linear parts of steps, with the matrices that runs have computed, by training run."""
        from sphrom.reduction.exponential_steps import LinearPart  # it loads kernels

        return [LinearPart(matrix) for matrix in self.linear]

    def at(
        self, viscosity: float, factors: Factors, memory_length: float | None = None
    ) -> tuple[Polynomial, Polynomial | None]:
        """Return the rates at a viscosity [m2/s] and values of the other parameters.

        The second polynomial is the part that a closure or the calibration adds to the projected
        rates; None without such a part.
        """
        rates = self.operators.at(viscosity, factors)
        closure = None
        if self.memory is not None and memory_length is not None:
            closure = self.memory.at(viscosity).scaled(memory_length)
        if self.closure is not None:
            added = self.closure.at(viscosity, factors)
            closure = added if closure is None else closure.plus(added)
        return (rates if closure is None else rates.plus(closure)), closure


class CycleLoads(Record):
    """The harmonics of recorded loads of training runs on their limit cycles."""

    real: Array = dataset("run harmonic load", "N/m, N of the torque", "real parts")
    imaginary: Array = dataset("run harmonic load", "N/m, N of the torque", "imaginary parts")

    @property
    def harmonics(self) -> list[Harmonics]:
        """The harmonics (1 + N_HARMONICS, 6) of each run."""
        return list(self.real + 1j * self.imaginary)


class TrainedForce(Record):
    """A force on a wall, with the corrections by training runs."""

    projected: ReducedForce = part()
    correction: Correction | None = part(default=None)
    on_cycles: CycleLoads | None = part(default=None)
    pressure_errors: Array | None = dataset(
        "pressure_candidate run load", "1",
        "errors in held-out training runs, with the joint pressure or the balance of momentum, and "
        "with separate pressure modes; divided by the load's root mean square in all runs",
        default=None,
    )  # fmt: skip


class HeldOutRuns(Record):
    """Predicted training runs, corrected by the other runs only, and their errors.

    With its own correction a training run equals the full run, so it would show no error. Runs
    that diverged are left out.
    """

    run: Indices = dataset("held_out_run", "1", "number of the training run, from 0")
    coordinates: Array = dataset(
        "held_out_run snapshot mode", "of the inner product", "predicted coordinates"
    )
    errors: Array = dataset(
        "held_out_run compared_snapshot field", "m/s",
        "root mean square errors over the fluid, of velocity and of c0 rho'/rho0 minus its mean",
    )  # fmt: skip


class Differences(Record):
    """The errors of a measurement in held-out training runs."""

    quantities: Mapping[str, Array] = stored(
        (*FROM_FIELDS, *OF_WALLS), "held_out_run snapshot", meaning=f"{_DIFFERENCE}: {{}}"
    )


class TrainedErrors(Record):
    """The data of error estimates, fitted to training runs."""

    factor: ResidualFactor = part()
    products: FieldProducts = part()
    fitted: ErrorCalibration | None = part(default=None)
    """None if the training runs have no errors, or all of them diverge."""
    held_out: HeldOutRuns | None = part(default=None)
    """None if all of them diverge."""
    differences: Mapping[str, Differences] = part(default_factory=dict)
    outputs: Mapping[str, OutputShares] = part(default_factory=dict)
    """Those of the model's number of modes alone."""
    units: Array = dataset("field", "m/s, Pa", "units of the errors of velocity and pressure")


class TrainedBasis(Record):
    """A trained model with one basis."""

    places: Array = labelled("run parameter", PLACES)
    rates: Mapping[str, TrainedRates] = part()
    first_step: Array = dataset(
        "run", "s", "automatic time step of each training run; zero if it diverged"
    )
    correction: Correction | None = part(default=None)
    forces: Mapping[str, TrainedForce] = part(default_factory=dict)
    measures: Mapping[str, ReducedMeasure] = part(default_factory=dict)
    errors: TrainedErrors | None = part(default=None)
    pressure: Mapping[str, OwnPressure] = part(default_factory=dict)
    """The chosen candidate, by its name, if the model has pressure modes of its own."""
    pressure_errors: Array | None = dataset(
        "pressure_candidate run", "1",
        "expected relative error of the pressure by candidate, from errors in each training run",
        default=None,
    )  # fmt: skip

    @property
    def own_pressure(self) -> OwnPressure | None:
        """The pressure modes that are the model's own, with their coordinates, if it has any."""
        return next(iter(self.pressure.values()), None)

    def nearest(self, place: Array) -> int:
        """Return the number of the training run nearest to a place (n_parameters,)."""
        distances = np.linalg.norm(self.places - place, axis=1)
        # Rounded, so that of equally near points every machine takes the first.
        return int(np.round(distances, 9).argmin())
