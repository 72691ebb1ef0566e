"""Line plots: singular values (Fig. 5), centrelines (Fig. 11), error histories (Fig. 12).

The full model is always drawn in ink, the exact solution in grey, and a reduced model has the
same colour, line and marker in every plot in which it has the same place.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sphrom.metrics.discrepancy import cumulative_singular_value_share, without_mean
from sphrom.metrics.histories import History
from sphrom.plots.canvas import (
    EXACT_COLOUR,
    INK,
    Fields,
    label_axes,
    line_of,
    new_figure,
    plain_logarithmic,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

N_MARKERS = 12
"""Markers along a curve, about."""
LETTER, MARGINS = 0.066, 0.6
"""About the width of a letter of a legend, and of what stands beside its labels [inch]."""
LEAST_GAP = 0.09
"""Between the labels of two sizes of a basis in one line, over the width of the axis."""
LINES_OF_LABELS = 2
SMALLEST_RATIO = 1e-12
"""Singular values below this, over the first, are rounding and are not drawn."""
SMALLEST_SHARE = 1e-10
"""[%]; a share left out below this is rounding and is not drawn."""


MEASURES = {
    ("velocity_field", "relative_l2"): "velocity, field: relative L2 [%]",
    ("velocity_line", "relative_l2"): "velocity, line: relative L2 [%]",
    ("velocity_line", "eq41_by_line_range"): "speed, line: Eq. 4.1 by the line's range [%]",
    ("pressure_field", "relative_l2"): "pressure less its mean, field: relative L2 [%]",
    ("pressure_line", "relative_l2"): "pressure less its mean, line: relative L2 [%]",
    ("pressure_line", "eq41_by_line_range"): "pressure, line: Eq. 4.1 by the line's range [%]",
}
"""The errors that are drawn, a row of velocities and one of pressures, and their labels."""


def draw_singular_values(spectra: Mapping[str, Array], marked_modes: Sequence[int] = ()) -> Figure:
    """Return singular values and the share they leave out (Eq. 4.3), per named spectrum.

    `spectra` are, for example, reference space and Lagrangian space; `marked_modes` are the
    basis sizes chosen.
    """
    with styled():
        figure = new_figure(9.0, 3.7)
        left, right = figure.subplots(1, 2)
        for index, (label, values) in enumerate(spectra.items()):
            number, line = np.arange(1, len(values) + 1), line_of(index)
            look: dict[str, Any] = {"color": line.color, "linestyle": line.linestyle}
            relative = values / values[0]
            relative = np.where(relative > SMALLEST_RATIO, relative, np.nan)
            left.semilogy(number, relative, label=label, **look)
            missing = 100.0 - cumulative_singular_value_share(values)
            missing = np.where(missing > SMALLEST_SHARE, missing, np.nan)
            right.semilogy(number, missing, label=label, **look)
        labels = ("singular value, relative to the first [–]", "share left out, 100 − Eq. 4.3 [%]")
        for axes, label in zip((left, right), labels, strict=True):
            label_axes(axes, "mode number M [–]", label)
            axes.set_xscale("log")
            plain_logarithmic(axes.xaxis, *axes.get_xlim())
            _mark_modes(axes, marked_modes)
        legend_below(figure, left)
        return figure


def draw_centrelines(
    y: Array,
    full: Fields,
    reduced: Mapping[str, Fields],
    *,
    exact: Fields | None = None,
    about: str = "",
) -> Figure:
    """Return speed and pressure against y [m]: full, reduced models, exact, at an instant.

    The pressure is drawn twice, as it is and less its mean. `about` says where and when.
    """
    panels: dict[str, Callable[[Fields], Array]] = {
        "speed [m/s]": lambda fields: fields.speed,
        "pressure [Pa]": lambda fields: fields.pressure,
        "pressure less its mean [Pa]": lambda fields: without_mean(fields.pressure),
    }
    with styled():
        figure = new_figure(12.6, 4.0)
        for axes, (label, of) in zip(figure.subplots(1, 3), panels.items(), strict=True):
            if exact is not None:
                axes.plot(y, of(exact), color=EXACT_COLOUR, lw=4.5, label="exact")
            axes.plot(y, of(full), color=INK, label="full")
            for index, (model, fields) in enumerate(reduced.items()):
                marked_line(axes, y, of(fields), index, model)
            label_axes(axes, "y [m]", label)
            axes.margins(x=0.01)
        if about:
            figure.suptitle(about, fontsize=9.5)
        legend_below(figure, figure.axes[0])
        return figure


def draw_error_histories(
    reduced: Mapping[str, History],
    *,
    best: History | None = None,
    full_against_exact: History | None = None,
    log_scale: bool = False,
    about: str = "",
) -> Figure:
    """Return the errors of velocity and pressure over time, per reduced model, in six panels.

    The first two of each row are relative L2 norms, over the field and on the line, the last is
    Eq. 4.1 on the line. `best` is the best possible error in the basis, the full model's projection
    onto it.
    """
    with styled():
        figure = new_figure(12.6, 7.2)
        for axes, measure in zip(figure.subplots(2, 3).flat, MEASURES, strict=True):
            if full_against_exact is not None:
                time, error = _drawn(full_against_exact, measure, log_scale)
                axes.plot(time, error, color=EXACT_COLOUR, label="full against exact")
            if best is not None:
                time, error = _drawn(best, measure, log_scale)
                axes.plot(time, error, ":", color=INK, label="best possible (projection)")
            plot_errors(axes, measure, reduced, log_scale)
        if about:
            figure.suptitle(about, fontsize=9.5)
        legend_below(figure, figure.axes[0])
        return figure


def plot_errors(
    axes: Axes, measure: tuple[str, str], reduced: Mapping[str, History], log_scale: bool = False
) -> None:
    """Draw the histories of one error, a key of MEASURES, into axes."""
    for index, (model, history) in enumerate(reduced.items()):
        marked_line(axes, *_drawn(history, measure, log_scale), index, model)
    label_axes(axes, "time [s]", MEASURES[measure])
    axes.margins(x=0.01)
    if log_scale:
        axes.set_yscale("log")
        plain_logarithmic(axes.yaxis, *axes.get_ylim())
    else:
        axes.set_ylim(bottom=0.0)


def _drawn(history: History, measure: tuple[str, str], log_scale: bool) -> tuple[Array, Array]:
    """Return times and errors, less the zeros that a logarithmic axis can't show."""
    place, name = measure
    values: Array = getattr(history.places[place], name)
    return history.time, np.where(values > 0.0, values, np.nan) if log_scale else values


def marked_line(axes: Axes, x: Array, y: Array, index: int, label: str) -> None:
    """Draw a reduced model's line; markers of several models never hide one another."""
    line, spacing = line_of(index), max(1, len(x) // N_MARKERS)
    axes.plot(
        x,
        y,
        color=line.color,
        linestyle=line.linestyle,
        marker=line.marker,
        linewidth=1.3,
        markersize=4.2,
        markerfacecolor="white",
        markevery=(index * spacing // 4 % spacing, spacing),
        label=label,
    )


def _mark_modes(axes: Axes, marked_modes: Sequence[int]) -> None:
    low, high = np.log(axes.get_xlim())
    ends = [-np.inf] * LINES_OF_LABELS
    for n_modes in marked_modes:
        axes.axvline(n_modes, color="#777777", linewidth=0.9, linestyle=":", zorder=1)
        place = (np.log(n_modes) - low) / (high - low)
        line = next((k for k, end in enumerate(ends) if place - end >= LEAST_GAP), None)
        if line is None:
            continue  # its label would stand on another
        first = np.isinf(ends[0])
        ends[line] = place
        axes.annotate(
            f"M = {n_modes}" if first else f"{n_modes}",
            (n_modes, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 2 + 9 * line),
            textcoords="offset points",
            ha="center",
            fontsize=8.0,
        )


def legend_below(figure: Figure, axes: Axes) -> None:
    """Write the legend of one panel below a figure."""
    handles, labels = axes.get_legend_handles_labels()
    entry = LETTER * max(map(len, labels)) + MARGINS
    columns = max(1, min(4, len(labels), int(figure.get_figwidth() / entry)))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns)
