"""The contents of sweeps over parameters."""

from __future__ import annotations

from collections.abc import Mapping

from sphrom.arrays import Array, Indices
from sphrom.artifacts.records.runs import PRESSURE_ERROR, TIME, VELOCITY_ERROR
from sphrom.declaration import Record, attribute, dataset, labelled, part
from sphrom.metrics.draws import OutputIndices, OutputStatistics
from sphrom.metrics.quantities import MEASURABLE, PLACED, stored


class Estimates(Record):
    """The estimated errors of those runs that have estimates."""

    run: Indices = dataset(
        "estimated_run", "1", "indices of the runs with estimated errors, from zero"
    )
    velocity: Array = dataset(
        "estimated_run",
        "%",
        "estimated error of the velocity, over its root mean square over the run",
    )
    pressure: Array = dataset(
        "estimated_run",
        "%",
        "estimated error of the pressure minus its mean, over its root mean square over the run",
    )
    extrapolated: Indices = dataset(
        "estimated_run",
        "1",
        "one if a run is outside the training of its model, else zero",
    )
    measured: Array | None = dataset(
        "estimated_run column",
        "of the columns",
        "estimated errors of measurements, in the order of the table's columns",
        default=None,
    )
    change: Array | None = dataset(
        "estimated_run column",
        "of the columns",
        "root mean squares of the changes over time; zero if they are only noise",
        default=None,
    )
    oscillations: Array | None = dataset(
        "estimated_run oscillation figure",
        "of the figures",
        "estimated errors of oscillations, in the order of the case: of frequency, amplitude, mean "
        "and, at the end, phase; zero for figures that a steady flow lacks",
        default=None,
    )
    velocity_over_time: Array | None = labelled(
        "estimated_run snapshot", VELOCITY_ERROR, default=None
    )
    pressure_over_time: Array | None = labelled(
        "estimated_run snapshot", PRESSURE_ERROR, default=None
    )


class Measured(Record):
    """Measurements of runs: over time, and along a line at the end."""

    histories: Mapping[str, Array] = stored(MEASURABLE, "complete_run snapshot", leave_out="place")
    at_end: Mapping[str, Array] = stored(
        PLACED, "complete_run", at="final_{}", meaning="{}, along a line at the end"
    )


class Statistics(Record):
    """Statistics of a sweep whose points are random draws of parameters."""

    levels: Array = dataset("level", "1", "shares of runs below the quantiles", "p")
    outputs: Mapping[str, OutputStatistics] = part(default_factory=dict)
    indices: Mapping[str, OutputIndices] = part(default_factory=dict)
    n_runs: int = attribute("", "number of complete runs in the statistics")
    n_extrapolated: int = attribute("", "number of draws outside the training of the model")
    method: str = attribute("", "method of drawing the points")


class Sweep(Record, kind="sphrom/sweep"):
    """Runs of one model at many parameter values, in the order of the values."""

    parameters: Array = dataset(
        "run parameter", "of the parameters", "parameter values of each run", "mu", "Eq. 2.17"
    )
    status: Indices = dataset(
        "run",
        "1",
        "status of each run: 0 complete, 1 unstable, 2 failed for another reason, 3 not run yet",
    )
    complete: Indices = dataset(
        "complete_run",
        "1",
        "indices of the complete runs, from zero; the other datasets are of these runs",
    )
    time_step: Array = dataset("complete_run", "s", "time step of each run")
    kinetic_energy: Array = dataset(
        "complete_run", "J/m", "kinetic energy at the end", in_space="J"
    )
    kinetic_energy_over_time: Array | None = dataset(
        "complete_run snapshot", "J/m", "kinetic energy", in_space="J", default=None
    )
    largest_speed: Array = dataset(
        "complete_run", "m/s", "largest speed of all points and snapshots"
    )
    time: Array | None = labelled("snapshot", TIME, default=None)
    generalized_coordinates: Array | None = dataset(
        "complete_run snapshot mode",
        "of the inner product",
        "coordinates of reduced runs",
        "omega-hat",
        "Eq. 3.11",
        default=None,
    )
    regime: Indices | None = dataset(
        "complete_run",
        "1",
        "regime of the flow: 0 steady, 1 shedding, 2 undecided",
        default=None,
    )
    measure: Mapping[str, Measured] = part(default_factory=dict)
    error_estimate: Estimates | None = part(default=None)
    derivatives: Array | None = dataset(
        "complete_run derivative",
        "of the figures, per unit of the parameter",
        "derivatives of final figures with respect to parameters",
        default=None,
    )
    statistics: Statistics | None = part(default=None)
    model: str = attribute("", "model of the runs, full or a reduced model's name")
    parameter_names: str = attribute("", "names of the parameters, separated by commas")
    derivative_names: str | None = attribute(
        "", "names of the derivatives, separated by commas", default=None
    )
    failures: Mapping[str, str] = attribute(
        "", "reason why a run, given by its number, is incomplete or doubtful", default_factory=dict
    )
