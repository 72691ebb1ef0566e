"""The tables of a comparison on the terminal: errors and measurements; in details all others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from sphrom.compare.tables import Tables
from sphrom.console import Reporter
from sphrom.plots.tables import MISSING, flat, format_figure, headings

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Row = Mapping[str, Any]
Cell = str | Callable[[Row], str]
Column = tuple[str, Cell]
"""A heading, and the name of a figure or a function that gives the cell."""


def show(report: Reporter, tables: Tables) -> None:
    """Show errors, estimates and measurements; errors near walls and costs as details."""
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
    for title, rows in (
        ("errors near walls, within a support radius, and farther in", tables.walls),
        ("full runs against reference solutions, means over the time from and to", settled),
        ("the flow", tables.flow),
        ("decay of the full run's kinetic energy", tables.decay),
        ("cost of the time steps, writing left out", tables.timings),
    ):
        _show_whole(report.details, title, rows)


def _show(
    report: Reporter, rows: Sequence[DataclassInstance], title: str, columns: Sequence[Column]
) -> None:
    """Show columns of rows, if there are any."""
    if rows:
        cells = [
            [cell(r) if callable(cell) else format_figure(r[cell]) for _, cell in columns]
            for r in map(flat, rows)
        ]
        report.table(title, [heading for heading, _ in columns], cells)


def _show_whole(report: Reporter, title: str, rows: Sequence[DataclassInstance]) -> None:
    """Show all columns of rows, as their file has them."""
    if rows:
        names = [heading.replace("_", " ") for heading in headings(type(rows[0]))]
        report.table(title, names, [[*map(format_figure, flat(r).values())] for r in rows])


def _norm(name: str) -> Callable[[Row], str]:
    """Return the cell of an error over all instants / at the worst one."""

    def cell(r: Row) -> str:
        pair = (r[name], r[f"{name}_peak"])
        return MISSING if pair == (None, None) else " / ".join(map(format_figure, pair))

    return cell


def _effectivity(quantity: str) -> Callable[[Row], str]:
    return lambda r: "{:.2f} ({:.2f} to {:.2f})".format(
        *(r[f"{quantity}_effectivity_{name}"] for name in ("mean", "min", "max"))
    )


RUN: tuple[Column, ...] = (("run", "compared"), ("parameters", "parameters"))
NORMS: tuple[str, tuple[Column, ...]] = (
    "errors: relative L2 norm in %, over points and time / at the worst instant; pressure less its "
    "mean",
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
    "is estimate over error: mean (least to largest)",
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
    ),
)
