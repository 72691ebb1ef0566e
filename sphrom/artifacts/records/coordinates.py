"""The contents of runs on the reference points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from sphrom.arrays import Array
from sphrom.artifacts.records.runs import (
    DENSITY,
    FLOW_RATE,
    PRESSURE,
    PRESSURE_AT_PLACES,
    PRESSURE_ERROR,
    TIME,
    VELOCITY,
    VELOCITY_AT_PLACES,
    VELOCITY_ERROR,
    Force,
    Measured,
    Settings,
    Status,
)
from sphrom.declaration import Record, attribute, dataset, part

Converged = Literal["converged", "not converged"]
_CONSTANT = "error in training over the residual's integral with decay"
_FACTOR = (
    "factor, either way, between 95 % of the training errors and their estimates from the other "
    "training runs; absent outside of training"
)


class MeasuredOnce(Record):
    """One value per measured quantity: in a steady state, or an error over a run."""

    force: Array | None = dataset("component", "N/m", "force on a wall", default=None)
    torque: float | None = attribute("N", "torque on a wall, anticlockwise", default=None)
    flow_rate: float | None = attribute(*FLOW_RATE, default=None)
    velocity: Array | None = dataset("place component", *VELOCITY_AT_PLACES, default=None)
    pressure: Array | None = dataset("place", *PRESSURE_AT_PLACES, default=None)


class ErrorEstimate(Record):
    """The errors of a run, estimated without a full run."""

    velocity: Array = dataset("snapshot", *VELOCITY_ERROR)
    pressure: Array = dataset("snapshot", *PRESSURE_ERROR)
    change: Array = dataset(
        "snapshot cause",
        "of the inner product",
        "distance of coordinates from those that training runs predict: due to the parameters, and "
        "since the training runs ended",
    )
    decay_rate: float = attribute("1/s", "decay rate of errors")
    training: Literal["inside", "outside"] = attribute(
        "",
        "whether the run is inside or outside of the trained parameters and times; outside the "
        "estimate is extrapolated",
    )
    velocity_constant: float = attribute("m/s over the inner product's", _CONSTANT)
    pressure_constant: float = attribute("Pa over the inner product's", _CONSTANT)
    velocity_factor: float | None = attribute("1", _FACTOR, default=None)
    pressure_factor: float | None = attribute("1", _FACTOR, default=None)
    measure: Mapping[str, MeasuredOnce] = part(default_factory=dict)


class Steady(Record):
    """A steady state, found from the end of a run."""

    coordinates: Array = dataset(
        "mode", "of the inner product",
        "zero of the rates, or the closest state that was found, from the end of the run",
        "omega-hat", "Eq. 3.11",
    )
    status: Converged = attribute("", "whether a steady state was found")
    residual: float = attribute("of the modes, /s", "norm of its rates")
    training_distance: float | None = attribute(
        "1", "distance from the nearest of some training states, over the norm of the steady state",
        default=None,
    )
    residual_left_out: float | None = attribute(
        "of the inner product, /s", "norm of the residual of the full rates there",
        default=None,
    )
    velocity_error_estimate: float | None = attribute(*VELOCITY_ERROR, default=None)
    pressure_error_estimate: float | None = attribute(
        "Pa", "estimated root mean square error of the pressure", default=None
    )
    n_steps: int = attribute("", "steps of Newton's method")
    largest_real_part: float = attribute("1/s", "largest real part of the spectrum there")
    measure: Mapping[str, MeasuredOnce] = part(default_factory=dict)


class Coordinates(Settings, kind="sphrom/coordinates"):
    """The time series of a reduced run on the reference points."""

    time: Array = dataset("snapshot", *TIME)
    generalized_coordinates: Array = dataset(
        "snapshot mode", "of the inner product", "coordinates in the basis", "omega-hat", "Eq. 3.11"
    )
    correction: Array | None = dataset(
        "snapshot mode",
        "of the inner product",
        "the part of the coordinates that is a correction by training runs",
        default=None,
    )
    integrated_modes: int | None = attribute(
        "1", "number of leading modes that are integrated within the trained time; training runs "
        "predict the others", default=None,
    )
    force: Mapping[str, Force] = part(default_factory=dict)
    measure: Mapping[str, Measured] = part(default_factory=dict)
    residual: Array | None = dataset(
        "snapshot", "of the inner product, /s", "norm of the residual of the model's rates",
        default=None,
    )
    error_estimate: ErrorEstimate | None = part(default=None)
    steady: Steady | None = part(default=None)
    reference_position: Array | None = dataset(
        "particle component", "m", "points of the reference space, where fields are stored", "x_G",
        "Eq. 3.14", default=None,
    )
    density_fluctuation: Array | None = dataset("snapshot particle", *DENSITY, default=None)
    velocity: Array | None = dataset("snapshot particle component", *VELOCITY, default=None)
    pressure: Array | None = dataset("snapshot particle", *PRESSURE, default=None)
    status: Status = attribute("", "how the run ended")
    status_detail: str | None = attribute("", "reason and time of a failure", default=None)
    memory_length: float | None = attribute("s", "tau of Eq. 3.22", default=None)
    mean_density_fluctuation: float = attribute("kg/m3", "separate mean, constant")
    integrator: Literal["runge-kutta", "exponential"] | None = attribute(
        "", "kind of steps: Runge-Kutta (Eq. 2.18), or exponential, with an exact linear part",
        default=None,
    )
    step_limit: float | None = attribute(
        "s", "largest stable Runge-Kutta step; absent if every step is stable", default=None
    )
    largest_real_part: float = attribute("1/s", "largest real part of the spectrum at the start")
