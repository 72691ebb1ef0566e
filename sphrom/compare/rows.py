"""Rows of the tables of errors: one comparison over the whole run."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sphrom.artifacts import Artifact
from sphrom.metrics.histories import (
    EFFECTIVITY,
    ERRORS,
    NO_ERRORS,
    QUANTITIES,
    Errors,
    History,
    effectivity,
    errors_of,
    means_and_peaks,
    norms_of,
)
from sphrom.metrics.samples import Probes, Samples
from sphrom.plots.tables import columns
from sphrom.reduction.error_calibration import FIELDS, LEFT_OUT

BEST = "best possible"
AT_END = tuple(f"{quantity}_field_relative_l2_end" for quantity in QUANTITIES)
WITHOUT_SOUND = tuple(
    f"pressure_{where}_without_sound_relative_l2{peak}"
    for where in ("field", "line")
    for peak in ("", "_peak")
)
WALLS = tuple(
    f"{quantity}_{where}_{statistic}"
    for quantity in QUANTITIES
    for where in ("near_walls", "interior")
    for statistic in ("mean", "peak")
)


def best_name(basis: str, n_modes: int) -> str:
    """Return what tables call the full run's projection onto so many modes of a basis."""
    return f"{BEST}, {basis} M={n_modes}"


@dataclass(frozen=True)
class ErrorRow:
    """One comparison; a run that became unstable has no errors."""

    compared: str
    against: str
    parameters: str
    n_modes: int | None
    role: str
    """`trained` where the parameter was trained on, else `predicted`."""
    status: str
    errors: Errors = field(metadata=columns(ERRORS, "%"))
    at_end: Errors = field(metadata=columns(AT_END, "%"))
    """At the last instant."""
    without_sound: Errors = field(metadata=columns(WITHOUT_SOUND, "%"))

    @property
    def in_field(self) -> tuple[float, float] | None:
        """Errors of velocity and pressure over the whole field [%]; None without a result."""
        velocity, pressure = (self.errors[f"{q}_field_relative_l2"] for q in QUANTITIES)
        return None if velocity is None or pressure is None else (velocity, pressure)


@dataclass(frozen=True)
class WallRow:
    """Errors near walls and away from them, mean and peak over time."""

    compared: str
    parameters: str
    role: str
    errors: Errors = field(metadata=columns(WALLS, "%"))


@dataclass(frozen=True)
class EstimateRow:
    """Estimated and true errors of one reduced run, over time, relative to the full run's field."""

    compared: str
    parameters: str
    role: str
    """`trained` where the parameter was trained on, `predicted` between trained ones, and
    `extrapolated` outside of them."""
    figures: dict[str, float] = field(metadata={"columns": EFFECTIVITY})


def error_row(
    history: History,
    *,
    compared: str,
    against: str,
    parameters: str,
    role: str,
    n_modes: int | None = None,
    status: str = "complete",
) -> ErrorRow:
    """Summarise a history."""
    described = (compared, against, parameters, n_modes, role, status)
    if status != "complete" or not len(history.time):
        return ErrorRow(*described, NO_ERRORS, dict.fromkeys(AT_END), dict.fromkeys(WITHOUT_SOUND))
    ends = (history.places[f"{quantity}_field"].relative_l2[-1] for quantity in QUANTITIES)
    at_end = dict(zip(AT_END, map(float, ends), strict=True))
    without_sound = dict.fromkeys(WITHOUT_SOUND) | {
        name: value
        for place, series in history.without_sound.items()
        for name, value in norms_of(f"{place}_without_sound", series).items()
    }
    return ErrorRow(*described, errors_of(history), at_end, without_sound)


def wall_row(described: ErrorRow, history: History) -> WallRow | None:
    """Summarise the errors at walls of a run that ran to the end, where there are walls."""
    if described.status != "complete" or not history.walls or not len(history.time):
        return None
    errors = means_and_peaks(history.walls)
    return WallRow(described.compared, described.parameters, described.role, errors)


def estimate_row(
    artifact: Artifact,
    run: Samples,
    reference: Samples,
    probes: Probes,
    *,
    from_time: float,
    compared: str,
    parameters: str,
    role: str,
) -> EstimateRow | None:
    """Return how good a run's estimates are; None where it has none, or no errors."""
    if "error_estimate/velocity" not in artifact:
        return None
    estimates = np.stack([artifact.read(f"error_estimate/{name}") for name in FIELDS], axis=1)
    if artifact.text("error_estimate/training") == "outside":
        role = "extrapolated"
    found = effectivity(estimates, run, reference, probes, from_time=from_time, left_out=LEFT_OUT)
    return None if found is None else EstimateRow(compared, parameters, role, found)
