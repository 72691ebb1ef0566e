"""Properties of a run's flow: speed, energy, drift of the pressure, dominant frequency."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sphrom.metrics.samples import Probes, Samples
from sphrom.metrics.trends import dominant_frequency, kinetic_energy

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FlowRow:
    """The flow of one run; of one that became unstable, as far as it came."""

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
    """The largest change of the particles' mean pressure since the first snapshot."""
    pressure_deviation: float = field(metadata={"unit": "Pa"})
    """The pressure's standard deviation over the particles, its mean over the later half."""
    pressure_drift_ratio: float | None
    """That drift over that deviation; None for a pressure that is the same everywhere."""
    dominant_frequency: float | None = field(metadata={"unit": "Hz"})
    """Of v at the station; None without a station, or an oscillation of two periods or more."""


class FieldSeries(Protocol):
    """The fields of a run, snapshot by snapshot."""

    @property
    def time(self) -> Array:
        """(n_snapshots,) [s]."""

    @property
    def mass(self) -> float:
        """Of a particle, or of the fluid that a point stands for [kg/m]."""

    def fields(self, snapshot: int) -> tuple[Array, Array]:
        """Return velocity (n, 2) [m/s] and pressure (n,) [Pa] of one snapshot."""


def flow_row(
    name: str,
    parameters: str,
    run: FieldSeries,
    samples: Samples,
    probes: Probes,
    bulk_velocity: float | None,
) -> FlowRow:
    """Describe the flow of a run, full or reduced, from its fields and its samples at probes."""
    speed, energy, mean_pressure, deviations = _over_time(run)
    drift = float(np.abs(mean_pressure - mean_pressure[0]).max())
    deviation = float(deviations[len(deviations) // 2 :].mean())
    return FlowRow(
        run=name,
        parameters=parameters,
        from_time=float(run.time[0]),
        to_time=float(run.time[-1]),
        largest_speed=float(speed.mean()),
        kinetic_energy=float(energy.mean()),
        bulk_velocity=bulk_velocity,
        mean_pressure_drift=drift,
        pressure_deviation=deviation,
        pressure_drift_ratio=drift / deviation if deviation > 0.0 else None,
        dominant_frequency=_frequency_at_station(samples, probes),
    )


def _over_time(run: FieldSeries) -> Array:
    """Return largest speed, energy, mean and deviation of the pressure (4, n_snapshots)."""
    figures = np.empty((4, len(run.time)))
    for snapshot in range(len(run.time)):
        velocity, pressure = run.fields(snapshot)
        figures[:, snapshot] = (
            np.hypot(*velocity.T).max(),
            kinetic_energy(velocity, run.mass),
            pressure.mean(),
            pressure.std(),
        )
    return figures


def _frequency_at_station(samples: Samples, probes: Probes) -> float | None:
    if not len(probes.stations):
        return None
    try:
        return dominant_frequency(samples.time, samples.velocity[:, probes.at_stations][:, 0, 1])
    except ValueError:
        return None
