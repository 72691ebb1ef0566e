"""Figures of a trade: error against seconds, and where reduced models are stable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.plots.canvas import INK, line_of, new_figure, open_frame, plain_logarithmic, styled
from sphrom.plots.curves import legend_below
from sphrom.plots.labels import name_points
from sphrom.text import exact

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

Array = NDArray[np.float64]

QUANTITIES = ("velocity", "pressure")
LEAST_MARGIN = 1.3
"""Around errors on a logarithmic axis, as a factor."""
SIDE_MARGIN = 0.2
"""Beside models, for their names, over the axis."""
GAIN = 0.95
"""What the error is at most over that of the point named before, for a point to be named."""
FRONT_COLOUR = "#777777"
STATES = {
    "stable": ("#56B4E9", ""),
    "inaccurate": ("#E69F00", "~"),
    "unstable": ("#D55E00", "×"),
    "full unstable": ("#999999", "×"),
    "refused": ("#E5E5E5", "–"),
}
"""The colour and the sign of each state."""
CELL = 0.36
"""Of a map [inch]."""
LEAST_CELLS = 5.5
"""How wide a map is at least, in cells, for its title."""
LEAST_ROWS = 4
"""How tall a map is at least, in cells, for the name of its axis."""
MARGIN_CELLS = 0.8
"""Beside a map, in cells."""


@dataclass(frozen=True)
class Point:
    """One model in the plane of seconds and error."""

    group: str
    """Models of a group share colour and marker."""
    label: str
    seconds: float
    errors: tuple[float, float]
    """Of velocity and pressure [%]."""
    on_front: tuple[bool, bool]


def draw_trade(
    points: Sequence[Point],
    full_seconds: float | None,
    measure: str,
    nothing: Mapping[str, tuple[float, float]],
) -> Figure:
    """Return velocity and pressure error against seconds of a run, with their Pareto fronts.

    `full_seconds` [s] are those of the case's own full run, None where nobody knows, `measure` says
    which error it is, and `nothing` has those of velocity and pressure [%] without any model.
    """
    with styled():
        figure = new_figure(11.0, 5.2)
        panels = figure.subplots(1, 2, sharex=True)
        for index, (axes, quantity) in enumerate(zip(panels, QUANTITIES, strict=True)):
            without = {
                name: errors[index] for name, errors in nothing.items() if errors[index] > 0.0
            }
            _draw_quantity(axes, points, index, list(without.values()))
            if full_seconds is not None:
                axes.axvline(
                    full_seconds, color=INK, linewidth=1.0, linestyle=":", label="full run"
                )
            for (name, error), dashes in zip(without.items(), ("--", "-."), strict=False):
                axes.axhline(error, color=INK, linewidth=0.9, linestyle=dashes, label=name)
            axes.set_xlabel("seconds of a run [s]")
            axes.set_ylabel(f"{quantity}, {measure} [%]")
            open_frame(axes)
        legend_below(figure, panels[0])
        for index, axes in enumerate(panels):
            _name(figure, axes, points, index)
        return figure


def _draw_quantity(
    axes: Axes, points: Sequence[Point], index: int, others: Sequence[float]
) -> None:
    """Draw models and their front on axes that have room for other errors too."""
    axes.set_xscale("log")
    # An error of zero, of a run that is the full one, has no place on a logarithmic axis.
    shown = [point for point in points if point.errors[index] > 0.0]
    if shown:
        axes.set_yscale("log")
        axes.set_ylim(*_room([*(point.errors[index] for point in shown), *others]))
        axes.margins(x=SIDE_MARGIN)
        plain_logarithmic(axes.yaxis, *axes.get_ylim())
    front = sorted((p.seconds, p.errors[index]) for p in shown if p.on_front[index])
    if front:
        axes.plot(
            *zip(*front, strict=True),
            color=FRONT_COLOUR,
            linewidth=4.0,
            alpha=0.35,
            drawstyle="steps-post",
            label="Pareto front (models filled)",
            zorder=1,
        )
    for number, group in enumerate(dict.fromkeys(point.group for point in points)):
        members = [point for point in shown if point.group == group]
        line = line_of(number)
        for on_front in (False, True):
            drawn = [point for point in members if point.on_front[index] is on_front]
            axes.plot(
                [point.seconds for point in drawn],
                [point.errors[index] for point in drawn],
                color=line.color,
                marker=line.marker,
                linestyle="none",
                markersize=5.5,
                markerfacecolor=line.color if on_front else "white",
                zorder=3 if on_front else 2,
                label=None if on_front else group,
            )


def _room(errors: Sequence[float]) -> tuple[float, float]:
    """Return limits of a logarithmic axis with room around errors, a decade at least."""
    low, high = min(errors), max(errors)
    margin = max(LEAST_MARGIN, (10.0 * low / high) ** 0.5)
    return low / margin, high * margin


def _name(figure: Figure, axes: Axes, points: Sequence[Point], index: int) -> None:
    """Write names beside points on a front: the last, and those before it that gain something."""
    shown = [(p.label, p.seconds, p.errors[index]) for p in points if p.errors[index] > 0.0]
    front = sorted(
        ((p.label, p.seconds, p.errors[index]) for p in points if p.on_front[index]),
        key=lambda point: point[1:],
    )
    named: list[tuple[str, float, float]] = []
    for point in front:
        if point in shown and (not named or point is front[-1] or point[2] < GAIN * named[-1][2]):
            named.append(point)
    name_points(figure, axes, named, [point[1:] for point in shown if point not in named])


@dataclass(frozen=True)
class StabilityMap:
    """The state of models by modes and what is varied."""

    title: str
    axis: str
    """What is varied."""
    n_modes: Sequence[int]
    values: Sequence[float]
    """Of what is varied."""
    states: Mapping[tuple[int, float], str]
    """By modes and value: a key of STATES."""


def draw_stability(rows: Sequence[Sequence[StabilityMap]]) -> Figure:
    """Return rows of maps: which models are stable, and which accurate."""
    with styled():
        cells = max(sum(_width(each) for each in maps) for maps in rows)
        longest = max(len(each.n_modes) for maps in rows for each in maps)
        height = 1.3 + CELL * max(LEAST_ROWS, longest)
        figure = new_figure(1.2 + CELL * cells, height * len(rows) + 0.3)
        shown = [each for maps in rows for each in maps]
        # The legend stands below all rows.
        below = figure.subfigures(len(rows), 1, squeeze=False)[:, 0]
        for part, maps in zip(below, rows, strict=True):
            _draw_row(part, maps, cells)
        _explain_states(figure, {state for each in shown for state in each.states.values()})
        return figure


def _width(drawn: StabilityMap) -> float:
    """Return how wide a map is, in cells: its title needs some of it."""
    return max(LEAST_CELLS, len(drawn.values)) + MARGIN_CELLS


def _draw_row(part: SubFigure, maps: Sequence[StabilityMap], cells: float) -> None:
    """Draw maps side by side, as wide as they have values, and nothing beside them."""
    widths = [_width(each) for each in maps]
    rest = cells - sum(widths)
    ratios = [*widths, rest] if rest > 0.0 else widths
    panels = part.subplots(1, len(ratios), sharey=True, squeeze=False, width_ratios=ratios)[0]
    for axes, each in zip(panels, maps, strict=False):
        _draw_map(axes, each)
    for axes in panels[len(maps) :]:
        axes.set_axis_off()
    panels[0].set_ylabel("modes M [–]")
    part.align_xlabels(list(panels[: len(maps)]))


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
    axes.set_title(drawn.title)
    axes.set_xlabel(drawn.axis)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def _explain_states(figure: Figure, shown: Set[str]) -> None:
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=colour, label=f"{state} {sign}".strip())
        for state, (colour, sign) in STATES.items()
        if state in shown
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
