"""Forces, flow rates, probes and lines over time, of reduced runs, maps and bases beside full runs.

Further figures, such as speeds and a frequency, describe the flow of each run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact, read_record
from sphrom.artifacts.records.runs import MeasuredOnce, OscillationEstimate
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import (
    DRY,
    ONLY_NOISE,
    Probes,
    Quantities,
    Samples,
    errors_of,
    in_regime,
    mean_square,
    mean_squares,
    shares,
    since,
    variations,
    why_missing,
    with_coefficients,
)
from sphrom.metrics.quantities import components, parts, unit_of
from sphrom.metrics.series import OSCILLATION, dominant_frequency, kinetic_energy, smoothed
from sphrom.models.contract import Measured
from sphrom.models.stored_run import StoredRun
from sphrom.setup.assembly import without_air

Pair = tuple[float | None, float | None]
"""Errors over all times and at the worst time [%]."""


@dataclass(frozen=True)
class MeasureRow:
    """One component of a measured quantity over a run; that of the full run has no errors."""

    measured: str
    quantity: str
    """A component of `sphrom.metrics.measures.UNITS`, such as `force_x` or `pressure`."""
    unit: str
    compared: str
    parameters: str
    n_modes: int | None
    role: str
    """`trained` at points of training runs, else `predicted`."""
    mean: float
    """Mean over time, and along a line; likewise least and greatest."""
    least: float
    greatest: float
    relative_l2: float | None = field(metadata={"unit": "%"})
    """Root mean square error over time and places, over the root mean square of the component's own
    change in the full run; None for a component with only noise."""
    relative_l2_peak: float | None = field(metadata={"unit": "%"})
    """The same at the worst time."""
    without_sound: float | None = field(metadata={"unit": "%"})
    """The error of averages over a period of the longest sound wave, over the same change."""
    sound: float | None = field(metadata={"unit": "%"})
    """The part of the full run that these averages remove, relative to the same change; None if
    snapshots are too far apart to tell."""
    estimated: float | None = field(metadata={"unit": "%"})
    """The model's own estimate of `relative_l2`."""
    from_time: float = field(metadata={"unit": "s"})
    """The time from which the errors are computed."""
    vector_relative_l2: float | None = field(metadata={"unit": "%"})
    """The same error of the whole vector, relative to the change of the vector; None for
    scalars."""
    vector_estimated: float | None = field(metadata={"unit": "%"})
    rms_error: float | None
    """Root mean square error over time and places, in `unit`."""
    remark: str
    """Why there is no relative error."""


def measured_estimates(case: Case, run: Artifact) -> Measured:
    """Read the estimated errors (...) of a reduced run's measurements, if there are any."""
    estimates: dict[str, Quantities] = {}
    for name in case.scene.recorded:
        stored = read_record(run, MeasuredOnce, f"error_estimate/measure/{name}")
        estimates[name] = stored.quantities
    factors = {n: f for n, f in case.plan.coefficients.items() if estimates[n]}
    found = with_coefficients(estimates, factors)
    for name in case.plan.oscillations:
        path = f"error_estimate/oscillation/{name}"
        if f"{path}/mean" in run.attributes:
            figures = vars(read_record(run, OscillationEstimate, path))
            found[name] = {f: np.array(error) for f, error in figures.items() if error is not None}
    return found


def measure_rows(
    own: Measured,
    full: Measured,
    time: Array,
    from_time: Callable[[str], float],
    estimates: Mapping[str, Any],
    *,
    with_weight: bool,
    averages: Array,
    n_dim: int = 2,
    **described: Any,
) -> Iterator[MeasureRow]:
    """Yield the rows of a run beside the full run at times (n_snapshots,) [s].

    `from_time` returns the `from_time` of a measurement [s]. `described` are other fields
    of the rows. Estimated errors are root mean squares over time (...), by measurement and
    quantity. With `with_weight`, errors of pressures are not relative to their hydrostatic part.
    `averages` are weights of an average over snapshots without sound.
    """
    for measured, quantities in own.items():
        begin = from_time(measured)
        counted = since(time, begin)
        pressure = quantities.get("pressure", np.ones(1)) if with_weight else np.ones(1)
        remark = DRY if (pressure == 0.0).any() else ""
        for quantity, values in quantities.items():
            true = full[measured][quantity]
            reference, found = true[counted], values[counted]
            sizes = variations(quantity, reference, with_weight=with_weight)
            expected = estimates.get(measured, {}).get(quantity)
            estimated = {} if expected is None else shares(mean_squares(quantity, expected), sizes)
            mine = parts(quantity, found)
            others = parts(quantity, reference)
            errors: dict[str, Pair] = dict.fromkeys(sizes, (None, None))
            if own is not full:
                errors = {n: errors_of(n, mine[n], others[n], size) for n, size in sizes.items()}
            slow: dict[str, float | None] = {}
            fast: dict[str, float | None] = {}
            if len(averages) > 1:  # snapshots are closer than the period of sound
                slow, fast = (
                    shares(mean_squares(quantity, each[counted]), sizes)
                    for each in (smoothed(values - true, averages), true - smoothed(true, averages))
                )
            for component, part in components(quantity, found).items():
                other, vector = others[component], "" if component == quantity else quantity
                off = None if own is full else math.sqrt(mean_square(component, part - other))
                yield MeasureRow(
                    measured=measured,
                    quantity=component,
                    unit=unit_of(quantity, n_dim),
                    **described,
                    from_time=begin,
                    mean=float(part.mean()),
                    least=float(part.min()),
                    greatest=float(part.max()),
                    relative_l2=errors[component][0],
                    relative_l2_peak=errors[component][1],
                    without_sound=None if own is full else slow.get(component),
                    sound=fast.get(component),
                    estimated=estimated.get(component),
                    vector_relative_l2=errors[vector][0] if vector else None,
                    vector_estimated=estimated.get(vector),
                    rms_error=off,
                    remark=remark if sizes[component] > 0.0 else ONLY_NOISE,
                )


@dataclass(frozen=True, kw_only=True)
class OscillationRow:
    """The oscillation of a history in one run; most figures are None without an oscillation."""

    measured: str
    unit: str
    """Unit of amplitude and mean."""
    compared: str
    parameters: str
    from_time: float = field(metadata={"unit": "s"})
    """The time from which the history is used."""
    frequency: float | None = field(default=None, metadata={"unit": "Hz"})
    frequency_scatter: float | None = field(default=None, metadata={"unit": "Hz"})
    frequency_error: float | None = field(default=None, metadata={"unit": "%"})
    amplitude: float | None = None
    amplitude_scatter: float | None = None
    amplitude_error: float | None = field(default=None, metadata={"unit": "%"})
    phase_error: float | None = field(default=None, metadata={"unit": "deg"})
    """Phase error at the end, positive if the run is ahead."""
    mean: float | None = None
    mean_error: float | None = None
    frequency_estimated: float | None = field(default=None, metadata={"unit": "%"})
    """The model's own estimate of `frequency_error`; likewise the following ones."""
    amplitude_estimated: float | None = field(default=None, metadata={"unit": "%"})
    phase_estimated: float | None = field(default=None, metadata={"unit": "deg"})
    mean_estimated: float | None = None
    remark: str = ""
    """Why there is no frequency and no amplitude."""


def oscillation_rows(
    case: Case,
    time: Array,
    own: Measured,
    full: Measured,
    compared: str,
    parameters: str,
    regime: str | None = None,
    estimates: Measured | None = None,
) -> Iterator[OscillationRow]:
    """Yield the rows of a run beside the full run, which has no errors; steady ones have a mean."""
    for name, each in case.plan.oscillations.items():
        if each.measure in own:  # mapped snapshots have no forces
            reference = None if own is full else full[each.measure]
            figures: dict[str, Any] = in_regime(regime, each.of(time, own[each.measure], reference))
            figures["remark"] = "" if "frequency" in figures else why_missing(regime)
            for figure, error in (estimates or {}).get(name, {}).items():
                # Errors of frequency and amplitude are relative.
                size = 0.01 * figures.get(figure, 0.0) if figure in OSCILLATION[:2] else 1.0
                figures[f"{figure}_estimated"] = float(error) / size if size > 0.0 else None
            yield OscillationRow(
                measured=name,
                unit=each.units,
                compared=compared,
                parameters=parameters,
                from_time=each.from_time,
                **figures,
            )


@dataclass(frozen=True)
class FlowRow:
    """The flow of one run; for an unstable run, until its last snapshot."""

    run: str
    parameters: str
    from_time: float = field(metadata={"unit": "s"})
    to_time: float = field(metadata={"unit": "s"})
    largest_speed: float = field(metadata={"unit": "m/s"})
    """Largest speed of all particles, mean over time."""
    kinetic_energy: float = field(metadata={"unit": "J/m"})
    """Mean over time."""
    bulk_velocity: float | None = field(metadata={"unit": "m/s"})
    """Mean of u over time, and over the channel beside a cavity, or the fluid in a box that repeats
    along x; None elsewhere."""
    mean_pressure_drift: float = field(metadata={"unit": "Pa"})
    """Largest change of the mean pressure of particles since the first snapshot."""
    pressure_deviation: float = field(metadata={"unit": "Pa"})
    """Standard deviation of the pressure over particles, mean over the second half."""
    pressure_drift_ratio: float | None
    """Drift over deviation of the pressure; None for a uniform pressure."""
    dominant_frequency: float | None = field(metadata={"unit": "Hz"})
    """Frequency of v at the station; None without a station, or with less than two periods."""


@dataclass(frozen=True)
class FlowRowInSpace(FlowRow):
    """The flow of one run in three dimensions."""

    kinetic_energy: float = field(metadata={"unit": "J"})
    """Mean over time."""


def _bulk_velocity(case: Case, samples: Samples, probes: Probes) -> float | None:
    """Return the mean of u over time and over the scene's channel, or a box that repeats along x.

    It is None in other scenes and without samples [m/s].
    """
    channel = case.scene.channel
    if not len(samples.time):
        return None
    if channel is None:
        whole = without_air(case, samples).velocity[:, probes.on_grid, 0]
        return float(np.nanmean(whole)) if case.scene.domain.periodic[0] else None
    inside = channel.contains(probes.grid)
    # The grid has no points on the channel's floor, where the fluid is at rest.
    step = case.scene.domain.lengths[1] / probes.grid_shape[0]
    height = channel.height * len(np.unique(probes.grid[inside, 0]))
    flux = samples.velocity[:, probes.on_grid][:, inside, 0].sum(axis=1) * step
    return float(flux.mean()) / height


def flow_row(
    case: Case, point: ParameterPoint, run: StoredRun, samples: Samples, probes: Probes
) -> FlowRow:
    """Describe the flow of a run, full or reduced, from its fields and its samples at probes."""
    figures = []
    for snapshot in range(len(run.time)):
        velocity, pressure = run.fields(snapshot)
        fastest = np.hypot.reduce(velocity, axis=1).max()
        energy = kinetic_energy(velocity, run.mass)
        figures.append((fastest, energy, pressure.mean(), pressure.std()))
    speed, energies, mean_pressure, deviations = np.stack(figures, axis=1)
    counted = since(run.time, case.plan.settled_from)
    if not counted.any():  # an unstable run ended before
        counted[:] = True
    drift = float(np.abs(mean_pressure - mean_pressure[0]).max())
    deviation = float(deviations[len(deviations) // 2 :].mean())
    frequency = None
    if len(probes.stations):
        crosswise = samples.velocity[:, probes.at_stations][:, 0, 1]
        with suppress(ValueError):
            frequency = dominant_frequency(samples.time[counted], crosswise[counted])
    kind = FlowRow if case.scene.domain.n_dim == 2 else FlowRowInSpace
    return kind(
        run=run.name,
        parameters=point.label,
        from_time=float(run.time[counted][0]),
        to_time=float(run.time[-1]),
        largest_speed=float(speed[counted].mean()),
        kinetic_energy=float(energies[counted].mean()),
        bulk_velocity=_bulk_velocity(case, samples.at(np.flatnonzero(counted)), probes),
        mean_pressure_drift=drift,
        pressure_deviation=deviation,
        pressure_drift_ratio=drift / deviation if deviation > 0.0 else None,
        dominant_frequency=frequency,
    )
