"""Error against seconds, and maps of stability by modes and a property that is varied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sphrom.plots.canvas import (
    INK,
    label_axes,
    legend_below,
    line_of,
    new_figure,
    plain_logarithmic,
    styled,
)
from sphrom.text import exact

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST_MARGIN = 1.3
"""Around errors on a logarithmic axis, as a factor."""
SIDE_MARGIN = 0.2
"""Beside models, for their names, over the axis."""
GAIN = 0.95
"""The largest error over that of the point named before, for a point to be named."""
FRONT: dict[str, Any] = {
    "color": "#777777",
    "linewidth": 4.0,
    "alpha": 0.35,
    "drawstyle": "steps-post",
    "label": "Pareto front (models filled)",
    "zorder": 1,
}
STATES = {
    "stable": ("#56B4E9", ""),
    "inaccurate": ("#E69F00", "~"),
    "unstable": ("#D55E00", "×"),
    "full unstable": ("#999999", "×"),
    "refused": ("#E5E5E5", "–"),
}
"""The colour and the sign of each state."""
PANEL = 3.3
"""Width and height of a map [inch]."""
IN_A_ROW = 4


@dataclass(frozen=True)
class Point:
    """One model in the plane of seconds and error."""

    group: str
    """Models of a group share colour and marker."""
    label: str
    seconds: float
    errors: tuple[float, ...]
    """By quantity [%], such as velocity and pressure."""
    on_front: tuple[bool, ...]


@dataclass(frozen=True)
class StabilityMap:
    """The state of models by modes and a varied property."""

    title: str
    axis: str
    """The varied property."""
    n_modes: Sequence[int]
    values: Sequence[float]
    """Of the varied property."""
    states: Mapping[tuple[int, float], str]
    """By modes and value: a key of STATES."""


def draw_trade(
    points: Sequence[Point],
    full_seconds: float | None,
    measure: str,
    without: Mapping[str, tuple[float, ...]],
    quantities: Sequence[str] = ("velocity", "pressure"),
) -> Figure:
    """Return errors against seconds of a run with their Pareto fronts, a panel for each quantity.

    `full_seconds` is the time of the case's own full run [s], None if unknown; `measure` names the
    error; `without` has the errors [%] without any model, by name.
    """
    groups = list(dict.fromkeys(point.group for point in points))
    with styled():
        figure = new_figure(5.5 * max(len(quantities), 1.3), 5.2)
        panels = figure.subplots(1, len(quantities), sharex=True, squeeze=False)[0]
        for index, (axes, quantity) in enumerate(zip(panels, quantities, strict=True)):
            # An error of zero, of a run that is the full one, has no place on a logarithmic axis.
            shown = [point for point in points if point.errors[index] > 0.0]
            levels = {name: each[index] for name, each in without.items() if each[index] > 0.0}
            axes.set_xscale("log")
            if shown:
                _set_room(axes, [*(point.errors[index] for point in shown), *levels.values()])
            _draw_front(axes, [p for p in shown if p.on_front[index]], index)
            for number, group in enumerate(groups):
                _draw_group(axes, [p for p in shown if p.group == group], index, number)
            if full_seconds is not None:
                look = {"color": INK, "linewidth": 1.0, "linestyle": ":"}
                axes.axvline(full_seconds, label="full run", **look)
            for (name, error), dashes in zip(levels.items(), ("--", "-."), strict=False):
                axes.axhline(error, color=INK, linewidth=0.9, linestyle=dashes, label=name)
            label_axes(axes, "seconds of a run [s]", f"{quantity}, {measure} [%]")
        legend_below(figure, panels[0])
        return figure


def _set_room(axes: Axes, errors: Sequence[float]) -> None:
    """Set limits of logarithmic axes with room around errors, a decade at least."""
    low, high = min(errors), max(errors)
    margin = max(LEAST_MARGIN, (10.0 * low / high) ** 0.5)
    axes.set_yscale("log")
    axes.set_ylim(low / margin, high * margin)
    axes.margins(x=SIDE_MARGIN)
    plain_logarithmic(axes.yaxis, *axes.get_ylim())


def _draw_front(axes: Axes, points: Sequence[Point], index: int) -> None:
    """Draw a front, and name its last point and earlier ones that gain in accuracy."""
    front = sorted((p.seconds, p.errors[index], p.label) for p in points)
    if not front:
        return
    axes.plot([point[0] for point in front], [point[1] for point in front], **FRONT)
    least = float("inf")
    for seconds, error, label in front:
        if error < GAIN * least or (seconds, error, label) == front[-1]:
            least = error
            place: dict[str, Any] = {"xytext": (4, 4), "textcoords": "offset points"}
            axes.annotate(label, (seconds, error), fontsize=7.5, **place)


def _draw_group(axes: Axes, points: Sequence[Point], index: int, number: int) -> None:
    """Draw a marker for each model, filled on the front."""
    line = line_of(number)
    for on_front in (False, True):
        drawn = [point for point in points if point.on_front[index] is on_front]
        axes.plot(
            [point.seconds for point in drawn],
            [point.errors[index] for point in drawn],
            color=line.color,
            marker=line.marker,
            linestyle="none",
            markersize=5.5,
            markerfacecolor=line.color if on_front else "white",
            zorder=3 if on_front else 2,
            label=None if on_front or not points else points[0].group,
        )


def draw_stability(maps: Sequence[StabilityMap]) -> Figure:
    """Return maps of the models that are stable, and of those that are accurate."""
    from matplotlib.patches import Patch

    n_rows, n_columns = -(-len(maps) // IN_A_ROW), min(len(maps), IN_A_ROW)
    with styled():
        figure = new_figure(PANEL * n_columns, PANEL * n_rows + 0.5)
        panels = figure.subplots(n_rows, n_columns, squeeze=False).ravel()
        for axes, each in zip(panels, maps, strict=False):
            _draw_map(axes, each)
        for axes in panels[len(maps) :]:
            axes.set_axis_off()
        shown = {state for each in maps for state in each.states.values()}
        handles = [
            Patch(facecolor=colour, label=f"{state} {sign}".strip())
            for state, (colour, sign) in STATES.items()
            if state in shown
        ]
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
        return figure


def _draw_map(axes: Axes, drawn: StabilityMap) -> None:
    from matplotlib.patches import Rectangle

    for (n_modes, value), state in drawn.states.items():
        colour, sign = STATES[state]
        x, y = drawn.values.index(value), drawn.n_modes.index(n_modes)
        axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, facecolor=colour, edgecolor="white"))
        axes.text(x, y, sign, ha="center", va="center", fontsize=9.0)
    axes.set_xlim(-0.5, len(drawn.values) - 0.5)
    axes.set_ylim(-0.5, len(drawn.n_modes) - 0.5)
    axes.set_xticks(range(len(drawn.values)), [exact(v) for v in drawn.values], rotation=90)
    axes.set_yticks(range(len(drawn.n_modes)), [str(m) for m in drawn.n_modes])
    axes.set(title=drawn.title, xlabel=drawn.axis, ylabel="modes M [–]")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
