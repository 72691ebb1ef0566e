"""The common style of all figures, and functions to create and save a figure.

Colours are those of Okabe and Ito, which colour-blind readers can distinguish; each also has its
own line style and marker. Agg draws figures without a display, and matplotlib is imported only when
a figure is drawn.
"""

from __future__ import annotations

import io
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sphrom.whole_files import write_whole

if TYPE_CHECKING:
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

    return NewFigure(figsize=(width, height), layout="constrained")


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG or SVG, by the suffix of the path.

    Raises ArtifactError when the file can't be written.
    """
    content = io.BytesIO()
    kind = path.suffix.lower().removeprefix(".")
    steady: Any = {"metadata": {"Date": None}} if kind == "svg" else {}
    with styled():
        figure.savefig(content, format=kind, dpi=DOTS_PER_INCH, facecolor="white", **steady)
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
