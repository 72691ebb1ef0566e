"""The grid of panels that figures of a comparison are: pictures of fields, and curves.

The full model is always drawn in ink, the exact solution in grey, and a reduced model has the
same colour, line and marker in every panel in which it has the same place.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from sphrom.plots.canvas import (
    DASHES,
    DIFFERENCE_MAP,
    EXACT_COLOUR,
    INK,
    TITLE,
    label_axes,
    legend_below,
    line_of,
    marked_line,
    new_figure,
    plain_logarithmic,
    styled,
    symmetric_limits,
)
from sphrom.plots.pictures import Frame, bar_below, scale_of, show

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Range = tuple[float, float]
Role = Literal["run", "full", "exact", "best", "level", "reference"]

WIDEST = 12.0
"""All pictures beside one another [inch]."""
PICTURE = 3.0
"""Width of a picture, where there is room [inch]."""
CURVES = (4.4, 3.2)
"""Width and height of a panel of curves [inch]."""
LEAST_WIDTH = 7.5
"""Of a figure [inch]."""
X_TICKS = 4
"""At most, along a picture: labels of neighbours have to stay apart."""
EDGE = 0.06
"""Left free below the labels of colour bars, which reach lower than they say [inch]."""
LETTER = 0.07
"""About the width of a letter of a title [inch]."""
BEYOND = 2.0
"""How far a shared scale follows runs beyond the given range, over that range."""
SHOWN = (0.5, 99.5)
"""Percentiles that a scale holds: a few points in corners would leave the rest no colour."""
HEADROOM = 1.15
"""Of an axis of errors over the largest one of a run that ran to the end."""
MOST_MARKERS = 26
"""Markers along a reference that is known at many points, about."""
LEAST_GAP = 0.09
"""Between the labels of two marked numbers, over the width of the axis."""
LOOKS: dict[str, dict[str, Any]] = {
    "exact": {"color": EXACT_COLOUR, "linewidth": 5.0},
    "full": {"color": INK, "linewidth": 2.2},
    "level": {"color": EXACT_COLOUR},
    "best": {"color": INK, "linestyle": ":"},
}


@dataclass(frozen=True)
class Field:
    """A picture of a field."""

    title: str
    label: str
    """Quantity and unit; fields of one label share a scale where they share one at all."""
    values: Array
    """(ny, nx), from below; NaN where there is no fluid."""
    difference: bool = False
    """Whether it is one of two fields: zero is in the middle of its scale."""

    def range(self) -> Range:
        """Return the range of all but a few values."""
        known = self.values[np.isfinite(self.values)]
        low, high = np.percentile(known, SHOWN) if len(known) else (0.0, 1.0)
        return float(low), float(high)

    def beyond(self, scale: Range) -> tuple[bool, bool]:
        """Return whether values lie below a scale, and above it."""
        return bool((self.values < scale[0]).any()), bool((self.values > scale[1]).any())


@dataclass(frozen=True)
class Curve:
    """A run's line or history; `reference` values are markers."""

    label: str
    x: Array
    y: Array
    role: Role = "run"
    complete: bool = True
    """Whether the run ran to the end."""


@dataclass(frozen=True)
class Panel:
    """Curves on axes of their own, drawn in this order."""

    title: str
    x_label: str
    y_label: str
    curves: Sequence[Curve]
    axes: Literal["linear", "from zero", "logarithmic", "both logarithmic"] = "linear"
    """Axes from zero follow unstable runs no farther than `HEADROOM` above the others."""
    marked: Sequence[int] = ()
    """Numbers of modes with a vertical line, on logarithmic axes."""


def draw_grid(
    rows: Sequence[Sequence[Field | Panel]],
    frame: Frame | None = None,
    *,
    scales: Mapping[str, Range] | None = None,
    title: str = "",
) -> Figure:
    """Return a figure of panels in rows; pictures need a frame.

    Pictures of one label share a scale and a colour bar. `scales` are ranges that the scales of
    some labels leave no farther than `BEYOND`, such as the full run's. Without them each picture
    has a scale and a bar of its own. Curves have one legend below, or one in each panel where
    they differ or stand beside pictures. Raises ValueError for no panel.
    """
    longest = max(rows, key=len, default=())
    if not longest:
        raise ValueError("there is nothing to draw")
    picture_width = min(PICTURE, WIDEST / len(longest))
    widths = [picture_width if isinstance(panel, Field) else CURVES[0] for panel in longest]
    height = 0.0 if all(isinstance(panel, Field) for panel in longest) else CURVES[1]
    if frame is not None:
        bars = 0.5 if scales is None else 0.0
        height = max(height, frame.height(picture_width) + 0.3 + bars)
    with styled():
        width = max(sum(widths) + 0.7, LETTER * len(title), LEAST_WIDTH)
        figure = new_figure(width, len(rows) * height + 1.2)
        grid = figure.subplots(len(rows), len(longest), squeeze=False, width_ratios=widths)
        places: list[tuple[Axes, Field | Panel]] = []
        for row_axes, row in zip(grid, rows, strict=True):
            places += zip(row_axes, row, strict=False)
            for unused in row_axes[len(row) :]:
                unused.set_axis_off()
        if frame is not None:
            pictures = [(axes, panel) for axes, panel in places if isinstance(panel, Field)]
            _draw_pictures(figure, frame, pictures, picture_width, scales)
            edge = EDGE / figure.get_figheight()
            figure.set_layout_engine("constrained", rect=(0.0, edge, 1.0, 1.0 - edge))
        curves = [(axes, panel) for axes, panel in places if isinstance(panel, Panel)]
        for axes, panel in curves:
            _draw_curves(axes, panel)
        legends = {tuple(curve.label for curve in panel.curves) for _, panel in curves}
        if len(legends) == 1 and frame is None:
            legend_below(figure, curves[0][0])
        else:
            for axes, _ in curves:
                axes.legend(fontsize=7.5)
        if title:
            figure.suptitle(title, fontsize=TITLE)
        return figure


def _draw_pictures(
    figure: Figure,
    frame: Frame,
    pictures: Sequence[tuple[Axes, Field]],
    width: float,
    scales: Mapping[str, Range] | None,
) -> None:
    """Draw fields, and a colour bar below each, or below those that share a scale."""
    groups: dict[int | str, list[tuple[Axes, Field]]] = {}
    for number, (axes, field) in enumerate(pictures):
        groups.setdefault(number if scales is None else field.label, []).append((axes, field))
    first = pictures[0][0]
    for group in groups.values():
        fields, label = [field for _, field in group], group[0][1].label
        colours, scale = _scale(fields, scales or {})
        for axes, field in group:
            image = show(axes, frame, field.values, colours, scale)
            if axes is not first:
                axes.sharex(first)
                axes.sharey(first)
            axes.locator_params(axis="x", nbins=X_TICKS)
            axes.set_title(field.title, fontsize=min(TITLE, TITLE * width / PICTURE + 1.5))
            axes.set_xlabel("x [m]")
            axes.set_ylabel("y [m]" if scales is not None else f"{label}\n\ny [m]")
            axes.label_outer()
        below, above = (any(ends) for ends in zip(*(f.beyond(scale) for f in fields), strict=True))
        panels = [axes for axes, _ in group]
        n_columns = len({round(axes.get_position().x0, 3) for axes in panels})
        told = label if scales is not None else ""
        bar_below(figure, image, panels, told, 18 * n_columns, (below, above))


def _scale(fields: Sequence[Field], scales: Mapping[str, Range]) -> tuple[str, Range]:
    """Return the colours and the scale of fields of one label."""
    ranges = [field.range() for field in fields]
    low, high = min(low for low, _ in ranges), max(high for _, high in ranges)
    if fields[0].label in scales:
        least, most = scales[fields[0].label]
        reach = BEYOND * (most - least)
        low, high = max(low, least - reach), min(high, most + reach)
    if fields[0].difference:
        return DIFFERENCE_MAP, symmetric_limits(np.array([low, high]))
    return scale_of(low, high)


def _draw_curves(axes: Axes, panel: Panel) -> None:
    drawn: Counter[str] = Counter()
    for curve in panel.curves:
        # Zeros have no place on a logarithmic axis.
        y = np.where(curve.y > 0.0, curve.y, np.nan) if "log" in panel.axes else curve.y
        index = drawn[curve.role]
        drawn[curve.role] += 1
        if curve.role == "run":
            marked_line(axes, curve.x, y, index, curve.label)
            continue
        look = LOOKS.get(curve.role, {})
        if curve.role == "reference":
            line = line_of(index)
            look = {"color": line.color, "marker": line.marker, "linestyle": "none"}
            look |= {"markerfacecolor": "white", "markersize": 4.2}
            look["markevery"] = max(1, len(y) // MOST_MARKERS)
        elif index > 0:
            look = {"color": "#777777", "linestyle": DASHES[index % len(DASHES)]}
        axes.plot(curve.x, y, label=curve.label, **look)
    label_axes(axes, panel.x_label, panel.y_label)
    axes.set_title(panel.title)
    axes.margins(x=0.01)
    if panel.axes == "from zero":
        axes.set_ylim(0.0, _highest(panel))
    elif panel.axes == "logarithmic":
        axes.set_yscale("log")
        plain_logarithmic(axes.yaxis, *axes.get_ylim())
    elif panel.axes == "both logarithmic":
        axes.set(xscale="log", yscale="log")
        plain_logarithmic(axes.xaxis, *axes.get_xlim())
        _mark(axes, panel.marked)


def _highest(panel: Panel) -> float | None:
    """Return where an axis of errors ends: above runs that ran to the end, or above all."""
    known = [c for c in panel.curves if len(c.y)]
    some = [c for c in known if c.complete] or known
    highest = max((float(c.y.max()) for c in some), default=0.0)
    return HEADROOM * highest if highest > 0.0 else None


def _mark(axes: Axes, numbers: Sequence[int]) -> None:
    """Draw a vertical line at numbers of modes, labelled where no other label stands."""
    low, high = np.log(axes.get_xlim())
    last = -np.inf
    for number in sorted(numbers):
        axes.axvline(number, color="#777777", linewidth=0.9, linestyle=":", zorder=1)
        place = (np.log(number) - low) / (high - low)
        if place - last < LEAST_GAP:
            continue
        axes.annotate(
            f"{number}" if np.isfinite(last) else f"M = {number}",
            (number, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, 2),
            textcoords="offset points",
            ha="center",
            fontsize=8.0,
        )
        last = place
