"""What a run's flow is like, in one row: speed, energy, drift of the pressure, dominant frequency.

Figures of the particles themselves are read from the trajectory, those at fixed places come from
the samples that runs are compared by.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.metrics.trends import dominant_frequency, kinetic_energy
from sphrom.store.sampling import Probes, Samples

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FlowRow:
    """One run in a table; a run that became unstable as far as it came."""

    run: str
    parameters: str
    from_time: float = field(metadata={"unit": "s"})
    to_time: float = field(metadata={"unit": "s"})
    largest_speed: float = field(metadata={"unit": "m/s"})
    """Of all particles, the mean over time."""
    kinetic_energy: float = field(metadata={"unit": "J/m"})
    """The mean over time."""
    bulk_velocity: float | None = field(metadata={"unit": "m/s"})
    """The mean of u over the channel beside a cavity, and over time; None without a channel."""
    mean_pressure_drift: float = field(metadata={"unit": "Pa"})
    """How far the particles' mean pressure goes from that of the first snapshot, at most."""
    pressure_deviation: float = field(metadata={"unit": "Pa"})
    """The pressure's standard deviation over the particles, its mean over the later half."""
    pressure_drift_ratio: float | None
    """The last but one over the last; None for a pressure that is the same everywhere."""
    dominant_frequency: float | None = field(metadata={"unit": "Hz"})
    """Of v at the station; None without a station, or an oscillation of two periods or more."""


@dataclass(frozen=True)
class _Series:
    """Figures of the particles over time, all (n_snapshots,)."""

    largest_speed: Array
    kinetic_energy: Array
    mean_pressure: Array
    pressure_deviation: Array


class FieldSeries(Protocol):
    """The fields of a run, snapshot by snapshot."""

    @property
    def time(self) -> Array:
        """(n_snapshots,) [s]."""

    @property
    def mass(self) -> float:
        """Of a particle, or of what a point stands for [kg/m]."""

    def fields(self, snapshot: int) -> tuple[Array, Array]:
        """Return velocity (n, 2) [m/s] and pressure (n,) [Pa] of one snapshot."""


class StoredRun:
    """The fields of a trajectory."""

    def __init__(self, trajectory: Artifact) -> None:
        self.time = trajectory.read("time")
        self.mass = trajectory.number("mass")
        self._velocities = trajectory.dataset("velocity")
        self._pressures = trajectory.dataset("pressure")

    def fields(self, snapshot: int) -> tuple[Array, Array]:
        """Return velocity (n, 2) [m/s] and pressure (n,) [Pa] of one snapshot."""
        return np.asarray(self._velocities[snapshot]), np.asarray(self._pressures[snapshot])


def flow_row(
    case: Case,
    name: str,
    parameters: str,
    run: FieldSeries,
    samples: Samples,
    probes: Probes,
) -> FlowRow:
    """Describe the flow of a run, full or reduced."""
    series = _particle_series(run)
    drift = float(np.abs(series.mean_pressure - series.mean_pressure[0]).max())
    deviation = float(series.pressure_deviation[len(series.pressure_deviation) // 2 :].mean())
    times = run.time
    return FlowRow(
        run=name,
        parameters=parameters,
        from_time=float(times[0]),
        to_time=float(times[-1]),
        largest_speed=float(series.largest_speed.mean()),
        kinetic_energy=float(series.kinetic_energy.mean()),
        bulk_velocity=_bulk_velocity(case, samples, probes),
        mean_pressure_drift=drift,
        pressure_deviation=deviation,
        pressure_drift_ratio=drift / deviation if deviation > 0.0 else None,
        dominant_frequency=_dominant_frequency(samples, probes),
    )


def _particle_series(run: FieldSeries) -> _Series:
    figures = np.empty((4, len(run.time)))
    for snapshot in range(len(run.time)):
        velocity, pressure = run.fields(snapshot)
        figures[:, snapshot] = (
            np.hypot(*velocity.T).max(),
            kinetic_energy(velocity, run.mass),
            pressure.mean(),
            pressure.std(),
        )
    return _Series(*figures)


def _bulk_velocity(case: Case, samples: Samples, probes: Probes) -> float | None:
    """Return the mean of u over the scene's channel, and over time [m/s]; None without one."""
    channel = case.scene.channel
    if channel is None or not len(samples.time):
        return None
    inside = channel.contains(probes.grid)
    # Points on the channel's floor are left out of the grid: fluid is at rest there.
    step = case.scene.domain.lengths[1] / probes.grid_shape[0]
    height = channel.height * len(np.unique(probes.grid[inside, 0]))
    flux = samples.velocity[:, probes.on_grid][:, inside, 0].sum(axis=1) * step
    return float(flux.mean()) / height


def _dominant_frequency(samples: Samples, probes: Probes) -> float | None:
    if not len(probes.stations):
        return None
    try:
        return dominant_frequency(samples.time, samples.velocity[:, probes.at_stations][:, 0, 1])
    except ValueError:
        return None
