"""Figures of merit of one run against another: histories, and one row of a table."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import ParameterPoint
from sphrom.metrics.discrepancy import (
    instantaneous_range,
    relative_discrepancy,
    relative_l2,
    without_mean,
)
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
    """Eq. 4.1 of the speed, centreline."""
    pressure_discrepancy: Array
    pressure_fluctuation_discrepancy: Array
    """Eq. 4.1 of the pressure less its mean over the line."""
    velocity_field_discrepancy: Array
    pressure_field_discrepancy: Array
    velocity_relative_l2: Array
    pressure_relative_l2: Array
    """Of the pressure less its mean over the grid."""


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
    pressure_fluctuation_peak: float | None = field(metadata=PERCENT)
    velocity_field_peak: float | None = field(metadata=PERCENT)
    pressure_field_peak: float | None = field(metadata=PERCENT)
    velocity_l2_peak: float | None = field(metadata=PERCENT)
    pressure_l2_peak: float | None = field(metadata=PERCENT)
    velocity_l2_end: float | None = field(metadata=PERCENT)
    pressure_l2_end: float | None = field(metadata=PERCENT)


def compare(run: Samples, reference: Samples, probes: Probes, from_time: float) -> History:
    """Compare two runs, at the instants that both have and where the errors have a meaning.

    Eq. 4.1 needs fields of the reference that vary over the probes.
    """
    n_common = min(len(run.time), len(reference.time))
    run, reference = run.until(n_common), reference.until(n_common)
    n_line = len(probes.line)
    line, grid = slice(0, n_line), slice(n_line, None)
    meaningful = reference.time >= from_time - TIME_TOLERANCE
    for where in (line, grid):
        for field_ in (reference.speed, reference.pressure):
            meaningful &= instantaneous_range(field_[:, where]) > 0.0
    kept = np.flatnonzero(meaningful)
    speeds = run.speed[kept], reference.speed[kept]
    pressures = run.pressure[kept], reference.pressure[kept]
    return History(
        time=reference.time[kept],
        velocity_discrepancy=_at(line, *speeds),
        pressure_discrepancy=_at(line, *pressures),
        pressure_fluctuation_discrepancy=relative_discrepancy(
            *(without_mean(p[:, line]) for p in pressures)
        ),
        velocity_field_discrepancy=_at(grid, *speeds),
        pressure_field_discrepancy=_at(grid, *pressures),
        velocity_relative_l2=relative_l2(
            run.velocity[kept][:, grid], reference.velocity[kept][:, grid], field_axes=2
        ),
        pressure_relative_l2=relative_l2(*(without_mean(p[:, grid]) for p in pressures)),
    )


def _at(where: slice, run: Array, reference: Array) -> Array:
    return relative_discrepancy(run[:, where], reference[:, where])


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
        pressure_fluctuation_peak=peak(history.pressure_fluctuation_discrepancy),
        velocity_field_peak=peak(history.velocity_field_discrepancy),
        pressure_field_peak=peak(history.pressure_field_discrepancy),
        velocity_l2_peak=peak(history.velocity_relative_l2),
        pressure_l2_peak=peak(history.pressure_relative_l2),
        velocity_l2_end=end(history.velocity_relative_l2),
        pressure_l2_end=end(history.pressure_relative_l2),
    )


@dataclass(frozen=True)
class Excerpt:
    """What figures need of samples: the centreline at all times, all probes at one."""

    line: Samples
    middle: Samples
    """The snapshot half way through the run alone."""

    @classmethod
    def of(cls, samples: Samples, probes: Probes, middle: int) -> Excerpt:
        """Take the excerpt of samples; a run that ended before the middle gives its end."""
        instant = slice(min(middle, len(samples.time) - 1), middle + 1)
        n_line = len(probes.line)
        return cls(
            line=Samples(
                samples.time,
                np.ascontiguousarray(samples.velocity[:, :n_line]),
                np.ascontiguousarray(samples.pressure[:, :n_line]),
            ),
            middle=Samples(
                samples.time[instant],
                samples.velocity[instant].copy(),
                samples.pressure[instant].copy(),
            ),
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

    def histories(self, against: str) -> dict[str, History]:
        """Return the histories against the full run, or the exact solution, by name."""
        return {c.row.compared: c.history for c in self.comparisons if c.row.against == against}

    def excerpt_of(self, compared: str) -> Excerpt:
        """Return the excerpt of a run by its name."""
        return next(c.excerpt for c in self.comparisons if c.row.compared == compared)
