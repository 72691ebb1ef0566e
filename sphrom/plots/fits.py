"""Measured histories beside those of a fitted model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.plots.canvas import COLOURS, INK, label_axes, legend_below, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

MOST_PANELS = 12
"""Histories that are drawn."""
COLUMNS = 2
BAND = 0.3
"""How opaque intervals are."""


@dataclass(frozen=True)
class FitPanel:
    """One history."""

    label: str
    instant: Array
    """(n_values,) [s]."""
    measured: Array
    noise: Array
    fitted: Array
    time: Array
    """(n_snapshots,) [s]."""
    curve: Array
    half_width: Array


def draw_fit(panels: Sequence[FitPanel], *, title: str) -> Figure:
    """Return each measured history with the fitted one, and below it what is left over the noise.

    Raises ValueError without a history.
    """
    if not panels:
        raise ValueError("there is no history to draw")
    shown = panels[:MOST_PANELS]
    columns = min(COLUMNS, len(shown))
    rows = math.ceil(len(shown) / columns)
    with styled():
        figure = new_figure(5.2 * columns + 0.8, 3.1 * rows + 1.2)
        grid = figure.subplots(
            2 * rows, columns, squeeze=False, sharex="col", height_ratios=[3.0, 1.0] * rows
        )
        for k in range(rows * columns):
            row, column = divmod(k, columns)
            upper, lower = grid[2 * row, column], grid[2 * row + 1, column]
            if k < len(shown):
                _history(upper, lower, shown[k])
            else:
                upper.set_visible(False)
                lower.set_visible(False)
        left_out = len(panels) - len(shown)
        more = f"\n{left_out} more histories are not shown" if left_out else ""
        figure.suptitle(title + more, fontsize=9.5)
        legend_below(figure, grid[0, 0])
        return figure


def _history(upper: Axes, lower: Axes, panel: FitPanel) -> None:
    upper.errorbar(
        panel.instant, panel.measured, panel.noise, fmt="o", color=COLOURS[1], markersize=3.0,
        linewidth=0.8, label="measured, with the noise's standard deviation",
    )  # fmt: skip
    low, high = panel.curve - panel.half_width, panel.curve + panel.half_width
    upper.fill_between(
        panel.time, low, high, color=COLOURS[0], alpha=BAND, linewidth=0.0, label="95 % interval"
    )
    upper.plot(panel.time, panel.curve, color=INK, linewidth=1.2, label="fitted model")
    label_axes(upper, "", panel.label)
    lower.plot(
        panel.instant, (panel.measured - panel.fitted) / panel.noise, "o", color=COLOURS[1],
        markersize=2.5,
    )  # fmt: skip
    lower.axhspan(-2.0, 2.0, color="#eeeeee", zorder=0)
    lower.axhline(0.0, color=INK, linewidth=0.8)
    label_axes(lower, "time [s]", "residual\nover noise")
