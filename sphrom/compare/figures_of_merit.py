"""How far one run is from another over time: the relative L2 norm first, and Eq. 4.1 beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.metrics.averages import hat, moving_average
from sphrom.metrics.discrepancy import (
    instantaneous_range,
    relative_discrepancy,
    relative_error_at,
    relative_l2,
    without_mean,
)
from sphrom.store.sampling import Probes, Samples

Array = NDArray[np.float64]

TIME_TOLERANCE = 1e-9
"""Times that differ by less are one [s]."""


@dataclass(frozen=True)
class Series:
    """Errors of one quantity at some points, [%].

    In the L2 norm a velocity is a vector, and a pressure is less its mean over the points; in
    Eq. 4.1 it is the speed, and the pressure as it is.
    """

    relative_l2_overall: float
    """Over points and time: the root of the sum of all squared errors over that of the values'."""
    relative_l2: Array
    """(n_snapshots,) of each instant."""
    eq41_by_line_range: Array
    """(n_snapshots,) Eq. 4.1 with the reference's range on the line."""
    eq41_by_field_range: Array
    """(n_snapshots,) Eq. 4.1 with the reference's range over line and grid."""


@dataclass(frozen=True)
class History:
    """Errors over time of one run against another, on the line and over the whole field (grid)."""

    time: Array
    """(n_snapshots,) [s]"""
    velocity_line: Series
    pressure_line: Series
    velocity_field: Series
    pressure_field: Series
    walls: WallSplit | None = None
    """The relative L2 norms of the field, apart; None where there are no walls."""
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
    """Errors [%] of pressures without their sound.

    Both runs' pressures are averaged over time, with a hat whose half-width is the period of the
    longest sound wave, at the instants that have all of it: sound of a weakly compressible model is
    not the flow's, and has no small space that holds it.
    """

    line: Series
    field: Series


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
    meaningful = reference.time >= from_time - TIME_TOLERANCE
    for values in (reference.speed, reference.pressure):
        meaningful &= _varies(values, probes)
    kept = np.flatnonzero(meaningful)
    velocities = run.velocity[kept], reference.velocity[kept]
    pressures = run.pressure[kept], reference.pressure[kept]
    return History(
        time=reference.time[kept],
        velocity_line=_velocity_series(velocities, probes, probes.on_line),
        pressure_line=_pressure_series(pressures, probes, probes.on_line),
        velocity_field=_velocity_series(velocities, probes, probes.on_grid),
        pressure_field=_pressure_series(pressures, probes, probes.on_grid),
        walls=_wall_split(probes, velocities, pressures),
        quiet=None if sound_period is None else _quiet(run, reference, probes, kept, sound_period),
    )


def _varies(values: Array, probes: Probes) -> NDArray[np.bool_]:
    """Return at which instants values (n_snapshots, n_probes) vary on the line and the grid."""
    ranges = [instantaneous_range(values[:, at]) for at in (probes.on_line, probes.on_grid)]
    return np.all(np.array(ranges) > 0.0, axis=0)


def _velocity_series(velocities: Sequence[Array], probes: Probes, where: slice) -> Series:
    speeds = [np.asarray(np.linalg.norm(v, axis=2)) for v in velocities]
    return _series([v[:, where] for v in velocities], speeds, probes, where)


def _pressure_series(pressures: Sequence[Array], probes: Probes, where: slice) -> Series:
    # A vector of one component: the norms of velocities and pressures are then one expression.
    less_mean = [without_mean(p[:, where])[..., None] for p in pressures]
    return _series(less_mean, pressures, probes, where)


def _series(
    vectors: Sequence[Array], values: Sequence[Array], probes: Probes, where: slice
) -> Series:
    """Return the errors of vectors (n_snapshots, n_points, n_components) and of values.

    Values (n_snapshots, n_probes) are those that Eq. 4.1 compares at the points `where`.
    """
    reference = values[1]
    compared = [each[:, where] for each in values]
    whole = slice(probes.on_line.start, probes.on_grid.stop)
    by_range = [
        relative_discrepancy(compared[0], compared[1], range_over=reference[:, over])
        for over in (probes.on_line, whole)
    ]
    overall = float(relative_l2(*vectors, field_axes=3)) if len(reference) else 0.0
    return Series(overall, relative_l2(*vectors, field_axes=2), *by_range)


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
    averages = [moving_average(p, weights)[centres] for p in (run.pressure, reference.pressure)]
    varies = _varies(averages[1], probes)
    if not varies.any():
        return None
    averages = [each[varies] for each in averages]
    return QuietPressure(
        _pressure_series(averages, probes, probes.on_line),
        _pressure_series(averages, probes, probes.on_grid),
    )


def _wall_split(
    probes: Probes, velocities: Sequence[Array], pressures: Sequence[Array]
) -> WallSplit | None:
    """Return the errors on both sides of a support radius; None unless there are points on both."""
    near, grid = probes.near_walls, probes.on_grid
    if near is None or near.all() or not near.any():
        return None
    flows = [v[:, grid] for v in velocities]
    fluctuations = [without_mean(p[:, grid])[..., None] for p in pressures]
    return WallSplit(
        velocity_near_walls=relative_error_at(near, *flows),
        velocity_interior=relative_error_at(~near, *flows),
        pressure_near_walls=relative_error_at(near, *fluctuations),
        pressure_interior=relative_error_at(~near, *fluctuations),
    )
