"""Grids of panels: fields as particles have them, and lines and histories of several runs.

Rows of panels are methods or parameter values, columns cases or quantities, as in Fig. 6-16 of
Rodriguez et al. Particles are drawn as the value of the nearest one, grey where none is near.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.plots.canvas import EXACT_COLOUR, INK, label_axes, new_figure, styled
from sphrom.plots.curves import legend_below, marked_line
from sphrom.plots.pictures import Frame, Raster, bar_below, panel_height, scale_of, show

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

Array = NDArray[np.float64]

WIDEST = 12.0
"""Of a figure [inch]."""
PANEL = 3.0
"""Width of a panel, where there is room [inch]."""
X_TICKS = 4
"""At most, along a picture: labels of neighbours have to stay apart."""
EDGE = 0.06
"""Left free below the labels of colour bars, which reach lower than they say [inch]."""
LETTER = 0.07
"""About the width of a letter of a title [inch]."""
BEYOND = 2.0
"""How far a shared scale follows runs beyond what it is about, over its range."""
SHOWN = (0.5, 99.5)
"""Percentiles that a scale holds: a few points in corners would leave the rest no colour."""
HEADROOM = 1.15
"""Of an axis of errors over the largest one of a run that ran to the end."""


@dataclass(frozen=True)
class Field:
    """A field on scattered points, and how it is told."""

    title: str
    label: str
    """Quantity and unit; fields of one label share a scale where they share one at all."""
    position: Array
    """(n_points, 2) [m]"""
    values: Array
    """(n_points,)"""


@dataclass(frozen=True)
class Curve:
    """A run's line or history."""

    label: str
    x: Array
    y: Array
    complete: bool = True
    """Whether the run ran to the end."""


@dataclass(frozen=True)
class Panel:
    """Curves on axes of their own: full and exact, and reduced runs that have the same look."""

    title: str
    x_label: str
    y_label: str
    runs: Sequence[Curve]
    full: Curve | None = None
    exact: Curve | None = None


@dataclass(frozen=True)
class Scales:
    """Ranges [low, high] of what fields are about, such as those of the full run, by label."""

    about: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def of(self, label: str, fields: Sequence[Array]) -> tuple[float, float]:
        """Return a scale that holds fields as far as they aren't out of all proportion."""
        low, high = _most(np.concatenate(fields))
        if label in self.about:
            least, most = self.about[label]
            reach = BEYOND * (most - least)
            low, high = max(low, least - reach), min(high, most + reach)
        return float(low), float(high)


def _most(values: Array) -> tuple[float, float]:
    """Return a scale that holds all but a few values."""
    told = values[np.isfinite(values)]
    low, high = np.percentile(told, SHOWN) if len(told) else (0.0, 1.0)
    return float(low), float(high)


def _beyond(values: Array, scale: tuple[float, float]) -> tuple[bool, bool]:
    """Return whether values lie below a scale, and above it."""
    return bool((values < scale[0]).any()), bool((values > scale[1]).any())


def draw_field_grid(
    frame: Frame | None, rows: Sequence[Sequence[Field]], *, scales: Scales | None, title: str = ""
) -> Figure:
    """Return fields as a grid of pictures, a colour bar for each label.

    Without `scales` each panel has a scale and a bar of its own. Raises ValueError for no panel.
    """
    columns = max((len(row) for row in rows), default=0)
    if not columns:
        raise ValueError("there is no field to draw")
    frame = frame or Frame(Raster.of(rows[0][0].position).extent)
    rasters = {
        id(panel.position): Raster.of(panel.position, frame.extent) for row in rows for panel in row
    }
    width = min(PANEL, WIDEST / columns)
    own_bars = 0.5 if scales is None else 0.0
    height = panel_height(frame.extent, width)
    with styled():
        figure = new_figure(
            max(columns * width + 0.7, LETTER * len(title)),
            len(rows) * (height + 0.3 + own_bars) + 1.2,
        )
        axes = figure.subplots(len(rows), columns, squeeze=False, sharex=True, sharey=True)
        limits = _shared(rows, scales)
        drawn: dict[str, list[tuple[AxesImage, Axes, tuple[bool, bool]]]] = {}
        for row_axes, row in zip(axes, rows, strict=True):
            for place in row_axes[len(row) :]:
                place.set_axis_off()
            for place, panel in zip(row_axes, row, strict=False):
                values = rasters[id(panel.position)].picture(panel.values)
                colours, scale = scale_of(values, limits.get(panel.label, _most(panel.values)))
                picture = show(place, frame, values, colours, scale)
                beyond = _beyond(panel.values, scale)
                place.locator_params(axis="x", nbins=X_TICKS)
                place.set_title(panel.title, fontsize=min(9.5, 9.5 * width / PANEL + 1.5))
                if scales is None:
                    bar_below(figure, picture, place, "", 18, beyond)
                drawn.setdefault(panel.label, []).append((picture, place, beyond))
            row_axes[0].set_ylabel("y [m]")
        for place in axes[-1]:
            place.set_xlabel("x [m]")
        for label, shown in drawn.items() if scales is not None else ():
            pictures, places, ends = zip(*shown, strict=True)
            below, above = (any(end) for end in zip(*ends, strict=True))
            bar_below(figure, pictures[0], list(places), label, 36, (below, above))
        if title:
            figure.suptitle(title, fontsize=9.5)
        edge = EDGE / figure.get_figheight()
        figure.set_layout_engine("constrained", rect=(0.0, edge, 1.0, 1.0 - edge))
        return figure


def _shared(
    rows: Sequence[Sequence[Field]], scales: Scales | None
) -> dict[str, tuple[float, float]]:
    """Return the scales that panels of one label share."""
    if scales is None:
        return {}
    fields: dict[str, list[Array]] = {}
    for panel in (p for row in rows for p in row):
        fields.setdefault(panel.label, []).append(panel.values)
    return {label: scales.of(label, found) for label, found in fields.items()}


def draw_curve_grid(
    rows: Sequence[Sequence[Panel]], *, from_zero: bool = False, title: str = ""
) -> Figure:
    """Return panels of curves as a grid.

    The axes of `from_zero`, those of errors, begin at zero and follow runs that became unstable no
    farther than `HEADROOM` above the others. Raises ValueError for no panel.
    """
    if not rows or not rows[0]:
        raise ValueError("there is no curve to draw")
    with styled():
        figure = new_figure(5.2 * len(rows[0]), 3.1 * len(rows) + 0.9)
        axes = figure.subplots(len(rows), len(rows[0]), squeeze=False)
        for row_axes, row in zip(axes, rows, strict=True):
            for place, panel in zip(row_axes, row, strict=True):
                _curves(place, panel)
                if from_zero:
                    place.set_ylim(0.0, _highest(panel))
        _legends(figure, axes, rows)
        if title:
            figure.suptitle(title, fontsize=9.5)
        return figure


def _curves(axes: Axes, panel: Panel) -> None:
    if panel.exact is not None:
        axes.plot(panel.exact.x, panel.exact.y, color=EXACT_COLOUR, lw=6.0, label="exact")
    if panel.full is not None:
        axes.plot(panel.full.x, panel.full.y, color=INK, lw=3.2, label="full")
    for index, curve in enumerate(panel.runs):
        marked_line(axes, curve.x, curve.y, index, curve.label)
    label_axes(axes, panel.x_label, panel.y_label)
    axes.set_title(panel.title)
    axes.margins(x=0.01)


def _highest(panel: Panel) -> float | None:
    """Return where an axis of errors ends: above runs that ran to the end, or above all."""
    told = [c for c in panel.runs if len(c.y)]
    some = [c for c in told if c.complete] or told
    highest = max((float(c.y.max()) for c in some), default=0.0)
    return HEADROOM * highest if highest > 0.0 else None


def _legends(figure: Figure, axes: NDArray[np.object_], rows: Sequence[Sequence[Panel]]) -> None:
    """Write one legend below where all rows show the same runs, else one in each row."""
    shown = [tuple(curve.label for curve in row[0].runs) for row in rows]
    if len(set(shown)) == 1:
        legend_below(figure, axes[0, 0])
        return
    for row_axes in axes:
        row_axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
