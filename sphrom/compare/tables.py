"""The tables of a comparison that are shown on the terminal, from rows as they are stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sphrom.plots.tables import format_figure
from sphrom.setup.context import Reporter

Row = Mapping[str, Any]
Tables = Mapping[str, Sequence[Row]]

L2_SHOWN = tuple(
    f"{place}_relative_l2"
    for place in (
        "velocity_field",
        "pressure_field",
        "velocity_line",
        "pressure_line",
        "pressure_line_without_sound",
    )
)
EQ41_SHOWN = (
    *(
        f"{quantity}_line_eq41_by_{over}_range"
        for quantity in ("velocity", "pressure")
        for over in ("line", "field")
    ),
    "velocity_field_eq41_by_field_range",
    "pressure_field_eq41_by_field_range",
)
"""The figures of `ErrorRow` that the tables show."""


def show(report: Reporter, tables: Tables) -> None:
    """Show the errors of runs, estimates and walls' share, the reference profiles and the flow."""
    errors = [r for r in tables.get("errors", []) if _worth_showing(r)]
    if errors:
        _show_errors(report, errors)
    if estimates := tables.get("estimates"):
        _show_estimates(report, estimates)
    if walls := tables.get("walls"):
        _show_walls(report, walls)
    if reference := tables.get("reference"):
        _show_reference(report, [r for r in reference if r["settled"]])
        _tell_unsettled(report, [r for r in reference if not r["settled"]])
    if flow := tables.get("flow"):
        _show_flow(report, flow)


def _worth_showing(r: Row) -> bool:
    return bool(r["against"] == "full" or r["compared"] == "full")


def _show_errors(report: Reporter, errors: Sequence[Row]) -> None:
    """Show relative L2 norms, then Eq. 4.1 by both ranges; the rest is in errors.csv."""
    report.table(
        "errors: relative L2 norm in %, over points and time / at the worst instant; pressure "
        "less its mean",
        (
            "run",
            "against",
            "parameters",
            "",
            "velocity, field",
            "pressure, field",
            "velocity, line",
            "pressure, line",
            "line, without sound",
        ),
        [(*_names(r), r["role"], *_cells(r, L2_SHOWN, ("", "_peak"))) for r in errors],
    )
    report.table(
        "Eq. 4.1 in %, mean / peak over time: the mean error over the range on the line, or over "
        "that of the whole field, which is larger and makes the same error look smaller",
        (
            "run",
            "against",
            "parameters",
            "velocity, line: line's range",
            "field's range",
            "pressure, line: line's range",
            "field's range",
            "velocity, field: field's range",
            "pressure, field: field's range",
        ),
        [(*_names(r), *_cells(r, EQ41_SHOWN, ("_mean", "_peak"))) for r in errors],
    )


def _names(r: Row) -> tuple[str, str, str]:
    return r["compared"], r["against"], r["parameters"]


def _cells(r: Row, names: Sequence[str], statistics: tuple[str, str]) -> tuple[str, ...]:
    """Return pairs of figures, or what became of the run and nothing else."""
    if r["status"] != "complete":
        return (r["status"], *[""] * (len(names) - 1))
    return tuple(_pair(r, name, statistics) for name in names)


def _pair(r: Row, name: str, statistics: tuple[str, str] = ("_mean", "_peak")) -> str:
    first, second = (r[f"{name}{statistic}"] for statistic in statistics)
    if first is None:
        return format_figure(None)
    return f"{format_figure(first)} / {format_figure(second)}"


def _show_estimates(report: Reporter, estimates: Sequence[Row]) -> None:
    report.table(
        "estimated errors, root mean squares over fields and time in % of the full run's; "
        "effectivity is estimate over error: mean (least to largest)",
        (
            "run",
            "parameters",
            "",
            "velocity est.",
            "true",
            "effectivity",
            "pressure est.",
            "true",
            "effectivity",
        ),
        [
            (
                *(r["compared"], r["parameters"], r["role"]),
                *(cell for part in ("velocity", "pressure") for cell in _estimate_cells(r, part)),
            )
            for r in estimates
        ],
    )


def _estimate_cells(r: Row, part: str) -> tuple[str, ...]:
    error = (format_figure(r[f"{part}_{name}"]) for name in ("estimate", "error"))
    mean, least, largest = (r[f"{part}_effectivity_{name}"] for name in ("mean", "min", "max"))
    return (*error, f"{mean:.2f} ({least:.2f} to {largest:.2f})")


def _show_walls(report: Reporter, walls: Sequence[Row]) -> None:
    parts = ("velocity_near_walls", "velocity_interior", "pressure_near_walls", "pressure_interior")
    report.table(
        "what walls cost: r.m.s. errors in % of the field's (mean/peak over time), within a "
        "support radius of walls and farther in; pressure less its mean",
        ("run", "parameters", "velocity, walls", "interior", "pressure, walls", "interior"),
        [(r["compared"], r["parameters"], *(_pair(r, part) for part in parts)) for r in walls],
    )


def _tell_unsettled(report: Reporter, rows: Sequence[Row]) -> None:
    """Say which runs are not held against steady profiles, as they ended too early for that."""
    if rows:
        where = ", ".join(dict.fromkeys(r["parameters"] for r in rows))
        change = max(r["last_change"] for r in rows)
        report.info(
            f"{where}: the flow still changed over the last tenth of the run, by up to "
            f"{format_figure(100.0 * change)} % of U or rho U^2: no steady profile is shown"
        )


def _show_reference(report: Reporter, rows: Sequence[Row]) -> None:
    if not rows:
        return
    report.table(
        "full runs against reference solutions, velocities over U, pressures over rho U^2: errors "
        "of the mean over t, ± standard deviation over t",
        ("parameters", "profile", "state", "t [s]", "largest", "r.m.s.", "last change", "source"),
        [
            (
                r["parameters"],
                r["profile"],
                r["state"],
                _times(r),
                *(_with_scatter(r, name) for name in ("largest", "rms")),
                format_figure(r["last_change"]),
                r["source"],
            )
            for r in rows
        ],
    )


def _with_scatter(r: Row, name: str) -> str:
    return f"{format_figure(r[f'{name}_error'])} ± {format_figure(r[f'{name}_scatter'])}"


def _times(r: Row) -> str:
    times = [format_figure(r[name]) for name in ("from_time", "time")]
    return times[1] if times[0] == times[1] else " to ".join(times)


def _show_flow(report: Reporter, rows: Sequence[Row]) -> None:
    figures = (
        "largest_speed",
        "bulk_velocity",
        "kinetic_energy",
        "mean_pressure_drift",
        "pressure_drift_ratio",
        "dominant_frequency",
    )
    report.table(
        "the flow: means over time; the mean pressure's drift, also over the pressure's deviation",
        (
            "run",
            "parameters",
            "max speed [m/s]",
            "bulk [m/s]",
            "energy [J/m]",
            "drift [Pa]",
            "drift / dev.",
            "f [Hz]",
        ),
        [(r["run"], r["parameters"], *(format_figure(r[name]) for name in figures)) for r in rows],
    )
