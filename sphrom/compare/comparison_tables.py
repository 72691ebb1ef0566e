"""The tables of a comparison: their rows, their files, and their output in the terminal."""

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
from sphrom.metrics.measures import Probes, Samples
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
"""A heading, with the name of a figure or a function that returns the cell."""

AT_END = tuple(f"{quantity}_field_relative_l2_end" for quantity in QUANTITIES)
WITHOUT_SOUND = tuple(
    f"pressure_{where}_without_sound_relative_l2{peak}"
    for where in ("field", "line")
    for peak in ("", "_peak")
)
SLOW_PRESSURE, SOUND = "pressure_field_without_sound_relative_l2", "sound_in_pressure"


@dataclass(frozen=True)
class ErrorRow:
    """One comparison; an unstable run has no errors."""

    compared: str
    against: str
    parameters: str
    n_modes: int | None
    role: str
    """`trained` at points of training runs, else `predicted`."""
    status: str
    errors: Errors = field(metadata=columns((*ERRORS, *AT_END, *WITHOUT_SOUND, SOUND), "%"))
    """Errors by name; `_end` means at the last time, `_without_sound` averaged over sound.

    `sound_in_pressure` is the share of the reference's pressure that these averages remove.
    """

    @property
    def in_field(self) -> tuple[float, float] | None:
        """Errors of velocity and pressure over the whole field [%]; None without a result."""
        velocity, pressure = (self.errors[f"{q}_field_relative_l2"] for q in QUANTITIES)
        return None if velocity is None or pressure is None else (velocity, pressure)


@dataclass(frozen=True)
class EstimateRow:
    """Estimated and true errors of one reduced run over time, relative to the full run's fields."""

    compared: str
    parameters: str
    role: str
    """`trained` at points of training runs, `predicted` between them, `extrapolated` outside."""
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
    """Eq. 4.3 as printed, with sums of singular values."""
    energy: float = field(metadata={"unit": "%"})
    """The same share with sums of squares."""


@dataclass(frozen=True)
class DecayRow:
    """The decay of kinetic energy in a full run and in the exact solution."""

    parameters: str
    fitted_rate: float = field(metadata={"unit": "1/s"})
    exact_rate: float = field(metadata={"unit": "1/s"})
    ratio: float


@dataclass(frozen=True)
class Tables:
    """The rows of all tables; each is written to `tables/NAME.csv`, and all to `compare.json`."""

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
        """Return the tables of an existing comparison, and their metadata.

        Raises ArtifactError when `compare.json` is missing or damaged.
        """
        content = read_json(workspace.out / FILE, workspace.comparison().made_by, RECORDS)
        return cls(**{name: content[name] for name in RECORDS if name in content}), content["about"]

    def write(self, workspace: Workspace) -> None:
        """Write all tables that have rows."""
        tables = {name: rows for name in RECORDS if (rows := getattr(self, name))}
        for name, rows in tables.items():
            write_csv(workspace.folder("tables") / f"{name}.csv", rows)
        write_json(workspace.out / FILE, tables, workspace.case.name, workspace.threads)


RECORDS: Mapping[str, type[DataclassInstance]] = {
    name: get_args(rows)[0] for name, rows in get_type_hints(Tables).items()
}
"""The records of the rows, by table."""


def error_row(
    history: History, status: str = "complete", n_modes: int | None = None, **described: str
) -> ErrorRow:
    """Return the row of a comparison from its history; `described` are other fields of the row."""
    errors = dict[str, float | None].fromkeys((*ERRORS, *AT_END, *WITHOUT_SOUND, SOUND))
    if status == "complete" and len(history.time):
        errors |= errors_of(history)
        for name, quantity in zip(AT_END, QUANTITIES, strict=True):
            errors[name] = float(history.places[f"{quantity}_field"].relative_l2[-1])
        for place, series in history.without_sound.items():
            errors |= norms_of(f"{place}_without_sound", series)
        errors[SOUND] = history.sound
    return ErrorRow(**described, n_modes=n_modes, status=status, errors=errors)


def estimate_row(
    artifact: Artifact,
    run: Samples,
    reference: Samples,
    probes: Probes,
    from_time: float,
    **described: str,
) -> EstimateRow | None:
    """Return a run's estimates beside its errors; None if it has no estimates or no errors."""
    if "error_estimate/velocity" not in artifact:
        return None
    estimates = np.stack([artifact.read(f"error_estimate/{name}") for name in QUANTITIES], axis=1)
    if artifact.text("error_estimate/training") == "outside":
        described["role"] = "extrapolated"
    time = reference.time
    late = time[0] + LEFT_OUT * (time[-1] - time[0])
    figures = effectivity(estimates, run, reference, probes, from_time, late)
    return None if figures is None else EstimateRow(**described, figures=figures)


def show(report: Reporter, tables: Tables) -> None:
    """Show errors, estimates and measurements, and other tables as details."""
    errors = [r for r in tables.errors if "full" in (r.against, r.compared)]
    _show(report, errors, NORMS)
    _show(report, tables.estimates, ESTIMATES)
    _show(report, tables.measures, MEASURES)
    unsettled = [r for r in tables.reference if not r.settled]
    if unsettled:
        where = ", ".join(dict.fromkeys(r.parameters for r in unsettled))
        change = max(r.last_change or 0.0 for r in unsettled)
        report.info(
            f"{where}: the flow still changed over the last tenth of the run, by up to "
            f"{format_figure(100.0 * change)} % of U or rho U^2, so no steady profile is shown"
        )
    settled = [r for r in tables.reference if r.settled]
    oscillations = sorted(tables.oscillations, key=lambda row: row.measured)
    complete: tuple[tuple[str, Sequence[DataclassInstance]], ...] = (
        ("oscillations, with errors, and phases at the end, relative to full runs", oscillations),
        ("full runs and reference solutions, means over a time window", settled),
        ("flow of each run", tables.flow),
        ("decay of the full run's kinetic energy", tables.decay),
        (
            "cost of the time steps of repeated runs, the least of several; a first run, or one at "
            "another point, costs more",
            tables.timings,
        ),
    )
    for title, rows in complete:  # with all columns of their files
        if rows:
            names = (heading.replace("_", " ") for heading in headings(type(rows[0])))
            shown = report if rows is oscillations else report.details
            _show(shown, rows, (title, tuple(zip(names, flat(rows[0]), strict=True))))


def _show(
    report: Reporter, rows: Sequence[DataclassInstance], described: tuple[str, tuple[Column, ...]]
) -> None:
    """Show rows, if there are any, with a title and columns."""
    title, columns = described
    if rows:
        cells = [
            [cell(r) if callable(cell) else format_figure(r[cell]) for _, cell in columns]
            for r in map(flat, rows)
        ]
        report.table(title, [heading for heading, _ in columns], cells)


def _norm(name: str) -> Callable[[Cells], str]:
    """Return the cell of an error: over all times / at the worst time."""

    def cell(r: Cells) -> str:
        pair = (r[name], r[f"{name}_peak"])
        return MISSING if pair == (None, None) else " / ".join(map(format_figure, pair))

    return cell


def _component_error(r: Cells) -> str:
    """Return the cell of a component's error, or the reason why it has none."""
    if r["relative_l2"] is None and r["rms_error"] is not None:
        return f"{r['remark']}, {format_figure(r['rms_error'])} {r['unit']} off"
    return _norm("relative_l2")(r)


def _effectivity(quantity: str) -> Callable[[Cells], str]:
    return lambda r: "{:.2f} ({:.2f} to {:.2f})".format(
        *(r[f"{quantity}_effectivity_{name}"] for name in ("mean", "min", "max"))
    )


RUN: tuple[Column, ...] = (("run", "compared"), ("parameters", "parameters"))
NORMS: tuple[str, tuple[Column, ...]] = (
    "errors: relative L2 norm in %, over sampled points and time / at the worst time; "
    "pressure minus its mean",
    (
        ("run", "compared"),
        ("against", "against"),
        ("parameters", "parameters"),
        ("", lambda r: r["role"] if r["status"] == "complete" else r["status"]),
        ("velocity, field", _norm("velocity_field_relative_l2")),
        ("pressure, field", _norm("pressure_field_relative_l2")),
        ("without sound", _norm(SLOW_PRESSURE)),
        ("share of sound", SOUND),
        ("velocity, line", _norm("velocity_line_relative_l2")),
        ("pressure, line", _norm("pressure_line_relative_l2")),
    ),
)
ESTIMATES: tuple[str, tuple[Column, ...]] = (
    "estimated errors: root mean squares over fields and time, in % of the full run; "
    "effectivity is the ratio of estimate to error, after the first tenth of the run: mean "
    "(least to largest)",
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
    "measurements over time and along lines: relative L2 errors in % of each component's change in "
    "the full run, over all times / at the worst time; vectors also in % of the vector's change",
    (
        ("measured", "measured"),
        ("quantity", lambda r: f"{r['quantity'].replace('_', ' ')} [{r['unit']}]"),
        *RUN,
        ("from [s]", "from_time"),
        ("mean", "mean"),
        ("least", "least"),
        ("greatest", "greatest"),
        ("error", _component_error),
        ("without sound", "without_sound"),
        ("share of sound", "sound"),
        ("estimated", "estimated"),
        ("vector", "vector_relative_l2"),
        ("estimated", "vector_estimated"),
    ),
)
