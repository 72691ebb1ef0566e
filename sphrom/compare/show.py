"""The tables of a comparison on the terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from sphrom.compare.tables import Tables
from sphrom.console import Reporter
from sphrom.plots.tables import MISSING, UNKNOWN, flat, format_figure

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Row = Mapping[str, Any]
Cell = str | Callable[[Row], str]
Column = tuple[str, Cell]
"""A heading, and a template of figures or a function that gives the cell."""

COMPARED: tuple[Column, ...] = (
    ("run", "{compared}"),
    ("against", "{against}"),
    ("parameters", "{parameters}"),
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


class _Figure:
    """A value that a template shows as tables do; with a format it may be unknown."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __format__(self, spec: str) -> str:
        if not spec:
            return format_figure(self.value)
        return UNKNOWN if self.value is None else format(self.value, spec)


def _cell(r: Row, cell: Cell) -> str:
    if callable(cell):
        return cell(r)
    text = cell.format_map({name: _Figure(value) for name, value in r.items()})
    return MISSING if text == f"{MISSING} / {MISSING}" else text


def _pair(name: str, first: str = "_mean", second: str = "_peak") -> str:
    """Return a cell of two statistics of a figure, such as mean / peak."""
    return f"{{{name}{first}}} / {{{name}{second}}}"


def _norm(name: str) -> str:
    """Return a cell of an error over all instants / at the worst one."""
    return _pair(name, first="")


def _of_complete(figures: Sequence[tuple[str, str]]) -> Iterator[Column]:
    """Yield columns that have figures of complete runs only; the first has others' status."""
    for number, (heading, figure) in enumerate(figures):

        def cell(r: Row, figure: str = figure, first: bool = number == 0) -> str:
            if r["status"] == "complete":
                return _cell(r, figure)
            return str(r["status"]) if first else ""

        yield heading, cell


NORMS = (
    "errors: relative L2 norm in %, over points and time / at the worst instant; pressure less its "
    "mean",
    (*COMPARED, ("", "{role}")),
    (
        ("velocity, field", _norm("velocity_field_relative_l2")),
        ("pressure, field", _norm("pressure_field_relative_l2")),
        ("velocity, line", _norm("velocity_line_relative_l2")),
        ("pressure, line", _norm("pressure_line_relative_l2")),
        ("line, without sound", _norm("pressure_line_without_sound_relative_l2")),
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
    mean, least, most = (f"{{{quantity}_effectivity_{n}:.2f}}" for n in ("mean", "min", "max"))
    return "effectivity", f"{mean} ({least} to {most})"


ESTIMATES: tuple[str, tuple[Column, ...]] = (
    "estimated errors, root mean squares over fields and time in % of the full run's; effectivity "
    "is estimate over error: mean (least to largest)",
    (
        ("run", "{compared}"),
        ("parameters", "{parameters}"),
        ("", "{role}"),
        ("velocity est.", "{velocity_estimate}"),
        ("true", "{velocity_error}"),
        _effectivity("velocity"),
        ("pressure est.", "{pressure_estimate}"),
        ("true", "{pressure_error}"),
        _effectivity("pressure"),
    ),
)
FORCES: tuple[str, tuple[Column, ...]] = (
    "forces on walls: means over time; r.m.s. errors over time in % of the full run's force, the "
    "torque's of its torque",
    (
        ("measured", "{measured}"),
        ("run", "{compared}"),
        ("parameters", "{parameters}"),
        ("x [N/m]", "{mean_x}"),
        ("y [N/m]", "{mean_y}"),
        ("torque [N]", "{mean_torque}"),
        ("error", _norm("force_relative_l2")),
        ("x", "{force_x}"),
        ("y", "{force_y}"),
        ("pressure", "{force_pressure}"),
        ("viscous", "{force_viscous}"),
        ("torque", "{force_torque_relative_l2}"),
    ),
)
MEASURES: tuple[str, tuple[Column, ...]] = (
    "measured in the fluid, over time and along lines; relative L2 errors in % of the full run's, "
    "of a velocity's component in % of the velocity's, over all / at the worst instant",
    (
        ("measured", "{measured}"),
        ("quantity", lambda r: f"{r['quantity'].replace('_', ' ')} [{r['unit']}]"),
        ("run", "{compared}"),
        ("parameters", "{parameters}"),
        ("mean", "{mean}"),
        ("least", "{least}"),
        ("greatest", "{greatest}"),
        ("error", _norm("relative_l2")),
    ),
)
WALLS: tuple[str, tuple[Column, ...]] = (
    "errors near walls: r.m.s. in % of the field's (mean/peak over time), within a support radius "
    "of walls and farther in; pressure less its mean",
    (
        ("run", "{compared}"),
        ("parameters", "{parameters}"),
        ("velocity, walls", _pair("velocity_near_walls")),
        ("interior", _pair("velocity_interior")),
        ("pressure, walls", _pair("pressure_near_walls")),
        ("interior", _pair("pressure_interior")),
    ),
)


def _window(r: Row) -> str:
    times = [format_figure(r[name]) for name in ("from_time", "time")]
    return times[1] if times[0] == times[1] else " to ".join(times)


REFERENCE: tuple[str, tuple[Column, ...]] = (
    "full runs against reference solutions, velocities over U, pressures over rho U^2: errors of "
    "the mean over t, ± standard deviation over t",
    (
        ("parameters", "{parameters}"),
        ("profile", "{profile}"),
        ("state", "{state}"),
        ("t [s]", _window),
        ("largest", "{largest_error} ± {largest_scatter}"),
        ("r.m.s.", "{rms_error} ± {rms_scatter}"),
        ("last change", "{last_change}"),
        ("source", "{source}"),
    ),
)
FLOW: tuple[str, tuple[Column, ...]] = (
    "the flow: means over time; the mean pressure's drift, also over the pressure's deviation",
    (
        ("run", "{run}"),
        ("parameters", "{parameters}"),
        ("max speed [m/s]", "{largest_speed}"),
        ("bulk [m/s]", "{bulk_velocity}"),
        ("energy [J/m]", "{kinetic_energy}"),
        ("drift [Pa]", "{mean_pressure_drift}"),
        ("drift / dev.", "{pressure_drift_ratio}"),
        ("f [Hz]", "{dominant_frequency}"),
    ),
)
TIMINGS: tuple[str, tuple[Column, ...]] = (
    "cost of the time steps (full and reduced step given), writing left out: all steps at the "
    "least time of a step, means of ten in a row; on reference points the least of some runs",
    (
        ("run", "{model}"),
        ("parameters", "{parameters}"),
        ("steps full, reduced s", "{full_step:.3g}, {reduced_step:.3g}"),
        ("full s", "{full_seconds:.3g}"),
        ("reduced s", "{reduced_seconds:.3g}"),
        ("speed-up", "{speed_up:.3g}"),
        ("N_d / M", "{compression_factor:.0f}"),
    ),
)
STAGES = "wall-clock of the stages, reading and writing included"
