"""The tables of a comparison that are shown on the terminal, from rows as they are stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sphrom.report.tables import format_figure
from sphrom.stages.context import Reporter

Row = Mapping[str, Any]
Tables = Mapping[str, Sequence[Row]]


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
    report.table(
        "errors in % on the centreline (Eq. 4.1, mean/peak over time)",
        (
            "run",
            "against",
            "parameters",
            "",
            "velocity",
            "pressure",
            "less its mean",
            "without sound",
        ),
        [_error_cells(r, "") for r in errors],
    )
    report.table(
        "errors in % of whole fields (Eq. 4.1, mean/peak over time; relative L2, peak)",
        (
            "run",
            "against",
            "parameters",
            "",
            "velocity",
            "pressure",
            "less its mean",
            "without sound",
            "velocity L2",
            "pressure L2",
        ),
        [
            (
                *_error_cells(r, "_field"),
                format_figure(r["velocity_l2_peak"]),
                format_figure(r["pressure_l2_peak"]),
            )
            for r in errors
        ],
    )


def _error_cells(r: Row, where: str) -> tuple[str, ...]:
    named = (r["compared"], r["against"], r["parameters"], r["role"])
    if r["status"] != "complete":
        return (*named, r["status"], "", "", "")
    pressure = f"pressure{where}"
    parts = (f"velocity{where}", pressure, f"{pressure}_fluctuation", f"{pressure}_quiet")
    return (*named, *(_pair(r, part) for part in parts))


def _pair(r: Row, name: str) -> str:
    if r[f"{name}_mean"] is None:
        return format_figure(None)
    return f"{format_figure(r[name + '_mean'])} / {format_figure(r[name + '_peak'])}"


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
        "full runs against reference solutions, velocities over U, pressures over rho U^2",
        ("parameters", "profile", "state", "t [s]", "largest", "r.m.s.", "last change", "source"),
        [
            (
                r["parameters"],
                r["profile"],
                r["state"],
                _times(r),
                *(format_figure(r[n]) for n in ("largest_error", "rms_error", "last_change")),
                r["source"],
            )
            for r in rows
        ],
    )


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
