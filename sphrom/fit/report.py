"""What a fit found, in the terminal, in tables and figures, and as an artifact."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sphrom.artifacts import ArtifactWriter, write_record
from sphrom.artifacts.records import fit as records
from sphrom.console import Reporter
from sphrom.fit.estimates import Estimate, Fit, shown_ratio
from sphrom.plots.canvas import save
from sphrom.plots.fits import FitPanel, draw_fit
from sphrom.plots.tables import about, format_figure, write_csv, write_json
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

UNITS = {"kinematic_viscosity": "m2/s", "reynolds": "-"}
"""Of estimates; others are as the case has them."""
SHOWN_DIGITS = 5
MOST_SHOWN = 12
"""Histories in the terminal."""


@dataclass(frozen=True)
class HistoryRow:
    """One measured history, and how the fitted model agrees with it."""

    history: str
    units: str
    values: int
    noise: float
    """Mean standard deviation."""
    residual: float
    """Root mean square of the residuals over the noise."""


@dataclass(frozen=True)
class SearchRow:
    """How the whole fit is."""

    model: str
    measurements: str
    chi_square: float
    expected_chi_square: float
    degrees_of_freedom: int
    starts_led_here: int
    starts: int


@dataclass(frozen=True)
class ProblemRow:
    """What to know before the figures are used."""

    problem: str


def history_rows(fit: Fit) -> list[HistoryRow]:
    """Return a row for each history."""
    return [
        HistoryRow(
            each.measured.name,
            each.measured.unit,
            len(each.fitted),
            float(each.measured.noise.mean()),
            each.residual,
        )
        for each in fit.histories
    ]


def show(report: Reporter, fit: Fit) -> None:
    """Show the estimates, their correlation, the histories, and what is wrong with them."""
    report.table(
        f"fit of {fit.model} to {fit.measurements}: 95 % intervals and standard deviations, of "
        "which the noise and the model's errors are parts",
        ("parameter", "value", "from", "to", "deviation", "noise", "model", "[%]", ""),
        [_shown(each) for each in fit.estimates],
    )
    if len(fit.free) > 1:
        rows = [
            (name, *(f"{value:.3f}" for value in row))
            for name, row in zip(fit.free, fit.correlation, strict=True)
        ]
        report.table("correlation", ("", *fit.free), rows)
    shown = history_rows(fit)[:MOST_SHOWN]
    report.table(
        f"histories, {len(shown)} of {len(fit.histories)}",
        ("history", "units", "values", "noise", "residual over noise"),
        [
            (r.history, r.units, str(r.values), format_figure(r.noise), format_figure(r.residual))
            for r in shown
        ],
    )
    report.info(f"{_chi_square(fit)}; {fit.led_here[0]} of {fit.led_here[1]} starts led here")
    for problem in fit.problems:
        report.warn(problem)


def _chi_square(fit: Fit) -> str:
    dof = fit.degrees_of_freedom
    return (
        f"chi^2 per degree of freedom is {shown_ratio(fit.chi_square / dof)}; noise and the "
        f"model's errors explain up to {fit.expected_chi_square / dof:.3g}"
    )


def _shown(estimate: Estimate) -> tuple[str, ...]:
    unit = UNITS.get(estimate.parameter, "")
    name = f"{estimate.parameter} [{unit}]" if unit else estimate.parameter
    values = (estimate.value, estimate.low, estimate.high)
    parts = (estimate.standard_deviation, estimate.by_noise, estimate.by_model)
    share = 100.0 * estimate.standard_deviation / abs(estimate.value) if estimate.value else None
    return (
        name,
        *(format_figure(value, SHOWN_DIGITS) for value in values),
        *(format_figure(part, 2) for part in parts),
        format_figure(share, 2),
        estimate.remark,
    )


def write_tables(workspace: Workspace, fit: Fit, path: Path) -> None:
    """Write the estimates as CSV, and everything as JSON, beside the artifact `path`."""
    write_csv(path.with_suffix(".csv"), fit.estimates)
    dof, (led, starts) = fit.degrees_of_freedom, fit.led_here
    whole = SearchRow(
        fit.model, fit.measurements, fit.chi_square, fit.expected_chi_square, dof, led, starts
    )
    tables: dict[str, Sequence[DataclassInstance]] = {
        "estimates": fit.estimates,
        "histories": history_rows(fit),
        "search": [whole],
        "problems": [ProblemRow(problem) for problem in fit.problems],
    }
    write_json(path.with_suffix(".json"), tables, about(workspace.case.name, workspace.threads))


def write_fit(artifact: ArtifactWriter, fit: Fit) -> None:
    """Store a fit."""

    def of(name: str) -> np.ndarray:
        return np.array([getattr(each, name) for each in fit.estimates])

    parts = ("standard_deviation", "by_noise", "by_model", "low", "high")
    stored = records.Fit(
        value=of("value"),
        **{name: of(name) for name in parts},
        covariance=fit.covariance,
        correlation=fit.correlation,
        eigenvalues=fit.eigenvalues,
        directions=fit.directions,
        time=fit.histories[0].time,
        history=dict(_histories(fit)),
        estimate_names=",".join(each.parameter for each in fit.estimates),
        remarks=",".join(each.remark for each in fit.estimates),
        parameter_names=",".join(fit.free),
        point=fit.at,
        model=fit.model,
        measurements=fit.measurements,
        problems="\n".join(fit.problems),
        chi_square=fit.chi_square,
        expected_chi_square=fit.expected_chi_square,
        degrees_of_freedom=fit.degrees_of_freedom,
        starts_led_here=fit.led_here[0],
        starts=fit.led_here[1],
    )
    write_record(artifact, stored)


def _histories(fit: Fit) -> Iterator[tuple[str, records.FittedHistory]]:
    for k, each in enumerate(fit.histories):
        yield (
            str(k),
            records.FittedHistory(
                instant=each.measured.time,
                measured=each.measured.value,
                noise=each.measured.noise,
                fitted=each.fitted,
                curve=each.curve,
                half_width=each.half_width,
                name=each.measured.name,
                units=each.measured.unit,
            ),
        )


def draw(fit: Fit, path: Path) -> None:
    """Draw data, fit and intervals of every history."""
    panels = [
        FitPanel(
            f"{each.measured.name} [{each.measured.unit}]",
            each.measured.time,
            each.measured.value,
            each.measured.noise,
            each.fitted,
            each.time,
            each.curve,
            each.half_width,
        )
        for each in fit.histories
    ]
    # One below the other: a figure of one history is narrow.
    found = [
        f"{each.parameter} {format_figure(each.value, 4)} "
        f"({format_figure(each.low, 4)} to {format_figure(each.high, 4)})"
        for each in fit.estimates
    ]
    title = "\n".join((f"{fit.model} fitted to {fit.measurements}, 95 % intervals", *found))
    save(draw_fit(panels, title=title), path)
