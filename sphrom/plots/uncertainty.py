"""Plots of uncertainty: fans of quantiles, bars of Sobol indices, and both against runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sphrom.plots.canvas import COLOURS, INK, label_axes, legend_below, line_of, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

COLUMNS = 3
"""Panels beside one another."""
BAND, PALEST, DARKEST = COLOURS[0], 0.12, 0.4
"""Colour of a fan, and the opacities of its outermost and its innermost band."""
BAR = 0.8
"""Width of all bars of a parameter."""


@dataclass(frozen=True)
class Fan:
    """Quantiles of an output over time, or along a line."""

    along: Array
    """(n_instants,)."""
    along_label: str
    label: str
    levels: Array
    """(n_levels,), rising."""
    quantiles: Array
    """(n_levels, n_instants)."""
    interval: Array
    """(2, n_levels, n_instants)."""
    mean: Array
    """(n_instants,)."""


@dataclass(frozen=True)
class Trend:
    """A figure of the first runs, and its interval."""

    count: NDArray[np.int64]
    """(n,) numbers of runs."""
    value: Array
    """(n,)."""
    interval: Array
    """(2, n)."""


def draw_fans(fans: Mapping[str, Fan]) -> Figure:
    """Return a panel of quantiles for every output.

    Bands lie between quantiles that are as far from the middle; dotted lines are the outer ends of
    the outermost quantiles' intervals.
    """
    with styled():
        figure, panels = _grid(len(fans), 2.7)
        for axes, fan in zip(panels, fans.values(), strict=True):
            _fan(axes, fan)
        legend_below(figure, panels[0])
        return figure


def _fan(axes: Axes, fan: Fan) -> None:
    n_bands = len(fan.levels) // 2
    for k in range(n_bands):
        opacity = PALEST + (DARKEST - PALEST) * k / max(1, n_bands - 1)
        label = f"{100.0 * fan.levels[k]:g} to {100.0 * fan.levels[-1 - k]:g} %"
        axes.fill_between(
            fan.along, fan.quantiles[k], fan.quantiles[-1 - k],
            color=BAND, alpha=opacity, lw=0, label=label,
        )  # fmt: skip
    if len(fan.levels) % 2:
        middle = fan.levels[n_bands]
        axes.plot(fan.along, fan.quantiles[n_bands], color=BAND, label=f"{100.0 * middle:g} %")
    axes.plot(fan.along, fan.mean, color=INK, lw=1.0, ls="--", label="mean")
    look: dict[str, Any] = {"color": BAND, "lw": 0.9, "ls": ":"}
    axes.plot(fan.along, fan.interval[0, 0], label="ends of the outer intervals", **look)
    axes.plot(fan.along, fan.interval[1, -1], **look)
    label_axes(axes, fan.along_label, fan.label)
    axes.margins(x=0.01)


def draw_indices(
    bars: Mapping[str, Mapping[str, tuple[Array, Array]]], parameters: Sequence[str]
) -> Figure:
    """Return a panel of Sobol indices for every output, with their intervals.

    `bars` have values (n_parameters,) and ends of intervals (2, n_parameters) by order.
    """
    with styled():
        figure, panels = _grid(len(bars), 2.4)
        for axes, (output, orders) in zip(panels, bars.items(), strict=True):
            width = BAR / len(orders)
            for k, (order, (values, ends)) in enumerate(orders.items()):
                place = np.arange(len(parameters)) + (k + 0.5) * width - BAR / 2
                # An interval of percentiles need not hold the estimate.
                reach = np.maximum(np.stack((values - ends[0], ends[1] - values)), 0.0)
                axes.bar(
                    place, values, 0.9 * width, color=line_of(k).color, alpha=0.75, label=order,
                    yerr=reach, error_kw={"ecolor": INK, "elinewidth": 1.0, "capsize": 2.5},
                )  # fmt: skip
            label_axes(axes, "", "Sobol index [–]")
            axes.set_title(output)
            axes.set_xticks(range(len(parameters)), parameters)
            axes.axhline(0.0, color=INK, lw=0.6)
            axes.set_ylim(min(0.0, axes.get_ylim()[0]), max(1.05, axes.get_ylim()[1]))
        legend_below(figure, panels[0])
        return figure


def draw_trends(panels: Mapping[str, Mapping[str, Trend]]) -> Figure:
    """Return figures against the number of runs, by the label of a panel and the name of a line.

    Bands are intervals of sampling.
    """
    with styled():
        figure, found = _grid(len(panels), 2.7)
        for axes, (label, lines) in zip(found, panels.items(), strict=True):
            for index, (name, trend) in enumerate(lines.items()):
                _trend(axes, trend, index, name)
            label_axes(axes, "runs", label)
            axes.set_xscale("log", base=2)
            axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
        legend_below(figure, found[0])
        return figure


def _trend(axes: Axes, trend: Trend, index: int, name: str) -> None:
    look = line_of(index)
    axes.fill_between(trend.count, *trend.interval, color=look.color, alpha=0.15, lw=0)
    axes.plot(
        trend.count, trend.value, color=look.color, linestyle=look.linestyle, lw=1.2,
        marker=look.marker, markersize=3.0, label=name,
    )  # fmt: skip


def _grid(n_panels: int, height: float) -> tuple[Figure, list[Axes]]:
    """Return a figure with so many panels, in rows of some."""
    columns = min(COLUMNS, n_panels)
    rows = -(-n_panels // columns)
    figure = new_figure(4.2 * columns, height * rows + 0.4)
    panels = list(figure.subplots(rows, columns, squeeze=False).flat)
    for axes in panels[n_panels:]:
        axes.set_visible(False)
    return figure, panels[:n_panels]
