"""Figures of a trade: error against seconds, and where reduced models are stable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.report.canvas import INK, line_of, new_figure, open_frame, plain_logarithmic, styled
from sphrom.report.curves import legend_below

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

QUANTITIES = ("velocity", "pressure")
LEAST_MARGIN = 1.3
"""Around errors on a logarithmic axis, as a factor."""
SIDE_MARGIN = 0.2
"""Beside models, for their names, over the axis."""
FRONT_COLOUR = "#777777"
STATES = {
    "stable": ("#56B4E9", ""),
    "inaccurate": ("#E69F00", "~"),
    "unstable": ("#D55E00", "×"),
}
"""The colour and the sign of each state."""


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


def draw_trade(points: Sequence[Point], full_seconds: float, measure: str) -> Figure:
    """Return velocity and pressure error against seconds of a run, with their Pareto fronts.

    `full_seconds` [s] are those of the case's own full run, `measure` says which error it is.
    """
    with styled():
        figure = new_figure(11.0, 4.6)
        panels = figure.subplots(1, 2, sharex=True)
        for index, (axes, quantity) in enumerate(zip(panels, QUANTITIES, strict=True)):
            _draw_quantity(axes, points, index)
            axes.axvline(full_seconds, color=INK, linewidth=1.0, linestyle=":", label="full run")
            axes.set_xlabel("seconds of a run [s]")
            axes.set_ylabel(f"{quantity}, {measure} [%]")
            open_frame(axes)
        legend_below(figure, panels[0])
        return figure


def _draw_quantity(axes: Axes, points: Sequence[Point], index: int) -> None:
    axes.set_xscale("log")
    # An error of zero, of a run that is the full one, has no place on a logarithmic axis.
    shown = [point for point in points if point.errors[index] > 0.0]
    if shown:
        axes.set_yscale("log")
        axes.set_ylim(*_room([point.errors[index] for point in shown]))
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
                label=None if on_front else group,
            )
    _name(axes, [point for point in shown if point.on_front[index]], index)


def _room(errors: Sequence[float]) -> tuple[float, float]:
    """Return limits of a logarithmic axis with room around errors, a decade at least."""
    low, high = min(errors), max(errors)
    margin = max(LEAST_MARGIN, (10.0 * low / high) ** 0.5)
    return low / margin, high * margin


def _name(axes: Axes, points: Sequence[Point], index: int) -> None:
    """Write the names of points on a front below and left of them, where no other model is."""
    for point in points:
        axes.annotate(
            point.label,
            (point.seconds, point.errors[index]),
            xytext=(-5, -3),
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=7.5,
        )


@dataclass(frozen=True)
class StabilityMap:
    """The state of models at one parameter value, by modes and time step."""

    title: str
    n_modes: Sequence[int]
    step_factors: Sequence[float]
    """Time steps over the limit [-]."""
    states: Mapping[tuple[int, float], str]
    """By modes and step: a key of STATES."""


def draw_stability(maps: Sequence[StabilityMap]) -> Figure:
    """Return a picture for each parameter value: which models are stable, and which accurate."""
    with styled():
        width = 1.2 + max(2.0, 0.36 * max(len(each.step_factors) for each in maps)) * len(maps)
        figure = new_figure(width, 3.6)
        panels = figure.subplots(1, len(maps), sharey=True, squeeze=False)[0]
        for axes, each in zip(panels, maps, strict=True):
            _draw_map(axes, each)
        panels[0].set_ylabel("modes M [–]")
        _explain_states(figure)
        return figure


def _draw_map(axes: Axes, drawn: StabilityMap) -> None:
    from matplotlib.patches import Rectangle

    for (n_modes, factor), state in drawn.states.items():
        colour, sign = STATES[state]
        x, y = drawn.step_factors.index(factor), drawn.n_modes.index(n_modes)
        axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, facecolor=colour, edgecolor="white"))
        axes.text(x, y, sign, ha="center", va="center", fontsize=9.0)
    axes.set_xlim(-0.5, len(drawn.step_factors) - 0.5)
    axes.set_ylim(-0.5, len(drawn.n_modes) - 0.5)
    axes.set_xticks(
        range(len(drawn.step_factors)), [f"{f:g}" for f in drawn.step_factors], rotation=90
    )
    axes.set_yticks(range(len(drawn.n_modes)), [str(m) for m in drawn.n_modes])
    axes.set_title(drawn.title)
    axes.set_xlabel("step over its limit [–]")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def _explain_states(figure: Figure) -> None:
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=colour, label=f"{state} {sign}".strip())
        for state, (colour, sign) in STATES.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
