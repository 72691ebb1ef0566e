"""The tables of a comparison on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from sphrom.compare.tables import Tables
from sphrom.plots.tables import UNKNOWN, flat, format_figure
from sphrom.setup.context import Reporter

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Row = Mapping[str, Any]
Cell = str | Callable[[Row], str]
Column = tuple[str, Cell]
"""A heading, and the name of a figure or a function that gives the cell."""

COMPARED: tuple[Column, ...] = (
    ("run", "compared"),
    ("against", "against"),
    ("parameters", "parameters"),
)


def show(report: Reporter, tables: Tables, details: Reporter | None = None) -> None:
    """Show errors, estimates and measurements; `details` are errors near walls, costs and others.

    Without anybody for details all goes the same way.
    """
    details = details or report
    errors = [r for r in tables.errors if "full" in (r.against, r.compared)]
    for to, (title, names, figures) in ((report, NORMS), (details, EQ41)):
        _show(to, errors, title, (*names, *_of_complete(figures)))
    _show(report, tables.estimates, *ESTIMATES)
    _show(report, tables.forces, *FORCES)
    _show(report, tables.measures, *MEASURES)
    _show(details, tables.walls, *WALLS)
    _show(details, [r for r in tables.reference if r.settled], *REFERENCE)
    unsettled = [r for r in tables.reference if not r.settled]
    if unsettled:
        where = ", ".join(dict.fromkeys(r.parameters for r in unsettled))
        change = max(r.last_change or 0.0 for r in unsettled)
        report.info(
            f"{where}: the flow still changed over the last tenth of the run, by up to "
            f"{format_figure(100.0 * change)} % of U or rho U^2: no steady profile is shown"
        )
    _show(details, tables.flow, *FLOW)
    _show(details, tables.timings, *TIMINGS)
    seconds: dict[str, list[float]] = {}
    for stage in tables.stages:
        seconds.setdefault(stage.stage, []).append(stage.seconds)
    if seconds:
        sums = [(s, format_figure(len(all_)), f"{sum(all_):.3g}") for s, all_ in seconds.items()]
        details.table(STAGES, ("stage", "artifacts", "seconds"), sums)
    for decay in tables.decay:
        details.info(
            f"{decay.parameters}: the full run's kinetic energy decays at {decay.ratio:.4f} of the "
            "exact rate"
        )


def _show(
    report: Reporter, rows: Sequence[DataclassInstance], title: str, columns: Sequence[Column]
) -> None:
    """Show rows, if there are any."""
    if rows:
        cells = [tuple(_cell(flat(r), cell) for _, cell in columns) for r in rows]
        report.table(title, [heading for heading, _ in columns], cells)


def _cell(r: Row, column: Cell) -> str:
    return format_figure(r[column]) if isinstance(column, str) else column(r)


def _pair(name: str, statistics: tuple[str, str] = ("_mean", "_peak")) -> Callable[[Row], str]:
    """Return a column of two statistics of a figure, such as mean / peak."""

    def cell(r: Row) -> str:
        first, second = (r[f"{name}{statistic}"] for statistic in statistics)
        if first is None:
            return format_figure(None)
        return f"{format_figure(first)} / {format_figure(second)}"

    return cell


def _of_complete(figures: Sequence[Column]) -> Iterator[Column]:
    """Yield columns that have figures of complete runs only; the first has others' status."""
    for number, (heading, figure) in enumerate(figures):

        def cell(r: Row, figure: Cell = figure, first: bool = number == 0) -> str:
            if r["status"] == "complete":
                return _cell(r, figure)
            return str(r["status"]) if first else ""

        yield heading, cell


OVERALL = ("", "_peak")
NORMS = (
    "errors: relative L2 norm in %, over points and time / at the worst instant; pressure less its "
    "mean",
    (*COMPARED, ("", "role")),
    (
        ("velocity, field", _pair("velocity_field_relative_l2", OVERALL)),
        ("pressure, field", _pair("pressure_field_relative_l2", OVERALL)),
        ("velocity, line", _pair("velocity_line_relative_l2", OVERALL)),
        ("pressure, line", _pair("pressure_line_relative_l2", OVERALL)),
        ("line, without sound", _pair("pressure_line_without_sound_relative_l2", OVERALL)),
    ),
)
EQ41 = (
    "Eq. 4.1 in %, mean / peak over time: the mean error over the range on the line, or over that "
    "of the whole field, which is larger and makes the same error look smaller",
    COMPARED,
    (
        ("velocity, line: line's range", _pair("velocity_line_eq41_by_line_range")),
        ("field's range", _pair("velocity_line_eq41_by_field_range")),
        ("pressure, line: line's range", _pair("pressure_line_eq41_by_line_range")),
        ("field's range", _pair("pressure_line_eq41_by_field_range")),
        ("velocity, field: field's range", _pair("velocity_field_eq41_by_field_range")),
        ("pressure, field: field's range", _pair("pressure_field_eq41_by_field_range")),
    ),
)


def _effectivity(quantity: str) -> Column:
    def cell(r: Row) -> str:
        names = (f"{quantity}_effectivity_{name}" for name in ("mean", "min", "max"))
        mean, least, largest = (r[name] for name in names)
        return f"{mean:.2f} ({least:.2f} to {largest:.2f})"

    return "effectivity", cell


ESTIMATES: tuple[str, tuple[Column, ...]] = (
    "estimated errors, root mean squares over fields and time in % of the full run's; effectivity "
    "is estimate over error: mean (least to largest)",
    (
        ("run", "compared"),
        ("parameters", "parameters"),
        ("", "role"),
        ("velocity est.", "velocity_estimate"),
        ("true", "velocity_error"),
        _effectivity("velocity"),
        ("pressure est.", "pressure_estimate"),
        ("true", "pressure_error"),
        _effectivity("pressure"),
    ),
)
FORCES: tuple[str, tuple[Column, ...]] = (
    "forces on walls: means over time; r.m.s. errors over time in % of the full run's force, the "
    "torque's of its torque",
    (
        ("measured", "measured"),
        ("run", "compared"),
        ("parameters", "parameters"),
        ("x [N/m]", "mean_x"),
        ("y [N/m]", "mean_y"),
        ("torque [N]", "mean_torque"),
        ("error", _pair("force_relative_l2", ("", "_peak"))),
        ("x", "force_x"),
        ("y", "force_y"),
        ("pressure", "force_pressure"),
        ("viscous", "force_viscous"),
        ("torque", "force_torque_relative_l2"),
    ),
)
MEASURES: tuple[str, tuple[Column, ...]] = (
    "measured in the fluid, over time and along lines; relative L2 errors in % of the full run's, "
    "of a velocity's component in % of the velocity's, over all / at the worst instant",
    (
        ("measured", "measured"),
        ("quantity", lambda r: f"{r['quantity'].replace('_', ' ')} [{r['unit']}]"),
        ("run", "compared"),
        ("parameters", "parameters"),
        ("mean", "mean"),
        ("least", "least"),
        ("greatest", "greatest"),
        ("error", _pair("relative_l2", ("", "_peak"))),
    ),
)
WALLS: tuple[str, tuple[Column, ...]] = (
    "errors near walls: r.m.s. in % of the field's (mean/peak over time), within a support radius "
    "of walls and farther in; pressure less its mean",
    (
        ("run", "compared"),
        ("parameters", "parameters"),
        ("velocity, walls", _pair("velocity_near_walls")),
        ("interior", _pair("velocity_interior")),
        ("pressure, walls", _pair("pressure_near_walls")),
        ("interior", _pair("pressure_interior")),
    ),
)


def _with_scatter(name: str) -> Callable[[Row], str]:
    return lambda r: f"{format_figure(r[f'{name}_error'])} ± {format_figure(r[f'{name}_scatter'])}"


def _window(r: Row) -> str:
    times = [format_figure(r[name]) for name in ("from_time", "time")]
    return times[1] if times[0] == times[1] else " to ".join(times)


REFERENCE: tuple[str, tuple[Column, ...]] = (
    "full runs against reference solutions, velocities over U, pressures over rho U^2: errors of "
    "the mean over t, ± standard deviation over t",
    (
        ("parameters", "parameters"),
        ("profile", "profile"),
        ("state", "state"),
        ("t [s]", _window),
        ("largest", _with_scatter("largest")),
        ("r.m.s.", _with_scatter("rms")),
        ("last change", "last_change"),
        ("source", "source"),
    ),
)


FLOW: tuple[str, tuple[Column, ...]] = (
    "the flow: means over time; the mean pressure's drift, also over the pressure's deviation",
    (
        ("run", "run"),
        ("parameters", "parameters"),
        ("max speed [m/s]", "largest_speed"),
        ("bulk [m/s]", "bulk_velocity"),
        ("energy [J/m]", "kinetic_energy"),
        ("drift [Pa]", "mean_pressure_drift"),
        ("drift / dev.", "pressure_drift_ratio"),
        ("f [Hz]", "dominant_frequency"),
    ),
)


def _known(name: str) -> Callable[[Row], str]:
    return lambda r: UNKNOWN if r[name] is None else f"{r[name]:.3g}"


TIMINGS: tuple[str, tuple[Column, ...]] = (
    "cost of the time steps (full and reduced step given), writing left out: all steps at the "
    "least time of a step, means of ten in a row; on reference points the least of some runs",
    (
        ("run", "model"),
        ("parameters", "parameters"),
        ("steps full, reduced s", lambda r: f"{r['full_step']:.3g}, {r['reduced_step']:.3g}"),
        ("full s", _known("full_seconds")),
        ("reduced s", _known("reduced_seconds")),
        ("speed-up", _known("speed_up")),
        ("N_d / M", lambda r: f"{r['compression_factor']:.0f}"),
    ),
)
STAGES = "wall-clock of the stages, reading and writing included"
