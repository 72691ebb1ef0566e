"""The contents of runs: starts, snapshots, checkpoints, and coordinates of reduced models."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.declaration import Labels, Record, attribute, dataset, labelled, part
from sphrom.metrics.quantities import (
    IN_FLUID,
    MEASURABLE,
    OF_WALLS,
    stored,
    stored_numbers,
)
from sphrom.reduction.stream_functions import StreamSpace

TIME = Labels("s", "time of each snapshot", "t", "Eq. 2.18")
DENSITY = Labels("kg/m3", "density minus its reference value", "rho - rho_0", "Eq. 2.6")
VELOCITY = Labels("m/s", "velocity", "u", "Eq. 2.7")
PRESSURE = Labels("Pa", "pressure", "p", "Eq. 2.8")
REFERENCE_POSITION = Labels("m", "points of the reference space", "x_G", "Eq. 3.14")
VELOCITY_ERROR = Labels("m/s", "estimated root mean square error of the velocity")
PRESSURE_ERROR = Labels("Pa", "estimated root mean square error of the pressure minus its mean")
_ABOUT = "about a solid's centroid, or about the box's centre on a side of it"

Status = Literal["complete", "unstable"]


class Medium(Record):
    """The reference state of density and pressure."""

    reference_density: float = attribute("kg/m3", "rho_0 of Eq. 2.8")
    sound_speed: float = attribute("m/s", "c_0 of Eq. 2.8")


class AtPoint(Medium):
    """The reference state, and the parameter values."""

    parameters: Mapping[str, float] = attribute(
        "", "parameter values of the run", default_factory=dict
    )


class Settings(AtPoint):
    """The physical and numerical settings of a run."""

    kinematic_viscosity: float = attribute("m2/s", "nu of Eq. 2.12")
    particle_spacing: float = attribute("m", "initial spacing of the particles")
    smoothing_length: float = attribute("m", "h of Eq. 2.2")
    time_step: float = attribute("s", "step of Eq. 2.18")
    mass: float = attribute("kg/m", "mass of a particle", in_space="kg")
    box_length: tuple[float, ...] = attribute("m", "edges of the box")


class Packing(Record, kind="sphrom/packing"):
    """Packed starting positions."""

    position: Array = dataset("particle component", "m", "packed positions", "x", "Eq. 2.8")
    residual: Array = dataset("iteration", "1", "residual of packing at each iteration")
    particle_spacing: float = attribute("m", "spacing of the particles")
    smoothing_length: float = attribute("m", "smoothing length that packing used")
    box_length: tuple[float, ...] = attribute("m", "edges of the box")


class Start(Record):
    """The state that the recorded part of a run starts from."""

    position: Array = dataset("particle component", "m", "positions of particles", "x", "Eq. 2.8")
    density_fluctuation: Array = labelled("particle", DENSITY)
    velocity: Array = labelled("particle component", VELOCITY)

    @property
    def state(self) -> Array:
        """The full state (2 n_dim + 1, n_particles)."""
        return np.vstack((self.position.T, self.density_fluctuation, self.velocity.T))


class State(Start, Settings, kind="sphrom/state"):
    """The state of a full run at the end of its spin-up."""

    time: float = attribute("s", "time of the state")


class Force(Record):
    """The force and torque of the fluid on a wall, per metre of depth; the force alone in space."""

    pressure: Array = dataset(
        "snapshot component", "N/m", "force of the pressure on a wall", in_space="N"
    )
    viscous: Array = dataset("snapshot component", "N/m", "viscous force on a wall", in_space="N")
    pressure_torque: Array | None = dataset(
        "snapshot", "N", f"torque of the pressure {_ABOUT}, anticlockwise", default=None
    )
    viscous_torque: Array | None = dataset(
        "snapshot", "N", f"viscous torque {_ABOUT}, anticlockwise", default=None
    )


class Measured(Record):
    """Measurements in the fluid: flow rate, fields at places, the surface, the whole fluid."""

    position: Array | None = dataset(
        "place component", "m", "places of velocity and pressure", "x", default=None
    )
    quantities: Mapping[str, Array] = stored(IN_FLUID, "snapshot")


class Timed(Record):
    """The times of snapshots."""

    time: Array = labelled("snapshot", TIME)


class Recorded(Record):
    """The measurements of a run."""

    force: Mapping[str, Force] = part(default_factory=dict)
    measure: Mapping[str, Measured] = part(default_factory=dict)


class Ended(Record):
    """The end of a run."""

    status: Status = attribute("", "how the run ended")
    status_detail: str | None = attribute("", "reason, place and time of a failure", default=None)


class Simulated(Settings, Ended):
    """The settings and the end of a run with density and velocity."""

    unphysical: str | None = attribute(
        "", "signs that a full run is unphysical, one per line", default=None
    )
    memory_length: float | None = attribute("s", "tau of Eq. 3.22, of a reduced run", default=None)


class Snapshots(Timed):
    """The snapshots of a run of particles."""

    step: Indices = dataset(
        "snapshot",
        "1",
        "steps taken up to each snapshot, without those of a spin-up",
        "n",
        "Eq. 2.18",
    )
    position: Array = dataset(
        "snapshot particle component", "m", "particle positions", "x", "Eq. 2.8"
    )
    velocity: Array = labelled("snapshot particle component", VELOCITY)
    density_fluctuation: Array = labelled("snapshot particle", DENSITY)
    pressure: Array = labelled("snapshot particle", PRESSURE)
    generalized_coordinates: Array | None = dataset(
        "snapshot mode",
        "of the inner product",
        "coordinates of a reduced run in its basis",
        "omega-hat",
        "Eq. 3.11",
        default=None,
    )
    mean_density_fluctuation: Array | None = dataset(
        "snapshot",
        "kg/m3",
        "separate mean of a reduced run, in closed boxes",
        default=None,
    )


class Trajectory(Recorded, Snapshots, Simulated, kind="sphrom/trajectory"):
    """The time series of a full or reduced run."""

    ghost_position: Array | None = dataset(
        "ghost component",
        "m",
        "ghost particles of walls",
        "x",
        "Eq. 2.15",
        at="ghost/position",
        default=None,
    )
    ghost_wall_velocity: Array | None = dataset(
        "ghost component",
        "m/s",
        "velocity of each ghost's wall at full speed",
        "U_wall",
        "Eq. 2.15",
        at="ghost/wall_velocity",
        default=None,
    )
    imported_files: str | None = attribute(
        "", "source files of another program, and options", at="imported/files", default=None
    )
    imported_doubts: str | None = attribute(
        "", "reasons why the case may not match, one per line", at="imported/doubts", default=None
    )
    imported_sha256: str | None = attribute(
        "", "digest of both", at="imported/sha256", default=None
    )


class ReferenceSnapshots(Timed, AtPoint, kind="sphrom/reference-snapshots"):
    """The snapshots of one run, mapped onto the reference space."""

    reference_position: Array = labelled("particle component", REFERENCE_POSITION)
    density_fluctuation: Array = labelled("snapshot particle", DENSITY)
    velocity: Array = labelled("snapshot particle component", VELOCITY)
    map_error: Mapping[str, float] = attribute(
        "%",
        "relative L2 error of the map on the exact solution, by field",
        default_factory=dict,
    )
    round_trip_error: Mapping[str, float] = attribute(
        "%",
        "relative L2 error of the last snapshot mapped there and back, by field, where no exact "
        "solution is known",
        default_factory=dict,
    )


class Checkpoint(Record, kind="sphrom/checkpoint"):
    """The state of an unfinished run, on which its next step depends."""

    state: Array = dataset(
        "row entry",
        "of each row",
        "the full or reduced state after the step, as the run holds it",
        "w",
        "Eq. 2.17",
    )
    neighbours_at: Array | None = dataset(
        "component particle",
        "m",
        "positions at which the neighbour list was built, unless it must be built again",
        "x",
        "Alg. 3.2",
        default=None,
    )
    step: int = attribute("", "number of steps taken")
    n_steps: int = attribute("", "number of steps of the whole run")
    time: float = attribute("s", "time of the state")
    n_parts: int = attribute("", "number of files of snapshots that belong to it")
    computed_with: str = attribute("", "versions and processor, which affect the last bits")
    seconds: float = attribute("s", "time spent on the steps", at="timing/integration")
    wall_seconds: float = attribute("s", "time spent on the whole artifact", at="timing/wall")
    continued: str | None = attribute(
        "",
        "digest of the finished run whose snapshots come first; absent without one",
        default=None,
    )


class TrajectoryPart(Recorded, Snapshots, kind="sphrom/trajectory-part"):
    """Snapshots of an unfinished run, from one checkpoint to the next."""

    number: int = attribute("", "number of the part, from 1")


Converged = Literal["converged", "not converged"]
_CONSTANT = "training error divided by the residual's integral with decay"
_FACTOR = (
    "factor, either way, between 95 % of the training errors and their estimates from the other "
    "training runs; absent outside of training"
)


_MEASURED = (*OF_WALLS, *IN_FLUID)


class MeasuredOnce(Record):
    """One value per measured quantity: in a steady state, or an error over a run."""

    arrays: Mapping[str, Array] = stored(q for q in _MEASURED if MEASURABLE[q].axes)
    numbers: Mapping[str, float] = stored_numbers(q for q in _MEASURED if not MEASURABLE[q].axes)

    @property
    def quantities(self) -> dict[str, Array]:
        """The values by quantity, with an axis of one snapshot where there are no others."""
        numbers = {name: np.array([value]) for name, value in self.numbers.items()}
        return {**self.arrays, **numbers}


_UNIT = "of the measurement"


class OscillationEstimate(Record):
    """The errors of an oscillation over a run; a steady flow has only a mean."""

    frequency: float | None = attribute("Hz", "estimated error of the frequency", default=None)
    amplitude: float | None = attribute(_UNIT, "estimated error of the amplitude", default=None)
    mean: float = attribute(_UNIT, "estimated error of the mean")
    phase: float | None = attribute("deg", "estimated error of the phase at the end", default=None)


class SurfaceErrorEstimate(Record):
    """The errors of a run, estimated without a full run."""

    velocity: Array = labelled("snapshot", VELOCITY_ERROR)
    pressure: Array = labelled("snapshot", PRESSURE_ERROR)
    training: Literal["inside", "outside"] = attribute(
        "",
        "whether the run is inside or outside of the trained parameters and times; outside the "
        "estimate is extrapolated",
    )
    measure: Mapping[str, MeasuredOnce] = part(default_factory=dict)


class ErrorEstimate(SurfaceErrorEstimate):
    """The estimated errors of a run, with a residual and changes since training."""

    change: Array = dataset(
        "snapshot cause",
        "of the inner product",
        "distance of coordinates from those that training runs predict: due to the parameters, and "
        "since the training runs ended",
    )
    decay_rate: float = attribute("1/s", "decay rate of errors")
    velocity_constant: float = attribute("m/s over the inner product's", _CONSTANT)
    pressure_constant: float = attribute("Pa over the inner product's", _CONSTANT)
    velocity_factor: float | None = attribute("1", _FACTOR, default=None)
    pressure_factor: float | None = attribute("1", _FACTOR, default=None)
    oscillation: Mapping[str, OscillationEstimate] = part(default_factory=dict)


class Steady(Record):
    """A steady state, found from the end of a run."""

    coordinates: Array = dataset(
        "mode",
        "of the inner product",
        "state with zero rates, or the closest one that was found, by a search from the end "
        "of the run",
        "omega-hat",
        "Eq. 3.11",
    )
    status: Converged = attribute("", "whether a steady state was found")
    residual: float = attribute("of the modes, /s", "norm of its rates")
    training_distance: float | None = attribute(
        "1",
        "distance from the nearest of some training states, divided by the norm of the "
        "steady state",
        default=None,
    )
    residual_left_out: float | None = attribute(
        "of the inner product, /s",
        "norm of the residual of the full rates in the steady state",
        default=None,
    )
    velocity_error_estimate: float | None = attribute(
        VELOCITY_ERROR.units, VELOCITY_ERROR.meaning, default=None
    )
    pressure_error_estimate: float | None = attribute(
        "Pa", "estimated root mean square error of the pressure", default=None
    )
    n_steps: int = attribute("", "steps of Newton's method")
    largest_real_part: float = attribute(
        "1/s", "largest real part of the spectrum in the steady state"
    )
    measure: Mapping[str, MeasuredOnce] = part(default_factory=dict)


class Coordinates(Recorded, Timed, Simulated, kind="sphrom/coordinates"):
    """The time series of a reduced run on the reference points."""

    generalized_coordinates: Array = dataset(
        "snapshot mode", "of the inner product", "coordinates in the basis", "omega-hat", "Eq. 3.11"
    )
    pressure_coordinates: Array | None = dataset(
        "snapshot own_mode",
        "of the inner product",
        "coordinates in the separate pressure modes",
        "b",
        default=None,
    )
    correction: Array | None = dataset(
        "snapshot mode",
        "of the inner product",
        "correction by training runs, which the coordinates include",
        default=None,
    )
    integrated_modes: int | None = attribute(
        "1",
        "number of leading modes that are integrated within the trained time; the others are "
        "predicted from training runs",
        default=None,
    )
    residual: Array | None = dataset(
        "snapshot",
        "of the inner product, /s",
        "norm of the residual of the model's rates",
        default=None,
    )
    error_estimate: ErrorEstimate | None = part(default=None)
    steady: Steady | None = part(default=None)
    reference_position: Array | None = labelled(
        "particle component", REFERENCE_POSITION, default=None
    )
    density_fluctuation: Array | None = labelled("snapshot particle", DENSITY, default=None)
    velocity: Array | None = labelled("snapshot particle component", VELOCITY, default=None)
    pressure: Array | None = labelled("snapshot particle", PRESSURE, default=None)
    mean_density_fluctuation: float = attribute("kg/m3", "separate mean, constant")
    integrator: Literal["runge-kutta", "exponential"] | None = attribute(
        "",
        "kind of steps: Runge-Kutta (Eq. 2.18), or exponential, with an exact linear part",
        default=None,
    )
    step_limit: float | None = attribute(
        "s", "largest stable Runge-Kutta step; absent if every step is stable", default=None
    )
    largest_real_part: float = attribute("1/s", "largest real part of the spectrum at the start")


class SurfaceSnapshots(Timed, AtPoint, kind="sphrom/surface-snapshots"):
    """The snapshots of one run as stream functions and elevations."""

    space: StreamSpace = part()
    stream_function: Array = dataset(
        "snapshot coefficient", "m2/s", "coefficients of the stream function's B-splines", "psi"
    )
    elevation: Array = dataset(
        "snapshot column", "m", "height y of the surface at the midpoints of equal columns", "eta"
    )
    residual: Array = dataset(
        "snapshot",
        "1",
        "norm of the fit's residual, divided by that of the velocity of the particles",
    )
    speed: Array = dataset("snapshot", "m/s", "root mean square velocity of the particles")


class SurfaceRun(Recorded, Timed, Settings, Ended, kind="sphrom/surface-run"):
    """The time series of a reduced run with a free surface."""

    doubts: str | None = attribute(
        "", "distances of its states from all training states, in words, one per line", default=None
    )
    error_estimate: SurfaceErrorEstimate | None = part(default=None)

    generalized_coordinates: Array = dataset(
        "snapshot coordinate", "of the modes, m",
        "coordinates of the velocity's modes, then those of the elevation's", "omega-hat",
        "Eq. 3.11",
    )  # fmt: skip
