"""The look that all plots share, and how a figure becomes a file.

Colours are those of Okabe and Ito, which colour-blind readers can tell apart; each also has its
own line and marker. Figures are drawn by Agg, without a display, and matplotlib is loaded only
when something is drawn.
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
"""What the names of figures may end in."""
LABELLED, LEAST_LABELS = ((1.0,), (1.0, 2.0, 5.0), (1.0, 2.0, 3.0, 4.0, 5.0, 7.0)), 3
"""Multiples of decades that a logarithmic axis labels: the first that give it so many labels."""
PLAIN = (1e-4, 1e6)
"""A logarithmic axis within these is labelled without powers of ten."""
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
"""What is no fluid in a picture."""
SPEED_MAP = "viridis"
SIGNED_MAP = "RdBu_r"
DIFFERENCE_MAP = "PuOr_r"


def line_of(index: int) -> dict[str, Any]:
    """Return the colour, line and marker of the reduced model of this index."""
    return {
        "color": COLOURS[index % len(COLOURS)],
        "linestyle": DASHES[(index + index // len(COLOURS)) % len(DASHES)],
        "marker": MARKERS[index % len(MARKERS)],
    }


def styled() -> AbstractContextManager[None]:
    """Apply the shared look, the style sheet `figures.mplstyle`, while a figure is built."""
    import matplotlib

    return matplotlib.rc_context(fname=Path(__file__).with_name("figures.mplstyle"))


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure [inch] that needs no display."""
    from matplotlib.figure import Figure as NewFigure

    return NewFigure(figsize=(width, height), layout="constrained")


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG or SVG, by how the file's name ends.

    Raises ArtifactError when the file can't be written.
    """
    content = io.BytesIO()
    kind = path.suffix.lower().removeprefix(".")
    steady: Any = {"metadata": {"Date": None}} if kind == "svg" else {}
    with styled():
        figure.savefig(content, format=kind, dpi=DOTS_PER_INCH, facecolor="white", **steady)
    write_whole(path, content.getvalue())


def plain_logarithmic(axis: Axis, low: float, high: float) -> None:
    """Label decades of a logarithmic axis, or more, by numbers that are alike: plain, or powers."""
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
