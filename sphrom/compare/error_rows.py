"""Rows of the table of errors: one comparison over the whole run.

Figures are named by quantity, place and measure: `pressure_line_relative_l2` is the relative L2
norm of the pressure less its mean, over the line's points and time, and with `_peak` that of the
worst instant; `pressure_line_eq41_by_field_range_mean` is Eq. 4.1 of the pressure on the line over
the range of the whole field, averaged over time. Velocities are vectors in the L2 norm, speeds in
Eq. 4.1.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from sphrom.compare.figures_of_merit import History, Series, WallSplit

Array = NDArray[np.float64]

PERCENT = {"unit": "%"}
PLACES = ("velocity_field", "velocity_line", "pressure_field", "pressure_line")
"""Quantities and where they are compared, as `History` and the figures of rows call them."""
EQ41 = ("eq41_by_line_range", "eq41_by_field_range")
"""Eq. 4.1, as `Series` and the figures of rows call it."""


@dataclass(frozen=True)
class Errors:
    """Errors of one run over time, or of a model over its runs; None for one that was unstable."""

    velocity_field_relative_l2: float | None = field(metadata=PERCENT)
    velocity_field_relative_l2_peak: float | None = field(metadata=PERCENT)
    velocity_line_relative_l2: float | None = field(metadata=PERCENT)
    velocity_line_relative_l2_peak: float | None = field(metadata=PERCENT)
    pressure_field_relative_l2: float | None = field(metadata=PERCENT)
    pressure_field_relative_l2_peak: float | None = field(metadata=PERCENT)
    pressure_line_relative_l2: float | None = field(metadata=PERCENT)
    pressure_line_relative_l2_peak: float | None = field(metadata=PERCENT)
    velocity_field_eq41_by_line_range_mean: float | None = field(metadata=PERCENT)
    velocity_field_eq41_by_line_range_peak: float | None = field(metadata=PERCENT)
    velocity_field_eq41_by_field_range_mean: float | None = field(metadata=PERCENT)
    velocity_field_eq41_by_field_range_peak: float | None = field(metadata=PERCENT)
    velocity_line_eq41_by_line_range_mean: float | None = field(metadata=PERCENT)
    velocity_line_eq41_by_line_range_peak: float | None = field(metadata=PERCENT)
    velocity_line_eq41_by_field_range_mean: float | None = field(metadata=PERCENT)
    velocity_line_eq41_by_field_range_peak: float | None = field(metadata=PERCENT)
    pressure_field_eq41_by_line_range_mean: float | None = field(metadata=PERCENT)
    pressure_field_eq41_by_line_range_peak: float | None = field(metadata=PERCENT)
    pressure_field_eq41_by_field_range_mean: float | None = field(metadata=PERCENT)
    pressure_field_eq41_by_field_range_peak: float | None = field(metadata=PERCENT)
    pressure_line_eq41_by_line_range_mean: float | None = field(metadata=PERCENT)
    pressure_line_eq41_by_line_range_peak: float | None = field(metadata=PERCENT)
    pressure_line_eq41_by_field_range_mean: float | None = field(metadata=PERCENT)
    pressure_line_eq41_by_field_range_peak: float | None = field(metadata=PERCENT)


NO_ERRORS = Errors(*[None] * len(fields(Errors)))
"""Those of a run that became unstable."""
EXACT = Errors(*[0.0] * len(fields(Errors)))
"""Those of a run that others are compared with."""


@dataclass(frozen=True)
class Compared:
    """What is compared with what, and how it ended."""

    compared: str
    against: str
    parameters: str
    n_modes: int | None
    role: str
    """`trained` where the parameter was trained on, else `predicted`."""
    status: str


@dataclass(frozen=True)
class ErrorRow(Errors, Compared):
    """One comparison in a table: what it is of comes first, its errors last."""

    velocity_field_relative_l2_end: float | None = field(metadata=PERCENT)
    """At the last instant."""
    pressure_field_relative_l2_end: float | None = field(metadata=PERCENT)
    pressure_field_without_sound_relative_l2: float | None = field(metadata=PERCENT)
    """As far as it was asked for."""
    pressure_field_without_sound_relative_l2_peak: float | None = field(metadata=PERCENT)
    pressure_line_without_sound_relative_l2: float | None = field(metadata=PERCENT)
    pressure_line_without_sound_relative_l2_peak: float | None = field(metadata=PERCENT)


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


def errors_of(history: History) -> Errors:
    """Return the errors of one run from their history, which must not be empty."""
    figures: dict[str, float | None] = {}
    for place in PLACES:
        series: Series = getattr(history, place)
        figures |= _norms(place, series)
        for measure in EQ41:
            values: Array = getattr(series, measure)
            figures[f"{place}_{measure}_mean"] = float(values.mean())
            figures[f"{place}_{measure}_peak"] = float(values.max())
    return Errors(**figures)


def _norms(name: str, series: Series | None) -> dict[str, float | None]:
    """Return the relative L2 norms of a series, over all and at worst, by their figures' names."""
    overall = None if series is None else series.relative_l2_overall
    peak = None if series is None else float(series.relative_l2.max())
    return {f"{name}_relative_l2": overall, f"{name}_relative_l2_peak": peak}


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
    """Summarise a history; a run that became unstable has no figures."""
    described = Compared(compared, against, parameters, n_modes, role, status)
    counted = status == "complete" and len(history.time) > 0
    quiet = history.quiet if counted else None
    figures = vars(errors_of(history) if counted else NO_ERRORS)
    for place in ("field", "line"):
        series = None if quiet is None else getattr(quiet, place)
        figures = figures | _norms(f"pressure_{place}_without_sound", series)
    for quantity in ("velocity", "pressure"):
        series = getattr(history, f"{quantity}_field")
        end = float(series.relative_l2[-1]) if counted else None
        figures = figures | {f"{quantity}_field_relative_l2_end": end}
    return ErrorRow(**vars(described), **figures)


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
