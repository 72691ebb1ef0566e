"""The tables of a comparison: their rows, how errors become rows, files, and the terminal."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import numpy as np

from sphrom.artifacts import Artifact
from sphrom.compare.costs import RunTiming, StageTiming
from sphrom.compare.measured import FlowRow, MeasureRow, OscillationRow
from sphrom.compare.references import ReferenceRow
from sphrom.console import Reporter
from sphrom.metrics.histories import (
    EFFECTIVITY,
    ERRORS,
    QUANTITIES,
    Errors,
    History,
    effectivity,
    errors_of,
    norms_of,
)
from sphrom.metrics.samples import Probes, Samples
from sphrom.plots.tables import (
    MISSING,
    columns,
    flat,
    format_figure,
    headings,
    read_json,
    write_csv,
    write_json,
)
from sphrom.reduction.error_calibration import LEFT_OUT
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FILE = "compare.json"


Cells = Mapping[str, Any]
Cell = str | Callable[[Cells], str]
Column = tuple[str, Cell]
"""A heading, and the name of a figure or a function that gives the cell."""

BEST, ALONE = "best possible", "each field alone"
AT_END = tuple(f"{quantity}_field_relative_l2_end" for quantity in QUANTITIES)
WITHOUT_SOUND = tuple(
    f"pressure_{where}_without_sound_relative_l2{peak}"
    for where in ("field", "line")
    for peak in ("", "_peak")
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
    errors: Errors = field(metadata=columns((*ERRORS, *AT_END, *WITHOUT_SOUND), "%"))
    """At the last instant with `_end`; pressures averaged over sound with `_without_sound`."""

    @property
    def in_field(self) -> tuple[float, float] | None:
        """Errors of velocity and pressure over the whole field [%]; None without a result."""
        velocity, pressure = (self.errors[f"{q}_field_relative_l2"] for q in QUANTITIES)
        return None if velocity is None or pressure is None else (velocity, pressure)


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
    reference: list[ReferenceRow] = field(default_factory=list)
    flow: list[FlowRow] = field(default_factory=list)
    estimates: list[EstimateRow] = field(default_factory=list)
    measures: list[MeasureRow] = field(default_factory=list)
    oscillations: list[OscillationRow] = field(default_factory=list)
    timings: list[RunTiming] = field(default_factory=list)
    decay: list[DecayRow] = field(default_factory=list)
    singular_values: list[SpectrumRow] = field(default_factory=list)
    stages: list[StageTiming] = field(default_factory=list)

    @classmethod
    def read(cls, workspace: Workspace) -> tuple[Tables, Mapping[str, Any]]:
        """Return the tables of a comparison that was made before, and what they say of its making.

        Raises ArtifactError when `compare.json` is missing or damaged.
        """
        found = read_json(workspace.out / FILE, workspace.comparison().made_by, RECORDS)
        return cls(**{name: found[name] for name in RECORDS if name in found}), found["about"]

    def write(self, workspace: Workspace) -> None:
        """Write every table that has rows."""
        tables = {name: rows for name in RECORDS if (rows := getattr(self, name))}
        for name, rows in tables.items():
            write_csv(workspace.folder("tables") / f"{name}.csv", rows)
        write_json(workspace.out / FILE, tables, workspace.case.name, workspace.threads)


RECORDS: Mapping[str, type[DataclassInstance]] = {
    name: get_args(rows)[0] for name, rows in get_type_hints(Tables).items()
}
"""The record of the rows of each table."""


def error_row(
    history: History, status: str = "complete", n_modes: int | None = None, **described: str
) -> ErrorRow:
    """Summarise the history of a comparison that is `described` as in its row."""
    errors = dict[str, float | None].fromkeys((*ERRORS, *AT_END, *WITHOUT_SOUND))
    if status == "complete" and len(history.time):
        errors |= errors_of(history)
        for name, quantity in zip(AT_END, QUANTITIES, strict=True):
            errors[name] = float(history.places[f"{quantity}_field"].relative_l2[-1])
        for place, series in history.without_sound.items():
            errors |= norms_of(f"{place}_without_sound", series)
    return ErrorRow(**described, n_modes=n_modes, status=status, errors=errors)


def estimate_row(
    artifact: Artifact,
    run: Samples,
    reference: Samples,
    probes: Probes,
    from_time: float,
    **described: str,
) -> EstimateRow | None:
    """Return how good a run's estimates are; None where it has none, or no errors."""
    if "error_estimate/velocity" not in artifact:
        return None
    estimates = np.stack([artifact.read(f"error_estimate/{name}") for name in QUANTITIES], axis=1)
    if artifact.text("error_estimate/training") == "outside":
        described["role"] = "extrapolated"
    time = reference.time
    late = time[0] + LEFT_OUT * (time[-1] - time[0])
    found = effectivity(estimates, run, reference, probes, from_time, late)
    return None if found is None else EstimateRow(**described, figures=found)


def show(report: Reporter, tables: Tables) -> None:
    """Show errors, estimates and measurements; costs and more as details."""
    errors = [r for r in tables.errors if "full" in (r.against, r.compared)]
    _show(report, errors, *NORMS)
    _show(report, tables.estimates, *ESTIMATES)
    _show(report, tables.measures, *MEASURES)
    unsettled = [r for r in tables.reference if not r.settled]
    if unsettled:
        where = ", ".join(dict.fromkeys(r.parameters for r in unsettled))
        change = max(r.last_change or 0.0 for r in unsettled)
        report.info(
            f"{where}: the flow still changed over the last tenth of the run, by up to "
            f"{format_figure(100.0 * change)} % of U or rho U^2: no steady profile is shown"
        )
    settled = [r for r in tables.reference if r.settled]
    oscillations = sorted(tables.oscillations, key=lambda row: row.measured)
    whole: tuple[tuple[str, Sequence[DataclassInstance]], ...] = (
        ("oscillations; errors, and phases at the end, beside full runs", oscillations),
        ("full runs against reference solutions, means over the time from and to", settled),
        ("the flow", tables.flow),
        ("decay of the full run's kinetic energy", tables.decay),
        ("cost of the time steps, writing left out", tables.timings),
    )
    for title, rows in whole:  # all columns, as their files have them
        if rows:
            names = (heading.replace("_", " ") for heading in headings(type(rows[0])))
            shown = report if rows is oscillations else report.details
            _show(shown, rows, title, [*zip(names, flat(rows[0]), strict=True)])


def _show(
    report: Reporter, rows: Sequence[DataclassInstance], title: str, columns: Sequence[Column]
) -> None:
    if rows:
        cells = [
            [cell(r) if callable(cell) else format_figure(r[cell]) for _, cell in columns]
            for r in map(flat, rows)
        ]
        report.table(title, [heading for heading, _ in columns], cells)


def _norm(name: str) -> Callable[[Cells], str]:
    """Return the cell of an error over all instants / at the worst one."""

    def cell(r: Cells) -> str:
        pair = (r[name], r[f"{name}_peak"])
        return MISSING if pair == (None, None) else " / ".join(map(format_figure, pair))

    return cell


def _effectivity(quantity: str) -> Callable[[Cells], str]:
    return lambda r: "{:.2f} ({:.2f} to {:.2f})".format(
        *(r[f"{quantity}_effectivity_{name}"] for name in ("mean", "min", "max"))
    )


RUN: tuple[Column, ...] = (("run", "compared"), ("parameters", "parameters"))
NORMS: tuple[str, tuple[Column, ...]] = (
    "errors: relative L2 norm in %, over sampled points and time / at the worst instant; pressure "
    "less its mean",
    (
        ("run", "compared"),
        ("against", "against"),
        ("parameters", "parameters"),
        ("", lambda r: r["role"] if r["status"] == "complete" else r["status"]),
        ("velocity, field", _norm("velocity_field_relative_l2")),
        ("pressure, field", _norm("pressure_field_relative_l2")),
        ("velocity, line", _norm("velocity_line_relative_l2")),
        ("pressure, line", _norm("pressure_line_relative_l2")),
        ("line, without sound", _norm("pressure_line_without_sound_relative_l2")),
    ),
)
ESTIMATES: tuple[str, tuple[Column, ...]] = (
    "estimated errors, root mean squares over fields and time in % of the full run's; effectivity "
    "is estimate over error, after the first tenth of the run: mean (least to largest)",
    (
        *RUN,
        ("", "role"),
        ("velocity est.", "velocity_estimate"),
        ("true", "velocity_error"),
        ("effectivity", _effectivity("velocity")),
        ("pressure est.", "pressure_estimate"),
        ("true", "pressure_error"),
        ("effectivity", _effectivity("pressure")),
    ),
)
MEASURES: tuple[str, tuple[Column, ...]] = (
    "measured over time and along lines; relative L2 errors in % of the full run's, of a component "
    "in % of the whole force's or velocity's, over all / at the worst instant",
    (
        ("measured", "measured"),
        ("quantity", lambda r: f"{r['quantity'].replace('_', ' ')} [{r['unit']}]"),
        *RUN,
        ("mean", "mean"),
        ("least", "least"),
        ("greatest", "greatest"),
        ("error", _norm("relative_l2")),
        ("estimated", "estimated"),
    ),
)
