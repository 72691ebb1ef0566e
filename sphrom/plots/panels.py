"""Figures as grids of panels, which are pictures of fields or axes with curves.

Pictures take fields on a regular grid (ny, nx), with rows from below, and NaN outside of the fluid,
which is grey for solids and white for air. If a frame has solids, their exact outline is drawn
instead of grid cells. A box in space is shown by three slices side by side, see
`sphrom.metrics.grids.Slices`. In all figures the full model and measurements are black, the exact
solution is grey, and a reduced model has the colour, line style and marker of its index in the
case. Colours are those of Okabe and Ito, which colour-blind readers can distinguish. Matplotlib is
imported when a figure is drawn.
"""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sphrom.arrays import Array
from sphrom.plots.arrangement import LETTER, WIDEST, Bar, Cell, arrange, picture_width
from sphrom.plots.frames import Frame, Solids
from sphrom.whole_files import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

DOTS_PER_INCH = 150
FORMATS = (".png", ".svg")
"""Suffixes of figure files."""
LABELLED, LEAST_LABELS = ((1.0,), (1.0, 2.0, 5.0), (1.0, 2.0, 3.0, 4.0, 5.0, 7.0)), 3
"""Multiples of decades to label on a logarithmic axis; the first set with enough labels is used."""
PLAIN = (1e-4, 1e6)
"""Range of a logarithmic axis that is labelled without powers of ten."""
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
DASHES: tuple[Any, ...] = (
    "-",
    (0, (5, 1.5)),
    (0, (3, 1, 1, 1)),
    (0, (6, 1, 1, 1, 1, 1)),
    (0, (8, 2)),
    (0, (2, 1)),
)
MARKERS = ("o", "s", "^", "D", "v", "P")
INK = "#222222"
EXACT_COLOUR = "#9a9a9a"

SOLID_COLOUR = "#c9c9c9"
"""Colour of solids in pictures."""
AIR_COLOUR = "white"
SPEED_MAP = "viridis"
SIGNED_MAP = "RdBu_r"
DIFFERENCE_MAP = "PuOr_r"


def line_of(index: int) -> dict[str, Any]:
    """Return the colour, line style and marker of the reduced model with this index."""
    return {
        "color": COLOURS[index % len(COLOURS)],
        "linestyle": DASHES[(index + index // len(COLOURS)) % len(DASHES)],
        "marker": MARKERS[index % len(MARKERS)],
    }


def styled() -> AbstractContextManager[None]:
    """Apply the style sheet `figures.mplstyle` while a figure is built."""
    import matplotlib

    return matplotlib.rc_context(fname=Path(__file__).with_name("figures.mplstyle"))


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure of a width and height [inch], which needs no display."""
    from matplotlib.figure import Figure as NewFigure

    return NewFigure(figsize=(width, height), dpi=DOTS_PER_INCH, layout="constrained")


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG or SVG, by the suffix of the path.

    Raises ArtifactError when the file can't be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    content = io.BytesIO()
    with styled():
        if path.suffix.lower() == ".svg":
            figure.savefig(content, format="svg", dpi=DOTS_PER_INCH, metadata={"Date": None})
        else:
            # `savefig` draws figures with a layout twice, the first time only to arrange them.
            FigureCanvasAgg(figure).print_png(content)
    write_whole(path, content.getvalue())


def plain_logarithmic(axis: Axis, low: float, high: float) -> None:
    """Label a logarithmic axis with at least LEAST_LABELS numbers, all plain or all powers."""
    from matplotlib import ticker as of

    decades = (of.LogLocator(subs=subs) for subs in LABELLED)
    for locator in (*decades, of.MaxNLocator(LEAST_LABELS + 1)):
        ticks = np.asarray(locator.tick_values(low, high))
        if np.sum((ticks >= low) & (ticks <= high)) >= LEAST_LABELS:
            break
    axis.set_major_locator(locator)
    powers = of.LogFormatterSciNotation(minor_thresholds=(np.inf, np.inf))
    plain = of.FuncFormatter(lambda value, _: f"{value:g}")
    axis.set_major_formatter(plain if PLAIN[0] <= low and high < PLAIN[1] else powers)
    axis.set_minor_formatter(of.NullFormatter())


Range = tuple[float, float]
Role = Literal["run", "full", "exact", "best", "level", "reference"]

MOST_TICKS, AN_INCH = 5, 1.5
"""Largest numbers of labels along an axis, and per inch of a picture."""
HANDLE = 0.6
"""Approximate width of a handle of a legend with its margins [inch]."""
BEYOND = 2.0
"""Largest extension of a shared scale beyond its given range, relative to that range."""
SHOWN = (0.5, 99.5)
"""Percentiles at the ends of a scale; extremes in corners would take up most colours."""
N_MARKERS, MOST_MARKERS = 12, 26
"""Approximate number of markers along a run's curve, and along a reference with many points."""
LEAST_GAP = 0.05
"""Least distance between the labels of marked numbers, relative to the width of the axis."""
EXTENDED: Any = ("neither", "min", "max", "both")
"""The pointed ends of a colour bar: neither, the lower, the upper, both."""
LOOKS: dict[Role, dict[str, Any]] = {
    "exact": {"color": EXACT_COLOUR, "linewidth": 5.0},
    "full": {"color": INK, "linewidth": 2.2},
    "level": {"color": EXACT_COLOUR},
    "best": {"color": INK, "linestyle": ":"},
}
"""Styles of the first curves of all roles except reduced runs and references."""


def cover(axes: Axes, solids: Solids) -> None:
    """Draw solids on top of a picture."""
    axes.contourf(*solids, levels=(-np.inf, 0.0), colors=[SOLID_COLOUR], zorder=0.5)  # above images


@dataclass(frozen=True)
class Field:
    """A picture of a field."""

    title: str
    label: str
    """Quantity and unit; with shared scales, fields with equal labels share one."""
    values: Array
    """(ny, nx), with rows from below; NaN outside of the fluid."""
    difference: bool = False
    """Whether it is a difference of two fields, with zero in the middle of its scale."""
    complete: bool = True
    """Whether its run reached this time; otherwise a shared scale ignores it."""


@dataclass(frozen=True)
class Curve:
    """A curve, such as a profile or a history; with the role `reference`, only markers."""

    label: str
    x: Array
    y: Array
    role: Role = "run"
    interval: Array | None = None
    """(2, n) lower and upper ends of a band around the curve."""
    place: int | None = None
    """Index of the model in its case, which sets the style; None counts curves of the same role."""


@dataclass(frozen=True)
class Panel:
    """Axes with curves, drawn in this order."""

    title: str
    x_label: str
    y_label: str
    curves: Sequence[Curve]
    axes: Literal["linear", "logarithmic", "both logarithmic"] = "linear"
    marked: Sequence[int] = ()
    """Numbers of modes that a vertical line marks, on logarithmic axes."""
    margin: float | None = None
    """Space around all curves, relative to their range; None is that of curves over time."""


def draw_grid(
    rows: Sequence[Sequence[Field | Panel]],
    frame: Frame | None = None,
    *,
    scales: Mapping[str, Range] | None = None,
    title: str = "",
) -> Figure:
    """Return a figure with rows of panels; pictures need a frame.

    With `scales`, pictures with equal labels share a scale and a colour bar; `scales` has a range
    for each label, such as that of the full run, and a scale exceeds its range by at most `BEYOND`.
    Without `scales`, each picture has its own scale. Curves have one common legend below, or one
    per panel if the curves differ or stand beside pictures. Below pictures, a panel of curves that
    is alone in its row spans all columns. Raises ValueError without panels.
    """
    n_columns = max(map(len, rows), default=0)
    if not n_columns:
        raise ValueError("there is nothing to draw")
    width = WIDEST / n_columns
    if frame is not None:
        width = picture_width(frame.aspect, n_columns)
    with styled():
        figure = new_figure(WIDEST, WIDEST)
        figure.set_layout_engine("none")
        cells: list[tuple[Cell, Field | Panel]] = []
        for row, panels in enumerate(rows):
            alone = len(panels) == 1 and isinstance(panels[0], Panel) and frame is not None
            for column, panel in enumerate(panels):
                columns = range(n_columns) if alone else range(column, column + 1)
                cells.append((_cell(figure, frame, panel, row, columns, width), panel))
        bars = []
        if frame is not None:
            pictures = [(cell, panel) for cell, panel in cells if isinstance(panel, Field)]
            bars = _draw_pictures(figure, frame, pictures, width, scales)
        curves = [(cell.axes, panel) for cell, panel in cells if isinstance(panel, Panel)]
        for axes, panel in curves:
            _draw_curves(axes, panel)
        legends = {tuple(curve.label for curve in panel.curves) for _, panel in curves}
        lines_below = 0
        if len(legends) == 1 and frame is None:
            handles, labels = curves[0][0].get_legend_handles_labels()
            fitting = int(WIDEST / (LETTER * max(map(len, labels)) + HANDLE))
            across = max(1, min(4, len(labels), fitting))
            figure.legend(handles, labels, loc="lower center", ncols=across)
            lines_below = -(-len(labels) // across)
        else:
            for axes, _ in curves:
                axes.legend(fontsize=7.5, frameon=True, framealpha=0.8, edgecolor="none")
        arrange(figure, [cell for cell, _ in cells], bars, title, lines_below)
        return figure


def _cell(
    figure: Figure,
    frame: Frame | None,
    panel: Field | Panel,
    row: int,
    columns: range,
    width: float,
) -> Cell:
    """Return empty axes with the title of a panel; columns are about as wide as `width` [inch]."""
    axes = figure.add_axes((0.1, 0.1, 0.8, 0.8), label=f"{row}, {columns}")
    letters = int(width * len(columns) / LETTER)
    lines = [fill(line, letters) for line in panel.title.split("\n") if line]
    title = axes.set_title("\n".join(lines)).get_text()
    n_lines = len(title.splitlines())
    if isinstance(panel, Panel) or frame is None:
        marked = isinstance(panel, Panel) and bool(panel.marked)
        return Cell(axes, row, columns, lines_above=n_lines + marked)
    return Cell(axes, row, columns, frame.aspect, n_lines)


def _draw_pictures(
    figure: Figure,
    frame: Frame,
    pictures: Sequence[tuple[Cell, Field]],
    width: float,
    scales: Mapping[str, Range] | None,
) -> list[Bar]:
    """Draw fields of a width [inch], with a colour bar below each one or group with a scale."""
    groups: dict[int | str, list[tuple[Cell, Field]]] = {}
    for number, (cell, field) in enumerate(pictures):
        groups.setdefault(number if scales is None else field.label, []).append((cell, field))
    bars = []
    for group in groups.values():
        fields = [field for _, field in group]
        label = fields[0].label
        colours, scale = colour_scale(fields, scales or {})
        alike = [f for _, f in pictures if f.label == label]
        if scales is None and any(colour_scale([f])[0] == SIGNED_MAP for f in alike):
            colours = SIGNED_MAP  # one map for a quantity, also where a field has one sign
        for cell, field in group:
            axes = cell.axes
            image = _show(axes, frame, field.values, colours, scale)
            if frame.slices is None:
                axes.locator_params(axis="x", nbins=_n_ticks(width))
                axes.locator_params(axis="y", nbins=_n_ticks(width * frame.aspect))
            else:
                axes.set_xticks(*frame.slices.ticks(0))
                axes.set_yticks(*frame.slices.ticks(1))
            x_label, y_label = frame.labels
            axes.set_xlabel(x_label)
            axes.set_ylabel(y_label if scales is not None else f"{label}\n\n{y_label}")
            # Only the first pictures from the left, and the last ones, have numbers.
            axes.xaxis.set_visible(all(cell.row + 1 != other.row for other, _ in pictures))
            axes.yaxis.set_visible(cell.columns[0] == 0)
        values = np.concatenate([field.values.ravel() for field in fields])
        ends = 1 * bool((values < scale[0]).any()) + 2 * bool((values > scale[1]).any())
        bar = Bar(figure.add_axes((0.1, 0.1, 0.8, 0.1)), [cell for cell, _ in group])
        bar_label = label if scales is not None else ""
        bar_width = width * len({cell.columns[0] for cell in bar.cells})
        _draw_bar(figure, image, bar.axes, bar_label, bar_width, EXTENDED[ends])
        bars.append(bar)
    return bars


def colour_scale(fields: Sequence[Field], scales: Mapping[str, Range] = {}) -> tuple[str, Range]:
    """Return matplotlib's name of the colour map of fields with one label, and its range."""
    deciding = [field for field in fields if field.complete] or fields
    finite = [field.values[np.isfinite(field.values)] for field in deciding]
    ranges = np.array([np.percentile(v, SHOWN) if len(v) else (0.0, 1.0) for v in finite])
    low = float(ranges[:, 0].min())
    high = float(ranges[:, 1].max())
    if fields[0].label in scales:
        least, most = scales[fields[0].label]
        reach = BEYOND * (most - least)
        low = max(low, least - reach)
        high = min(high, most + reach)
    if fields[0].difference or low < 0.0 < high:  # scales with both signs are symmetric
        largest = max(-low, high) or 1.0
        return DIFFERENCE_MAP if fields[0].difference else SIGNED_MAP, (-largest, largest)
    return SPEED_MAP, (low, high) if high > low else (low - 0.5, high + 0.5)


def _show(axes: Axes, frame: Frame, field: Array, colours: str, scale: Range) -> Any:
    """Draw a field (ny, nx) into axes, with a colour map and its range."""
    axes.set_facecolor(empty_colour(frame))
    shown = field if frame.solids is None or frame.has_air else _continued(field)
    image = axes.imshow(
        shown, origin="lower", extent=frame.extent, cmap=colours, vmin=scale[0], vmax=scale[1]
    )
    if frame.solids is not None:
        cover(axes, frame.solids)
        axes.set(xlim=frame.extent[:2], ylim=frame.extent[2:])
    return image


def empty_colour(frame: Frame) -> str:
    """Return the colour of places without fluid, except for solids that are drawn on top."""
    return AIR_COLOUR if frame.has_air else SOLID_COLOUR


def _continued(field: Array) -> Array:
    """Return a field (ny, nx) whose NaN are replaced by the value of the nearest other pixel."""
    from scipy.ndimage import distance_transform_edt  # importing it takes long

    missing = np.isnan(field)
    if missing.all():
        return field
    rows, columns = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return field[rows, columns]


def _n_ticks(length: float) -> int:
    """Return the number of intervals between ticks along a length [inch]."""
    return max(1, min(MOST_TICKS, int(AN_INCH * length)))


def _draw_bar(
    figure: Figure, image: Any, axes: Axes, label: str, width: float, extended: Any
) -> None:
    """Draw a colour bar below panels of a width [inch].

    It has few labels, and a common factor beside the unit instead of long numbers.
    """
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    bar = figure.colorbar(image, cax=axes, orientation="horizontal", extend=extended)
    numbers = ScalarFormatter(useMathText=True)
    numbers.set_powerlimits((-2, 4))
    bar.locator = MaxNLocator(1 + _n_ticks(width))
    bar.formatter = numbers
    bar.update_ticks()
    numbers.format_ticks(list(bar.get_ticks()))
    bar.set_label(f"{label} {numbers.get_offset()}".strip())  # a separate offset would overlap
    bar.ax.xaxis.get_offset_text().set_visible(False)


def _look(curve: Curve, index: int) -> dict[str, Any]:
    """Return the style of a curve, from its role and its index among curves of this role."""
    if curve.role in LOOKS:
        later = {"color": "#777777", "linestyle": DASHES[index % len(DASHES)]}
        return later if index else LOOKS[curve.role]
    look = line_of(index) | {"markerfacecolor": "white", "markersize": 4.2}
    n_points = len(curve.x)
    if curve.role == "reference":
        look |= {"linestyle": "none", "markevery": max(1, n_points // MOST_MARKERS)}
        return look if curve.place is not None else look | {"color": INK}
    # Markers of different models start at different points, so they do not overlap.
    spacing = max(1, n_points // N_MARKERS)
    return look | {"linewidth": 1.3, "markevery": (index * spacing // 4 % spacing, spacing)}


def _draw_curves(axes: Axes, panel: Panel) -> None:
    drawn: Counter[str] = Counter()
    for curve in panel.curves:
        # A logarithmic axis can't show zeros.
        y = np.where(curve.y > 0.0, curve.y, np.nan) if "log" in panel.axes else curve.y
        look = _look(curve, drawn[curve.role] if curve.place is None else curve.place)
        drawn[curve.role] += 1
        axes.plot(curve.x, y, label=curve.label, **look)
        if curve.interval is not None:
            axes.fill_between(curve.x, *curve.interval, color=look["color"], alpha=0.15, lw=0.0)
    axes.set(xlabel=panel.x_label, ylabel=panel.y_label, axisbelow=True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(True)
    axes.margins(x=0.01) if panel.margin is None else axes.margins(panel.margin)
    axes.locator_params(axis="y", nbins=MOST_TICKS + 1)
    if all(np.issubdtype(curve.x.dtype, np.integer) for curve in panel.curves):
        axes.locator_params(axis="x", integer=True)
    if "log" in panel.axes:
        axes.set_yscale("log")
        plain_logarithmic(axes.yaxis, *axes.get_ylim())
    if panel.axes == "both logarithmic":
        axes.set_xscale("log")
        plain_logarithmic(axes.xaxis, *axes.get_xlim())
        _mark(axes, panel.marked)


def _mark(axes: Axes, numbers: Sequence[int]) -> None:
    """Draw a vertical line at numbers of modes, with a label unless it overlaps another one."""
    low, high = np.log(axes.get_xlim())
    last = -np.inf
    for number in sorted(numbers):
        axes.axvline(number, color="#777777", linewidth=0.9, linestyle=":", zorder=1)
        place = (np.log(number) - low) / (high - low)
        if place - last < LEAST_GAP:
            continue
        first = not np.isfinite(last)
        above: Any = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
        # The first label ends over its line, so that it is as far from the second as numbers are.
        above |= {"xytext": (6 * first, 2), "ha": "right" if first else "center"}
        label = f"M = {number}" if first else f"{number}"
        axes.annotate(label, (number, 1.0), fontsize=8.0, **above)
        last = place
