"""Arrange panels in a figure, which is as large as they need and no wider than a page.

Columns share the width that is left beside labels; pictures have the proportions of their frame.
Only the widths of labels are measured, once for each axis, because a general layout engine would
take most of the time of drawing. All lengths are in inches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDEST = 9.6
"""Largest width of a figure. On a page 7.7 inches wide its smallest type then has 6 points."""
FLAT = 0.7
"""Height over width of pictures below which they are placed in fewer columns."""
LARGEST, TALLEST, LEAST_PICTURE = 10.0, 6.0, 0.9
"""Largest area [square inches], largest height and least width of a picture."""
CURVES, ALONE = 3.4, 5.5
"""Width of a column of curves beside pictures, and its largest width without pictures."""
PROPORTION, LEAST, MOST = 0.72, 1.7, 2.4
"""Height of curves over their width, and the limits of their height."""
LINE, LETTER = 0.17, 0.068
"""Height of a line of type, and the width of a letter."""
EDGE, BETWEEN, GAP, OVER_LAST = 0.08, 0.36, 0.06, 0.15
"""Space at edges, between columns, between rows, and for half of the last number of an axis."""
NUMBERS = 0.23
"""Height of the marks and numbers of an axis, without its label."""
BAR, THICKNESS, BAR_SHARE = 0.6, 0.11, 0.9
"""Height of a colour bar with its numbers and label, that of the bar alone, and the bar's width
over that of its panels."""
FIRST_GUESS = 0.6
"""Width of labels before they are measured."""


@dataclass(frozen=True, eq=False)
class Cell:
    """A panel in the grid."""

    axes: Axes
    row: int
    columns: range
    """The columns that it covers."""
    aspect: float | None = None
    """Height over width of a picture; None for curves."""
    lines_above: int = 0
    """Number of lines of its title, and of labels above its axes."""

    def height(self, width: float) -> float:
        """Return its height at a width, without labels; for curves, the least height."""
        if self.aspect is not None:
            return width * self.aspect
        return max(LEAST, min(MOST, PROPORTION * width))

    @property
    def below(self) -> float:
        """The height of the numbers and the label below it."""
        axis = self.axes.xaxis
        return (NUMBERS + LINE * bool(axis.get_label_text())) * axis.get_visible() + GAP


@dataclass(frozen=True)
class Bar:
    """A colour bar below the last of its panels."""

    axes: Axes
    cells: Sequence[Cell]

    @property
    def row(self) -> int:
        """The row of panels above it."""
        return max(cell.row for cell in self.cells)


def arrange(
    figure: Figure, cells: Sequence[Cell], bars: Sequence[Bar], title: str, lines_below: int
) -> None:
    """Set the size of a figure and the positions of its axes.

    `lines_below` is the number of lines of the legend below all panels.
    """
    left = [FIRST_GUESS] * (1 + max(cell.columns[-1] for cell in cells))
    _place(figure, cells, bars, left, title, lines_below)
    for cell in cells:
        label = cell.axes.yaxis.label
        height = cell.axes.get_position().height * figure.get_figheight()
        lines = label.get_text().split("\n")
        letters = max(12, int(height / LETTER))
        label.set_text("\n".join(_balanced(line, letters) for line in lines))
    left = _widths_of_labels(figure, cells, len(left))
    _place(figure, cells, bars, left, title, lines_below)


def _balanced(text: str, letters: int) -> str:
    """Break text into as few lines as fit into `letters`, of similar lengths, before its unit."""
    text = text.replace(" [", "\N{NO-BREAK SPACE}[").replace("Eq. ", "Eq.\N{NO-BREAK SPACE}")
    fewest = fill(text, letters).count("\n")
    word = min(letters, max(map(len, text.split(" "))) or 1)
    least = next(n for n in range(word, letters + 1) if fill(text, n).count("\n") <= fewest)
    return fill(text, least).replace("\N{NO-BREAK SPACE}", " ")


def _widths_of_labels(figure: Figure, cells: Sequence[Cell], n_columns: int) -> list[float]:
    """Return the largest width of the numbers and labels to the left of each column."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    renderer = FigureCanvasAgg(figure).get_renderer()
    left = [0.0] * n_columns
    for cell in cells:
        labels = cell.axes.yaxis.get_tightbbox(renderer)
        if labels is not None:
            width = (cell.axes.bbox.x0 - labels.x0) / figure.dpi
            left[cell.columns[0]] = max(left[cell.columns[0]], width)
    return left


def _place(
    figure: Figure,
    cells: Sequence[Cell],
    bars: Sequence[Bar],
    left: list[float],
    title: str,
    lines_below: int,
) -> None:
    """Set sizes and positions, with labels of given widths to the left of each column."""
    n_columns = len(left)
    margins = sum(left) + BETWEEN * (n_columns - 1) + 2.0 * EDGE + OVER_LAST
    widths = _widths(cells, n_columns, WIDEST - margins)
    starts = [EDGE + sum(left[: c + 1]) + sum(widths[:c]) + BETWEEN * c for c in range(n_columns)]
    titles = title.split("\n") if title else []
    width = max(margins + sum(widths), LETTER * max(map(len, titles), default=0))
    boxes: list[tuple[Axes, float, float, float, float]] = []
    top = EDGE + LINE * len(titles)
    for row in range(1 + max(cell.row for cell in cells)):
        top += GAP + LINE * max((c.lines_above for c in cells if c.row == row), default=0)
        sizes = []
        for cell in cells:
            if cell.row == row:
                first, last = cell.columns[0], cell.columns[-1]
                extent = starts[last] + widths[last] - starts[first]
                has_bar = any(cell in bar.cells and bar.row == row for bar in bars)
                sizes.append((cell, extent, cell.height(extent), cell.below + BAR * has_bar))
        block = max((height + below for _, _, height, below in sizes), default=0.0)
        for cell, extent, height, below in sizes:
            shown = height if cell.aspect is not None else block - below
            boxes.append((cell.axes, starts[cell.columns[0]], top, extent, shown))
        for bar in bars:
            if bar.row == row:
                of_bar = [size for size in sizes if size[0] in bar.cells]
                start = min(starts[cell.columns[0]] for cell, *_ in of_bar)
                end = max(starts[cell.columns[0]] + extent for cell, extent, *_ in of_bar)
                inset = 0.5 * (1.0 - BAR_SHARE) * (end - start)
                place = top + max(height + below for _, _, height, below in of_bar) - BAR + GAP
                boxes.append((bar.axes, start + inset, place, BAR_SHARE * (end - start), THICKNESS))
        top += block
    height = top + LINE * lines_below + EDGE * (1 + bool(lines_below))
    figure.set_size_inches(width, height)
    for axes, x, y, w, h in boxes:
        axes.set_position((x / width, 1.0 - (y + h) / height, w / width, h / height))
    if title:
        figure.suptitle(title, y=1.0 - EDGE / height, va="top")


def _widths(cells: Sequence[Cell], n_columns: int, room: float) -> list[float]:
    """Return the widths of columns that share a width `room`."""
    pictures = [cell for cell in cells if cell.aspect is not None]
    if not pictures:
        return [min(room / n_columns, ALONE)] * n_columns
    columns = {cell.columns[0] for cell in pictures}
    room -= CURVES * (n_columns - len(columns))
    width = picture_width(max(cell.aspect or 0.0 for cell in pictures), len(columns), room)
    return [width if c in columns else CURVES for c in range(n_columns)]


def picture_width(aspect: float, n_columns: int, room: float = WIDEST) -> float:
    """Return the width of pictures of an aspect in columns that share a width `room`."""
    most = min((LARGEST / aspect) ** 0.5, TALLEST / aspect)
    return max(LEAST_PICTURE, min(room / n_columns, most))
