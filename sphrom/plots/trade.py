"""The plot of a trade: error against seconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.plots.canvas import (
    INK,
    label_axes,
    legend_below,
    line_of,
    new_figure,
    plain_logarithmic,
    styled,
)
from sphrom.plots.labels import name_points

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

LEAST_MARGIN = 1.3
"""Around errors on a logarithmic axis, as a factor."""
SIDE_MARGIN = 0.2
"""Beside models, for their names, over the axis."""
GAIN = 0.95
"""The largest error over that of the point named before, for a point to be named."""
FRONT_COLOUR = "#777777"


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


def draw_trade(
    points: Sequence[Point],
    full_seconds: float | None,
    measure: str,
    nothing: Mapping[str, tuple[float, ...]],
    quantities: Sequence[str] = ("velocity", "pressure"),
) -> Figure:
    """Return errors against seconds of a run with their Pareto fronts, a panel for each quantity.

    `full_seconds` is the time of the case's own full run [s], None if unknown; `measure` names the
    error; `nothing` has the errors [%] without any model, by name.
    """
    with styled():
        figure = new_figure(5.5 * max(len(quantities), 1.3), 5.2)
        panels = figure.subplots(1, len(quantities), sharex=True, squeeze=False)[0]
        for index, (axes, quantity) in enumerate(zip(panels, quantities, strict=True)):
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
            label_axes(axes, "seconds of a run [s]", f"{quantity}, {measure} [%]")
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
    _draw_models(axes, points, index)


def _draw_models(axes: Axes, points: Sequence[Point], index: int) -> None:
    """Draw a marker for each model, filled on the front."""
    for number, group in enumerate(dict.fromkeys(point.group for point in points)):
        members = [point for point in points if point.group == group and point.errors[index] > 0.0]
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
    """Write names beside points on a front: the last, and earlier ones that gain in accuracy."""
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
