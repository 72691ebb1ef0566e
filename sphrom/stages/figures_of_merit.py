"""Figures of merit of one run against another: histories, and one row of a table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import ParameterPoint
from sphrom.metrics.averages import hat, moving_average
from sphrom.metrics.discrepancy import (
    instantaneous_range,
    relative_discrepancy,
    relative_error_at,
    relative_l2,
    without_mean,
)
from sphrom.stages.effectivity import EstimateRow
from sphrom.stages.flow_trends import FlowRow
from sphrom.stages.reference_errors import ProfileComparison
from sphrom.stages.sampling import Probes, Samples
from sphrom.stages.timings import RunTiming

Array = NDArray[np.float64]

PERCENT = {"unit": "%"}
TIME_TOLERANCE = 1e-9
"""Times that differ by less are one [s]."""


@dataclass(frozen=True)
class History:
    """Errors over time (n_snapshots,) [%] of one run against another."""

    time: Array
    velocity_discrepancy: Array
    """Eq. 4.1 of the speed, on the line."""
    pressure_discrepancy: Array
    pressure_fluctuation_discrepancy: Array
    """Eq. 4.1 of the pressure less its mean over the line."""
    velocity_field_discrepancy: Array
    """Eq. 4.1 of the speed, on the grid."""
    pressure_field_discrepancy: Array
    pressure_field_fluctuation_discrepancy: Array
    """Eq. 4.1 of the pressure less its mean over the grid."""
    velocity_relative_l2: Array
    pressure_relative_l2: Array
    """Of the pressure less its mean over the grid."""
    walls: WallSplit | None = None
    """The last two, apart; None where there are no walls."""
    quiet: QuietPressure | None = None
    """None where it was not asked for, or the run is too short for it."""


@dataclass(frozen=True)
class WallSplit:
    """Errors (n_snapshots,) [%] near walls, and farther from them than a support radius.

    Root mean squares over the grid's points there, relative to that of the reference over all of
    them: so both have one scale, and where fluid is slow its errors don't count for more.
    """

    velocity_near_walls: Array
    velocity_interior: Array
    pressure_near_walls: Array
    """Of the pressure less its mean over the grid."""
    pressure_interior: Array


@dataclass(frozen=True)
class QuietPressure:
    """Errors (n_instants,) [%] of pressures without their sound.

    Both runs' pressures are averaged over time, with a hat whose half-width is the period of the
    longest sound wave, at the instants that have all of it: sound of a weakly compressible model is
    not the flow's, and has no small space that holds it.
    """

    discrepancy: Array
    """Eq. 4.1, on the line."""
    field_discrepancy: Array
    """Eq. 4.1, on the grid."""


@dataclass(frozen=True)
class ErrorRow:
    """One comparison in a table: mean and peak over time."""

    compared: str
    against: str
    parameters: str
    n_modes: int | None
    role: str
    """`trained` where the parameter was trained on, else `predicted`."""
    status: str
    velocity_mean: float | None = field(metadata=PERCENT)
    velocity_peak: float | None = field(metadata=PERCENT)
    pressure_mean: float | None = field(metadata=PERCENT)
    pressure_peak: float | None = field(metadata=PERCENT)
    pressure_fluctuation_mean: float | None = field(metadata=PERCENT)
    pressure_fluctuation_peak: float | None = field(metadata=PERCENT)
    velocity_field_mean: float | None = field(metadata=PERCENT)
    velocity_field_peak: float | None = field(metadata=PERCENT)
    pressure_field_mean: float | None = field(metadata=PERCENT)
    pressure_field_peak: float | None = field(metadata=PERCENT)
    pressure_field_fluctuation_mean: float | None = field(metadata=PERCENT)
    pressure_field_fluctuation_peak: float | None = field(metadata=PERCENT)
    pressure_quiet_mean: float | None = field(metadata=PERCENT)
    """Without sound, as far as that was asked for."""
    pressure_quiet_peak: float | None = field(metadata=PERCENT)
    pressure_field_quiet_mean: float | None = field(metadata=PERCENT)
    pressure_field_quiet_peak: float | None = field(metadata=PERCENT)
    velocity_l2_peak: float | None = field(metadata=PERCENT)
    pressure_l2_peak: float | None = field(metadata=PERCENT)
    velocity_l2_end: float | None = field(metadata=PERCENT)
    pressure_l2_end: float | None = field(metadata=PERCENT)


@dataclass(frozen=True)
class WallRow:
    """One comparison in a table: errors near walls and away from them, mean and peak over time."""

    compared: str
    parameters: str
    role: str
    velocity_near_walls_mean: float = field(metadata=PERCENT)
    velocity_near_walls_peak: float = field(metadata=PERCENT)
    velocity_interior_mean: float = field(metadata=PERCENT)
    velocity_interior_peak: float = field(metadata=PERCENT)
    pressure_near_walls_mean: float = field(metadata=PERCENT)
    pressure_near_walls_peak: float = field(metadata=PERCENT)
    pressure_interior_mean: float = field(metadata=PERCENT)
    pressure_interior_peak: float = field(metadata=PERCENT)


def compare(
    run: Samples,
    reference: Samples,
    probes: Probes,
    from_time: float,
    sound_period: float | None = None,
) -> History:
    """Compare two runs, at the instants that both have and where the errors have a meaning.

    Eq. 4.1 needs fields of the reference that vary over the probes. With the period of the longest
    sound wave [s] pressures are also compared without sound.
    """
    n_common = min(len(run.time), len(reference.time))
    run, reference = run.until(n_common), reference.until(n_common)
    line, grid = probes.on_line, probes.on_grid
    meaningful = reference.time >= from_time - TIME_TOLERANCE
    for where in (line, grid):
        for field_ in (reference.speed, reference.pressure):
            meaningful &= instantaneous_range(field_[:, where]) > 0.0
    kept = np.flatnonzero(meaningful)
    speeds = run.speed[kept], reference.speed[kept]
    pressures = run.pressure[kept], reference.pressure[kept]
    velocities = run.velocity[kept][:, grid], reference.velocity[kept][:, grid]
    line_fluctuations = [without_mean(p[:, line]) for p in pressures]
    grid_fluctuations = [without_mean(p[:, grid]) for p in pressures]
    return History(
        time=reference.time[kept],
        velocity_discrepancy=_at(line, *speeds),
        pressure_discrepancy=_at(line, *pressures),
        pressure_fluctuation_discrepancy=relative_discrepancy(*line_fluctuations),
        velocity_field_discrepancy=_at(grid, *speeds),
        pressure_field_discrepancy=_at(grid, *pressures),
        pressure_field_fluctuation_discrepancy=relative_discrepancy(*grid_fluctuations),
        velocity_relative_l2=relative_l2(*velocities, field_axes=2),
        pressure_relative_l2=relative_l2(*grid_fluctuations),
        walls=_wall_split(probes, velocities, grid_fluctuations),
        quiet=None if sound_period is None else _quiet(run, reference, probes, kept, sound_period),
    )


def _quiet(
    run: Samples,
    reference: Samples,
    probes: Probes,
    kept: NDArray[np.int64],
    sound_period: float,
) -> QuietPressure | None:
    """Return the errors without sound at those of the instants kept that have the whole window."""
    n_half = len(reference.time) + 1
    if len(reference.time) > 1:
        n_half = max(1, round(sound_period / float(np.diff(reference.time).mean())))
    centres = kept - (n_half - 1)
    centres = centres[(centres >= 0) & (kept + n_half <= len(reference.time))]
    if not len(centres):
        return None
    weights = hat(n_half)
    of_run, of_reference = (
        moving_average(p, weights)[centres] for p in (run.pressure, reference.pressure)
    )
    varies = np.all(
        [
            instantaneous_range(of_reference[:, where]) > 0.0
            for where in (probes.on_line, probes.on_grid)
        ],
        axis=0,
    )
    if not varies.any():
        return None
    averages = of_run[varies], of_reference[varies]
    return QuietPressure(_at(probes.on_line, *averages), _at(probes.on_grid, *averages))


def _at(where: slice, run: Array, reference: Array) -> Array:
    return relative_discrepancy(run[:, where], reference[:, where])


def _wall_split(
    probes: Probes, velocities: Sequence[Array], fluctuations: Sequence[Array]
) -> WallSplit | None:
    """Return the errors on both sides of a support radius; None unless there are points on both."""
    near = probes.near_walls
    if near is None or near.all() or not near.any():
        return None
    pressures = [p[..., None] for p in fluctuations]
    return WallSplit(
        velocity_near_walls=relative_error_at(near, *velocities),
        velocity_interior=relative_error_at(~near, *velocities),
        pressure_near_walls=relative_error_at(near, *pressures),
        pressure_interior=relative_error_at(~near, *pressures),
    )


def row(
    history: History,
    *,
    compared: str,
    against: str,
    parameters: str,
    role: str,
    n_modes: int | None = None,
    status: str = "complete",
) -> ErrorRow:
    """Summarise a history; a run that became unstable has no averages."""
    counted = status == "complete" and len(history.time) > 0

    def mean(values: Array) -> float | None:
        return float(values.mean()) if counted else None

    def peak(values: Array) -> float | None:
        return float(values.max()) if counted else None

    quiet = history.quiet

    def end(values: Array) -> float | None:
        return float(values[-1]) if counted else None

    return ErrorRow(
        compared=compared,
        against=against,
        parameters=parameters,
        n_modes=n_modes,
        role=role,
        status=status,
        velocity_mean=mean(history.velocity_discrepancy),
        velocity_peak=peak(history.velocity_discrepancy),
        pressure_mean=mean(history.pressure_discrepancy),
        pressure_peak=peak(history.pressure_discrepancy),
        pressure_fluctuation_mean=mean(history.pressure_fluctuation_discrepancy),
        pressure_fluctuation_peak=peak(history.pressure_fluctuation_discrepancy),
        velocity_field_mean=mean(history.velocity_field_discrepancy),
        velocity_field_peak=peak(history.velocity_field_discrepancy),
        pressure_field_mean=mean(history.pressure_field_discrepancy),
        pressure_field_peak=peak(history.pressure_field_discrepancy),
        pressure_field_fluctuation_mean=mean(history.pressure_field_fluctuation_discrepancy),
        pressure_field_fluctuation_peak=peak(history.pressure_field_fluctuation_discrepancy),
        pressure_quiet_mean=None if quiet is None else mean(quiet.discrepancy),
        pressure_quiet_peak=None if quiet is None else peak(quiet.discrepancy),
        pressure_field_quiet_mean=None if quiet is None else mean(quiet.field_discrepancy),
        pressure_field_quiet_peak=None if quiet is None else peak(quiet.field_discrepancy),
        velocity_l2_peak=peak(history.velocity_relative_l2),
        pressure_l2_peak=peak(history.pressure_relative_l2),
        velocity_l2_end=end(history.velocity_relative_l2),
        pressure_l2_end=end(history.pressure_relative_l2),
    )


def wall_row(described: ErrorRow, history: History) -> WallRow | None:
    """Summarise the split at walls of a run that ran to the end, where there is one."""
    walls = history.walls
    if described.status != "complete" or walls is None or not len(history.time):
        return None
    figures = {}
    for part in fields(WallSplit):
        values = getattr(walls, part.name)
        figures[f"{part.name}_mean"] = float(values.mean())
        figures[f"{part.name}_peak"] = float(values.max())
    return WallRow(described.compared, described.parameters, described.role, **figures)


@dataclass(frozen=True)
class Excerpt:
    """What figures need of samples: line and stations at all times, all probes at one."""

    line: Samples
    stations: Samples
    middle: Samples
    """The snapshot half way through the run alone."""

    @classmethod
    def of(cls, samples: Samples, probes: Probes, middle: int) -> Excerpt:
        """Take the excerpt of samples; a run that ended before the middle gives its end."""
        instant = slice(min(middle, len(samples.time) - 1), middle + 1)
        return cls(
            line=_part(samples, probes.on_line),
            stations=_part(samples, probes.at_stations),
            middle=Samples(
                samples.time[instant],
                samples.velocity[instant].copy(),
                samples.pressure[instant].copy(),
            ),
        )


def _part(samples: Samples, probes: slice) -> Samples:
    """Return the samples at some probes, as copies that keep nothing else alive."""
    return Samples(
        samples.time, samples.velocity[:, probes].copy(), samples.pressure[:, probes].copy()
    )


@dataclass(frozen=True)
class Comparison:
    """One run, or stand-in for a run, against a reference at one parameter point."""

    excerpt: Excerpt
    history: History
    row: ErrorRow


@dataclass(frozen=True)
class PointResults:
    """Everything that is known at one parameter point."""

    point: ParameterPoint
    full: Excerpt
    exact: Excerpt | None
    comparisons: list[Comparison]
    timings: list[RunTiming]
    references: list[ProfileComparison]
    flows: list[FlowRow]
    estimates: list[EstimateRow]

    def histories(self, against: str) -> dict[str, History]:
        """Return the histories against the full run, or the exact solution, by name."""
        return {c.row.compared: c.history for c in self.comparisons if c.row.against == against}

    def excerpt_of(self, compared: str) -> Excerpt:
        """Return the excerpt of a run by its name."""
        return next(c.excerpt for c in self.comparisons if c.row.compared == compared)
