"""The tables of a comparison: their rows, how errors become rows, and their files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import numpy as np

from sphrom.artifacts import Artifact
from sphrom.compare.costs import RunTiming, StageTiming
from sphrom.compare.measured import MeasureRow
from sphrom.compare.references import ReferenceRow
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
from sphrom.metrics.series import FlowRow
from sphrom.plots.tables import about, columns, read_json, write_csv, write_json
from sphrom.reduction.error_calibration import FIELDS, LEFT_OUT
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FILE = "compare.json"
MADE_BY = "sphrom compare CASE"


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


@dataclass(frozen=True)
class SpectrumRow:
    """Shares of the first modes of a basis."""

    space: str
    basis: str
    part: str
    n_modes: int
    singular_value: float
    share: float = field(metadata={"unit": "%"})
    """Eq. 4.3 as printed, sums of singular values."""
    energy: float = field(metadata={"unit": "%"})
    """The same with their squares."""


@dataclass(frozen=True)
class DecayRow:
    """The decay of the full run's kinetic energy, against the exact solution's."""

    parameters: str
    fitted_rate: float = field(metadata={"unit": "1/s"})
    exact_rate: float = field(metadata={"unit": "1/s"})
    ratio: float


@dataclass(frozen=True)
class Tables:
    """The rows of each table: each is `tables/NAME.csv`, and all are in `compare.json`."""

    errors: list[ErrorRow] = field(default_factory=list)
    walls: list[WallRow] = field(default_factory=list)
    reference: list[ReferenceRow] = field(default_factory=list)
    flow: list[FlowRow] = field(default_factory=list)
    estimates: list[EstimateRow] = field(default_factory=list)
    measures: list[MeasureRow] = field(default_factory=list)
    timings: list[RunTiming] = field(default_factory=list)
    decay: list[DecayRow] = field(default_factory=list)
    singular_values: list[SpectrumRow] = field(default_factory=list)
    stages: list[StageTiming] = field(default_factory=list)

    @classmethod
    def read(cls, workspace: Workspace) -> tuple[Tables, Mapping[str, Any]]:
        """Return the tables of a comparison that was made before, and what they say of its making.

        Raises ArtifactError when `compare.json` is missing or damaged.
        """
        found = read_json(workspace.out / FILE, MADE_BY, RECORDS)
        return cls(**{name: found[name] for name in RECORDS if name in found}), found["about"]

    def write(self, workspace: Workspace) -> None:
        """Write every table that has rows."""
        tables = {each.name: rows for each in fields(self) if (rows := getattr(self, each.name))}
        for name, rows in tables.items():
            write_csv(workspace.folder("tables") / f"{name}.csv", rows)
        origin = about(workspace.case.name, workspace.threads)
        write_json(workspace.out / FILE, tables, origin)


RECORDS: Mapping[str, type[DataclassInstance]] = {
    name: get_args(rows)[0] for name, rows in get_type_hints(Tables).items()
}
"""The record of the rows of each table."""


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
    errors, ends = NO_ERRORS, dict[str, float | None].fromkeys(AT_END)
    without_sound = dict[str, float | None].fromkeys(WITHOUT_SOUND)
    if status == "complete" and len(history.time):
        errors = errors_of(history)
        at_end = (history.places[f"{quantity}_field"].relative_l2[-1] for quantity in QUANTITIES)
        ends = dict(zip(AT_END, map(float, at_end), strict=True))
        for place, series in history.without_sound.items():
            without_sound |= norms_of(f"{place}_without_sound", series)
    described = (compared, against, parameters, n_modes, role, status)
    return ErrorRow(*described, errors, ends, without_sound)


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
