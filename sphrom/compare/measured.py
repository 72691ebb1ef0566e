"""Forces, flow rates, probes and lines over time: maps, bases and reduced runs beside full runs.

The flow of each run is described by figures of its own, such as speeds and a frequency.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.artifacts import Artifact, read_record
from sphrom.artifacts.records.coordinates import MeasuredOnce
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.metrics.measures import UNITS, Quantities, components, errors_of, variation
from sphrom.metrics.samples import Probes, Samples
from sphrom.metrics.series import dominant_frequency, kinetic_energy
from sphrom.online.basis_model import quantities_of
from sphrom.online.fast_model import FastModel
from sphrom.reduction.trial_basis import mean_density_fluctuation, project
from sphrom.setup.particles import MeasuredFields
from sphrom.store.stored_run import StoredRun
from sphrom.store.workspace import Workspace

SURFACE = "surface"
"""What tables call the elevation of the whole surface."""
Measured = Mapping[str, Quantities]
"""Quantities of each measurement by its name (n_snapshots, ...)."""


@dataclass(frozen=True)
class MeasureRow:
    """One component of a measured quantity over the run; the full run's own has no errors."""

    measured: str
    quantity: str
    """A component of `sphrom.metrics.measures.UNITS`, such as `force_x` or `pressure`."""
    unit: str
    compared: str
    parameters: str
    n_modes: int | None
    role: str
    """`trained` where the parameter was trained on, else `predicted`."""
    mean: float
    """Over time, and along a line; least and greatest likewise."""
    least: float
    greatest: float
    relative_l2: float | None = field(metadata={"unit": "%"})
    """Root mean square error over time and places, over that of the full run's whole quantity: of
    both components for a force or a velocity."""
    relative_l2_peak: float | None = field(metadata={"unit": "%"})
    """At the worst instant."""
    estimated: float | None = field(metadata={"unit": "%"})
    """The error that the model itself estimates, over time and places as `relative_l2`."""


def measured_of_map(case: Case, mapped: Artifact) -> Measured:
    """Measure the fields of mapped snapshots, which tell no forces."""
    measure = MeasuredFields.of(case)
    if measure is None:
        return {}
    position = mapped.read("reference_position")
    states = zip(mapped.dataset("density_fluctuation"), mapped.dataset("velocity"), strict=True)
    each = [measure(position, *map(np.asarray, state)) for state in states]
    return {
        name: {quantity: np.array([one[name][quantity] for one in each]) for quantity in first}
        for name, first in each[0].items()
    }


def measured_of_best(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint, mapped: Artifact
) -> Measured:
    """Measure the nearest states in the basis of a model, as the model does."""
    fast, time = FastModel(workspace, model), mapped.read("time")
    reduced = fast.at(point)
    state = mapped.read("density_fluctuation"), mapped.read("velocity")
    coordinates = project(reduced.basis, *state)
    mean = mean_density_fluctuation(reduced.basis, state[0])
    return quantities_of(workspace.case, reduced, time, coordinates, mean)


def measured_estimates(case: Case, run: Artifact) -> Measured:
    """Read the estimated errors of what a reduced run measured (...), where it has some."""
    found: dict[str, Quantities] = {}
    for name in case.scene.recorded:
        stored = vars(read_record(run, MeasuredOnce, f"error_estimate/measure/{name}"))
        found[name] = {q: np.atleast_1d(v) for q, v in stored.items() if v is not None}
    return found


def measure_rows(
    own: Measured,
    full: Measured,
    counted: NDArray[np.bool_],
    estimates: Mapping[str, Any],
    *,
    with_weight: bool,
    **described: Any,
) -> Iterator[MeasureRow]:
    """Yield the rows of a run beside the full one, over the snapshots (n_snapshots,) that count.

    `with_weight` says that pressures have a hydrostatic part, which errors are not relative to.

    Compared run, parameters, number of modes and role are `described` as in the rows. Estimated
    errors are root mean squares over time (...), by measurement and quantity.
    """
    for measured, quantities in own.items():
        for quantity, values in quantities.items():
            reference = full[measured][quantity][counted]
            square = variation(quantity, reference, with_weight=with_weight)
            others = components(quantity, reference)
            for component, found in components(quantity, values[counted]).items():
                estimated = None
                if quantity in estimates.get(measured, {}) and square > 0.0:
                    expected = components(quantity, estimates[measured][quantity])
                    estimated = 100.0 * math.sqrt(np.mean(expected[component] ** 2) / square)
                errors: tuple[float | None, float | None] = (None, None)
                if own is not full:
                    errors = errors_of(component, found, others[component], square)
                yield MeasureRow(
                    measured=measured,
                    quantity=component,
                    unit=UNITS[quantity],
                    **described,
                    mean=float(found.mean()),
                    least=float(found.min()),
                    greatest=float(found.max()),
                    relative_l2=errors[0],
                    relative_l2_peak=errors[1],
                    estimated=estimated,
                )


@dataclass(frozen=True, kw_only=True)
class OscillationRow:
    """The oscillation of a history in one run; without one, figures are None."""

    measured: str
    unit: str
    """Of amplitude and mean."""
    compared: str
    parameters: str
    frequency: float | None = field(default=None, metadata={"unit": "Hz"})
    frequency_scatter: float | None = field(default=None, metadata={"unit": "Hz"})
    frequency_error: float | None = field(default=None, metadata={"unit": "%"})
    amplitude: float
    amplitude_scatter: float | None = None
    amplitude_error: float | None = field(default=None, metadata={"unit": "%"})
    phase_error: float | None = field(default=None, metadata={"unit": "deg"})
    """At the end, positive where the run is ahead."""
    mean: float


def oscillation_rows(
    case: Case, time: Array, own: Measured, full: Measured, compared: str, parameters: str
) -> Iterator[OscillationRow]:
    """Yield the rows of a run beside the full one, which has no errors."""
    for name, each in case.scene.oscillations.items():
        if each.measure in own:  # as forces are not of mapped snapshots
            reference = None if own is full else full[each.measure]
            found: dict[str, Any] = each.of(time, own[each.measure], reference)
            yield OscillationRow(
                measured=name, unit=each.units, compared=compared, parameters=parameters, **found
            )


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


def flow_row(
    case: Case, name: str, point: ParameterPoint, run: StoredRun, samples: Samples, probes: Probes
) -> FlowRow:
    """Describe the flow of a run, full or reduced, from its fields and its samples at probes."""
    figures = []
    for snapshot in range(len(run.time)):
        velocity, pressure = run.fields(snapshot)
        fastest, energy = np.hypot(*velocity.T).max(), kinetic_energy(velocity, run.mass)
        figures.append((fastest, energy, pressure.mean(), pressure.std()))
    speed, energies, mean_pressure, deviations = np.stack(figures, axis=1)
    drift = float(np.abs(mean_pressure - mean_pressure[0]).max())
    deviation = float(deviations[len(deviations) // 2 :].mean())
    frequency = None
    if len(probes.stations):
        crosswise = samples.velocity[:, probes.at_stations][:, 0, 1]
        with suppress(ValueError):
            frequency = dominant_frequency(samples.time, crosswise)
    return FlowRow(
        run=name,
        parameters=point.label,
        from_time=float(run.time[0]),
        to_time=float(run.time[-1]),
        largest_speed=float(speed.mean()),
        kinetic_energy=float(energies.mean()),
        bulk_velocity=_bulk_velocity(case, samples, probes),
        mean_pressure_drift=drift,
        pressure_deviation=deviation,
        pressure_drift_ratio=drift / deviation if deviation > 0.0 else None,
        dominant_frequency=frequency,
    )
