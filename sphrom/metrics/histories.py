"""Error measures of fields and whole runs (Eq. 4.1, L2 norms), and compression (Eq. 4.2, 4.3).

Eq. 4.1 divides by a range, max - min of the reference. The choice of points for the range matters
more than the error: a few points with large values, such as the corners under a lid, make any error
small. A comparison of part of a field therefore says whether its range is that of the whole field.

Fields are (n_snapshots, n_points) or (n_points,): the last axis, or the last two of a vector field,
is one instant, and each function returns one number per instant. Results that are not finite raise
ValueError; they arise from fields that are not finite, or a reference of zero.

Quantities and the points of their comparison have one name, such as `velocity_field` or
`pressure_line`. In the L2 norm, velocities are compared as vectors, and pressures minus their mean
over the points; in Eq. 4.1, speeds and the pressures themselves are. Estimated errors, and the true
ones beside them, are root mean squares over the grid, of velocities and pressures minus their mean.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.metrics.measures import Probes, Samples, since
from sphrom.metrics.series import hat, moving_average

QUANTITIES = ("velocity", "pressure")
PLACES = ("velocity_field", "velocity_line", "pressure_field", "pressure_line")
"""Quantities with the points of their comparison."""
EQ41 = ("eq41_by_line_range", "eq41_by_field_range")
"""Eq. 4.1 by its range."""
RANGE_TOLERANCE = 8.0 * float(np.finfo(np.float64).eps)
"""A range below this share of the largest value is rounding and counts as zero."""


def instantaneous_range(reference: Array) -> Array:
    """Return max - min over the points of every instant, 0 if it is only rounding."""
    extent = np.asarray(reference.max(axis=-1) - reference.min(axis=-1))
    return np.where(extent > RANGE_TOLERANCE * np.abs(reference).max(axis=-1), extent, 0.0)


def relative_discrepancy(approximation: Array, reference: Array, extent: Array) -> Array:
    """Return 100 mean|error| / (max - min) of the reference at that instant [%] (Eq. 4.1).

    `extent` (...) is the range: that of `reference`, or of a whole field of which it is a line.

    Raises ValueError for a field that is not finite, or a range of zero at some instant.
    """
    return _percent(np.abs(approximation - reference).mean(axis=-1), extent)


def relative_l2(approximation: Array, reference: Array, *, field_axes: int = 1) -> Array:
    """Return 100 |error| / |reference| in the L2 norm of every instant [%].

    `field_axes` is 1 for scalars (..., n_points), 2 for vectors (..., n_points, n_dim); with one
    more, over points and time. Raises ValueError for fields that aren't finite, zero references.
    """
    axes = tuple(range(-field_axes, 0))
    error, norm = (np.sqrt(np.sum(f**2, axis=axes)) for f in (approximation - reference, reference))
    return _percent(error, norm)


def without_mean(field: Array) -> Array:
    """Return a field minus its spatial mean; in a closed box the mean pressure is arbitrary."""
    return field - field.mean(axis=-1, keepdims=True)


def _percent(errors: Array, scale: Array) -> Array:
    with np.errstate(divide="ignore", invalid="ignore"):
        percents = 100.0 * errors / scale
    if not np.all(np.isfinite(percents)):
        raise ValueError("no error: a field is not finite, or the reference is constant or zero")
    return np.asarray(percents)


def compression_factors(n_particles: int, n_modes: int, n_dim: int = 2) -> tuple[float, float]:
    """Return N_d / M with the (2n + 1) N values of the full state (Eq. 4.2 inverted, as used).

    The second result counts only the reduced fields, density and velocity: (n + 1) N / M.
    """
    return (2 * n_dim + 1) * n_particles / n_modes, (n_dim + 1) * n_particles / n_modes


def cumulative_singular_value_share(singular_values: Array) -> Array:
    """Return 100 sum_1^M sigma / sum sigma [%] for M = 1, 2, ... (Eq. 4.3 as printed)."""
    return _percent(np.cumsum(singular_values), singular_values.sum())


def energy(singular_values: Array) -> Array:
    """Return 100 sum_1^M sigma^2 / sum sigma^2 [%] for M = 1, 2, ...: the share of variance."""
    return cumulative_singular_value_share(singular_values**2)


@dataclass(frozen=True)
class Series:
    """Errors of one quantity at some points [%]."""

    relative_l2_overall: float
    """Over points and time: root of the sum of squared errors over that of squared values."""
    relative_l2: Array
    """(n_snapshots,) of each instant, relative to the reference at that instant."""
    over_rms: Array
    """(n_snapshots,) of each instant, over the reference's root mean square over all instants.

    Its root mean square over time is `relative_l2_overall`. Unlike `relative_l2`, it is not large
    just because the reference is nearly at rest.
    """
    eq41: Mapping[str, Array]
    """(n_snapshots,) Eq. 4.1 by EQ41: with the range on the line, or on the line and the grid."""


@dataclass(frozen=True)
class History:
    """Errors over time of one run against another, on the line and over the whole field (grid)."""

    time: Array
    """(n_snapshots,) [s]"""
    places: Mapping[str, Series]
    """The errors over time, by PLACES."""
    without_sound: Mapping[str, Series] = field(default_factory=dict)
    """Errors of pressures averaged over time, by `pressure_field` and `pressure_line`.

    The averages are weighted by a hat whose half-width is the period of the longest sound wave, at
    the instants with a complete window. The sound of a weakly compressible model is not part of the
    flow, and no small basis represents it. Empty unless requested, and for runs that are too short.
    """
    sound: float | None = None
    """Share [%] of the reference's pressure over the field that these averages remove.

    It is sound, particle noise, and all other changes within the period. None without averages, or
    if snapshots are too far apart to tell.
    """


def compare(
    run: Samples,
    reference: Samples,
    probes: Probes,
    from_time: float,
    sound_period: float | None = None,
) -> History:
    """Compare two runs at their common instants for which the errors are defined.

    Eq. 4.1 needs a reference that varies over the probes. If the period of the longest sound wave
    [s] is given, pressures are also compared without sound.
    """
    common = slice(min(len(run.time), len(reference.time)))
    run = run.at(common)
    reference = reference.at(common)
    meaningful = since(reference.time, from_time)
    for values in (reference.speed, reference.pressure):
        meaningful &= _varies(values, probes)
    kept = np.flatnonzero(meaningful)
    velocities = run.velocity[kept], reference.velocity[kept]
    pressures = run.pressure[kept], reference.pressure[kept]
    speeds = [np.asarray(np.linalg.norm(v, axis=2)) for v in velocities]
    places = {
        f"velocity_{name}": _series([v[:, where] for v in velocities], speeds, probes, where)
        for name, where in _parts(probes)
    }
    without_sound: dict[str, Series] = {}
    sound = None
    if sound_period is not None:
        without_sound, sound = _without_sound(run, reference, probes, kept, sound_period)
    return History(
        time=reference.time[kept],
        places=places | _pressure_series(pressures, probes),
        without_sound=without_sound,
        sound=sound,
    )


def _parts(probes: Probes) -> tuple[tuple[str, slice], ...]:
    return (("field", probes.on_grid), ("line", probes.on_line))


def _varies(values: Array, probes: Probes) -> NDArray[np.bool_]:
    """Return whether values (n_snapshots, n_probes) vary on line and grid, by instant."""
    ranges = [instantaneous_range(values[:, where]) for _, where in _parts(probes)]
    return np.all(np.array(ranges) > 0.0, axis=0)


def _fluctuations(pressures: Sequence[Array], where: slice) -> list[Array]:
    """Return pressures minus their means over some points, as vectors of one component."""
    return [without_mean(p[:, where])[..., None] for p in pressures]


def _pressure_series(pressures: Sequence[Array], probes: Probes) -> dict[str, Series]:
    return {
        f"pressure_{name}": _series(_fluctuations(pressures, where), pressures, probes, where)
        for name, where in _parts(probes)
    }


def _series(
    vectors: Sequence[Array], values: Sequence[Array], probes: Probes, where: slice
) -> Series:
    """Return the errors of vectors (n_snapshots, n_points, n_components) and of values.

    Values (n_snapshots, n_probes) are compared by Eq. 4.1 at the points `where`.
    """
    run, reference = values
    everywhere = slice(probes.on_line.start, probes.on_grid.stop)
    eq41 = {
        name: relative_discrepancy(
            run[:, where], reference[:, where], instantaneous_range(reference[:, over])
        )
        for name, over in zip(EQ41, (probes.on_line, everywhere), strict=True)
    }
    found, wanted = vectors
    at_instants = relative_l2(found, wanted, field_axes=2)
    overall = float(relative_l2(found, wanted, field_axes=3)) if len(reference) else 0.0
    sizes = np.sum(wanted**2, axis=(1, 2))
    over_rms = at_instants * np.sqrt(sizes / sizes.mean()) if len(reference) else at_instants
    return Series(overall, at_instants, over_rms, eq41)


def _without_sound(
    run: Samples, reference: Samples, probes: Probes, kept: NDArray[np.int64], sound_period: float
) -> tuple[dict[str, Series], float | None]:
    """Return the errors without sound, at the kept instants with a complete window.

    Return also the share [%] of the reference's pressure that is sound.
    """
    n_half = len(reference.time) + 1
    if len(reference.time) > 1:
        n_half = max(1, round(sound_period / float(np.diff(reference.time).mean())))
    centres = kept - (n_half - 1)
    complete = (centres >= 0) & (kept + n_half <= len(reference.time))
    if not complete.any():
        return {}, None
    weights = hat(n_half)
    pressures = run.pressure, reference.pressure
    averages = [moving_average(p, weights)[centres[complete]] for p in pressures]
    varies = _varies(averages[1], probes)
    if not varies.any():
        return {}, None
    slow = [each[varies] for each in averages]
    sound = None
    if n_half > 1:
        whole = reference.pressure[kept[complete][varies]]
        parts = _fluctuations((slow[1], whole), probes.on_grid)
        sound = float(relative_l2(*parts, field_axes=3))
    return _pressure_series(slow, probes), sound


Errors = Mapping[str, float | None]
"""Errors [%] of one run over time, or of a model over its runs, by ERRORS; None without a result.

`pressure_line_relative_l2` is the relative L2 norm over the line's points and time, and with
`_peak` that of the worst instant. `pressure_line_eq41_by_field_range_mean` is Eq. 4.1 on the line
over the range of the whole field, averaged over time.
"""
ERRORS = (
    *(f"{place}_relative_l2{peak}" for place in PLACES for peak in ("", "_peak")),
    *(f"{place}_{measure}_{part}" for place in PLACES for measure in EQ41 for part in
      ("mean", "peak")),
)  # fmt: skip
NO_ERRORS: Errors = dict.fromkeys(ERRORS)
"""Errors of a run that became unstable."""
EXACT: Errors = dict.fromkeys(ERRORS, 0.0)
"""Errors of the reference run."""


def errors_of(history: History) -> Errors:
    """Return the errors of one run from their history, which must not be empty."""
    errors: dict[str, float | None] = {}
    for place, series in history.places.items():
        errors |= norms_of(place, series)
        for name, values in series.eq41.items():
            errors[f"{place}_{name}_mean"] = float(values.mean())
            errors[f"{place}_{name}_peak"] = float(values.max())
    return {name: errors[name] for name in ERRORS}


def norms_of(name: str, series: Series) -> dict[str, float | None]:
    """Return the overall and the largest relative L2 norm of a series, by name."""
    return {
        f"{name}_relative_l2": series.relative_l2_overall,
        f"{name}_relative_l2_peak": float(series.relative_l2.max()),
    }


def mean_errors(each: Sequence[Errors]) -> Errors:
    """Return means over runs, and the largest of peaks; None if a run has no value."""
    means: dict[str, float | None] = {}
    for name in each[0]:
        values = [value for errors in each if (value := errors[name]) is not None]
        whole = max if name.endswith("peak") else lambda some: sum(some) / len(some)
        means[name] = float(whole(values)) if len(values) == len(each) else None
    return means


EFFECTIVITY = {
    f"{quantity}_{name}": unit
    for quantity in QUANTITIES
    for name, unit in {
        "estimate": "%",
        "error": "%",
        "effectivity_mean": None,
        "effectivity_min": None,
        "effectivity_max": None,
    }.items()
}
"""Names and units: estimate and error over time, relative to the field, and their ratio."""


def effectivity(
    estimates: Array, run: Samples, reference: Samples, probes: Probes, start: float, late: float
) -> dict[str, float] | None:
    """Return figures on the quality of error estimates (n_snapshots, 2), named in EFFECTIVITY.

    Estimates are root mean squares of velocity [m/s] and pressure [Pa]. Instants before `start` [s]
    are left out; ratios also leave out those before `late` [s]. Return None if all errors are zero.
    """
    fields = [
        [samples.velocity[:, probes.on_grid] for samples in (run, reference)],
        _fluctuations((run.pressure, reference.pressure), probes.on_grid),
    ]
    errors = np.stack([_rms(found - expected) for found, expected in fields], axis=1)
    sizes = np.stack([_rms(expected) for _, expected in fields], axis=1)
    counted, later = (since(reference.time, t) for t in (start, max(start, late)))
    later &= (errors > 0.0).all(axis=1)
    if not later.any():
        return None
    figures: list[float] = []
    for series in zip(estimates.T, errors.T, sizes.T, strict=True):
        estimate, error, size = (float(np.linalg.norm(values[counted])) for values in series)
        ratio = series[0][later] / series[1][later]
        figures += 100.0 / size * estimate, 100.0 / size * error
        figures += float(ratio.mean()), float(ratio.min()), float(ratio.max())
    return dict(zip(EFFECTIVITY, figures, strict=True))


def _rms(vectors: Array) -> Array:
    """Return root mean squares over points (n_snapshots,) of the magnitude of vectors."""
    return np.asarray(np.sqrt(np.sum(vectors**2, axis=2).mean(axis=1)))
