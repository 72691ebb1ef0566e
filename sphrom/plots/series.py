"""Line plots of the full model beside others: reference profiles, and histories at one place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.plots.canvas import INK, label_axes, line_of, new_figure, styled
from sphrom.plots.curves import legend_below, marked_line

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

MOST_MARKERS = 26
"""Markers along a reference that is known at many points, about."""


@dataclass(frozen=True)
class ComparedProfile:
    """A profile of the full model, and the reference for it."""

    reference_label: str
    label: str
    coordinate: Array
    """(n_line,)"""
    value: Array
    """(n_line,)"""
    reference_coordinate: Array
    """(n_points,)"""
    reference_value: Array
    """(n_points,)"""


def draw_profiles(
    panels: Mapping[tuple[str, str], Sequence[ComparedProfile]], *, title: str = ""
) -> Figure:
    """Return a panel for the profiles of each quantity, by the labels of its axes.

    The full model is a line, a reference its markers; several at one time share a line. Raises
    ValueError without a panel.
    """
    if not panels:
        raise ValueError("there is no profile to draw")
    with styled():
        figure = new_figure(4.5 * len(panels), 4.4)
        for axes, ((along, quantity), profiles) in zip(
            figure.subplots(1, len(panels), squeeze=False)[0], panels.items(), strict=True
        ):
            _profiles(axes, profiles)
            label_axes(axes, along, quantity)
            axes.legend(fontsize=7.5)
        if title:
            figure.suptitle(title, fontsize=9.5)
        return figure


def _profiles(axes: Axes, profiles: Sequence[ComparedProfile]) -> None:
    drawn: set[str] = set()
    for index, profile in enumerate(profiles):
        look = line_of(index)
        if profile.label not in drawn:
            drawn.add(profile.label)
            axes.plot(
                profile.coordinate,
                profile.value,
                color=INK if len(drawn) == 1 else "#777777",
                linestyle=line_of(len(drawn) - 1).linestyle,
                label=profile.label,
            )
        every = max(1, len(profile.reference_coordinate) // MOST_MARKERS)
        axes.plot(
            profile.reference_coordinate,
            profile.reference_value,
            linestyle="none",
            color=look.color,
            marker=look.marker,
            markersize=4.2,
            markerfacecolor="white",
            markevery=every,
            label=profile.reference_label,
        )


def draw_history(
    full: tuple[Array, Array],
    reduced: Mapping[str, tuple[Array, Array]],
    *,
    label: str,
    title: str = "",
) -> Figure:
    """Return a quantity at one place over time [s]: full and reduced models, each (time, value)."""
    with styled():
        figure = new_figure(9.0, 3.6)
        axes = figure.subplots()
        axes.plot(*full, color=INK, label="full")
        for index, (model, (time, value)) in enumerate(reduced.items()):
            marked_line(axes, time, value, index, model)
        label_axes(axes, "time [s]", label)
        axes.margins(x=0.01)
        if title:
            figure.suptitle(title, fontsize=9.5)
        legend_below(figure, axes)
        return figure


def draw_measured(
    along: tuple[str, Array], panels: Mapping[str, Mapping[str, Array]], *, title: str
) -> Figure:
    """Return quantities over time or along a line, a panel for each by its label.

    `along` has the label and the values (n_values,) of the horizontal axis. A panel has values
    (n_values,) of the full model first, then of others, by name.
    """
    label_along, coordinate = along
    with styled():
        figure = new_figure(4.2 * len(panels), 3.6)
        axes_of = figure.subplots(1, len(panels), squeeze=False)[0]
        for axes, (label, curves) in zip(axes_of, panels.items(), strict=True):
            (full, values), *reduced = curves.items()
            axes.plot(coordinate, values, color=INK, label=full)
            for index, (model, its) in enumerate(reduced):
                marked_line(axes, coordinate, its, index, model)
            label_axes(axes, label_along, label)
        figure.suptitle(title, fontsize=9.5)
        legend_below(figure, axes_of[0])
        return figure
