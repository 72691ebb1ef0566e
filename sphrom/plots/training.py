"""The plot of a training: where it ran the full model, and how its estimate fell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.plots.canvas import (
    COLOURS,
    INK,
    SPEED_MAP,
    label_axes,
    new_figure,
    plain_logarithmic,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

LABELS = {"reynolds": "Re [–]"}
"""Of parameters with a usual symbol."""
FADED = 0.25
"""Opacity of the estimates of the first stage; that of the last is one."""
MARGIN = 1.5
"""Around errors on a logarithmic axis, as a factor."""


@dataclass(frozen=True)
class TrainingPlot:
    """What a training found; errors are [%]."""

    names: tuple[str, ...]
    """The parameters of the region."""
    candidates: Array
    """(n_candidates, n_parameters)."""
    estimates: tuple[Array, ...]
    """By stage (n_candidates,), corrected; infinite where there are none."""
    trained: Array
    """(n_trained, n_parameters), in order."""
    n_first: int
    """How many of them were there before the first stage."""
    n_runs: tuple[int, ...]
    """By stage, full runs that the model learnt from."""
    held_out: Array
    """(n_held_out, n_parameters)."""
    errors: Array
    """(n_held_out,) of the models that had not seen them."""
    learnt: tuple[int, ...]
    """By run held out: full runs that its model learnt from."""
    tolerance: float
    quantity: str


def draw_training(plot: TrainingPlot) -> Figure:
    """Return two panels: estimates over the region with the runs, and the fall of the worst."""
    with styled():
        figure = new_figure(10.0, 4.6)
        region, fall = figure.subplots(1, 2)
        if len(plot.names) == 1:
            _draw_line(region, plot)
        else:
            _draw_plane(figure, region, plot)
        _draw_fall(fall, plot)
        return figure


def _draw_line(axes: Axes, plot: TrainingPlot) -> None:
    """Draw the estimates of every stage over the one parameter."""
    values = plot.candidates[:, 0]
    order, n_stages = np.argsort(values), len(plot.estimates)
    shown = [plot.tolerance, *plot.errors]
    for stage, estimates in enumerate(plot.estimates):
        drawn = np.where(np.isfinite(estimates), estimates, np.nan)
        opacity = FADED + (1.0 - FADED) * (stage + 1) / n_stages
        label = f"estimate, {plot.n_runs[stage]} runs" if stage in (0, n_stages - 1) else None
        axes.plot(values[order], drawn[order], color=COLOURS[0], alpha=opacity, label=label)
        shown += drawn[drawn > 0.0].tolist()
    axes.plot(
        plot.held_out[:, 0], plot.errors, "s", color=COLOURS[1], label="true, before it was seen"
    )
    _tolerance(axes, plot)
    low = min(value for value in shown if np.isfinite(value) and value > 0.0)
    axes.plot(
        plot.trained[:, 0],
        np.full(len(plot.trained), low / MARGIN),
        "|",
        color=INK,
        markersize=12,
        label="full runs learnt from",
    )
    label_axes(axes, LABELS.get(plot.names[0], plot.names[0]), f"error of {plot.quantity} [%]")
    _logarithmic(axes, shown)
    if plot.names[0] == "reynolds":
        axes.set_xscale("log")
        plain_logarithmic(axes.xaxis, float(values.min()), float(values.max()))
    axes.legend(fontsize=7.0)


def _draw_plane(figure: Figure, axes: Axes, plot: TrainingPlot) -> None:
    """Draw the last estimates over the first two parameters, and the runs with their numbers."""
    estimates = plot.estimates[-1]
    known = np.isfinite(estimates)
    x, y = plot.candidates[known, :2].T
    dots = axes.scatter(x, y, c=estimates[known], cmap=SPEED_MAP, s=14, linewidths=0)
    figure.colorbar(dots, ax=axes, label=f"estimated error of {plot.quantity} [%]")
    axes.plot(*plot.trained[:, :2].T, "o", color="white", markeredgecolor=INK, markersize=11)
    for number, place in enumerate(plot.trained[:, :2], start=1):
        axes.annotate(str(number), tuple(place), ha="center", va="center", fontsize=7.0)
    label_axes(axes, *(LABELS.get(name, name) for name in plot.names[:2]))
    if plot.names[0] == "reynolds":
        axes.set_xscale("log")
        values = plot.candidates[:, 0]
        plain_logarithmic(axes.xaxis, float(values.min()), float(values.max()))
    axes.set_title(f"estimate of the last stage; runs 1 to {plot.n_first} came first")


def _draw_fall(axes: Axes, plot: TrainingPlot) -> None:
    """Draw the worst estimate and the true errors of runs held out by the number of runs."""
    worst = [float(np.max(each)) for each in plot.estimates]
    drawn = [value if np.isfinite(value) else np.nan for value in worst]
    axes.plot(plot.n_runs, drawn, "o-", color=COLOURS[0], label="worst estimate")
    axes.plot(plot.learnt, plot.errors, "s", color=COLOURS[1], label="true, before it was seen")
    _tolerance(axes, plot)
    label_axes(axes, "full runs learnt from", f"error of {plot.quantity} [%]")
    axes.set_xticks(list(plot.n_runs))
    _logarithmic(axes, [*drawn, *plot.errors, plot.tolerance])
    axes.legend(fontsize=7.0)


def _tolerance(axes: Axes, plot: TrainingPlot) -> None:
    axes.axhline(plot.tolerance, color=INK, linestyle=":", linewidth=1.0, label="tolerance")


def _logarithmic(axes: Axes, values: list[float]) -> None:
    known = [value for value in values if np.isfinite(value) and value > 0.0]
    low, high = min(known) / MARGIN**2, max(known) * MARGIN
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    plain_logarithmic(axes.yaxis, low, high)
