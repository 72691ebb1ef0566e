"""Names of points in a plot, put where they hide neither each other nor any point."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Annotation
    from matplotlib.transforms import Bbox

SIZE = 7.5
"""Of the letters [points]."""
MARKER_ROOM = 4.0
"""Half-width of a marker's box [points]."""
SAME = 4.0
"""The largest distance of markers that may share a name [points]."""
STEP = 9.0
"""From one place that is tried to the next, across lines [points]."""
N_STEPS = 12
"""Places that are tried in each direction."""
LEADER = {"arrowstyle": "-", "linewidth": 0.6, "color": "#777777", "shrinkA": 0.0, "shrinkB": 3.0}
"""From a name to its point, where it isn't beside it."""

Place = tuple[float, float, str, str]
"""Offset [points], and how a text is aligned there."""


def name_points(
    figure: Figure,
    axes: Axes,
    named: Sequence[tuple[str, float, float]],
    others: Sequence[tuple[float, float]],
) -> None:
    """Write names beside points (name, x, y), clear of `others` too.

    Points that almost coincide and have one name have it once.
    Where everything else of the figure is has to be settled before.
    """
    figure.draw_without_rendering()
    markers = [_around(figure, axes, x, y) for _, x, y in named]
    taken = [*markers, *(_around(figure, axes, x, y) for x, y in others)]
    written: list[tuple[str, Bbox]] = []
    for (text, x, y), marker in zip(named, markers, strict=True):
        if any(text == other and marker.overlaps(near) for other, near in written):
            continue
        written.append((text, marker.padded(SAME * figure.dpi / 72.0)))
        taken.append(_name(axes, text, (x, y), taken))


def _around(figure: Figure, axes: Axes, x: float, y: float) -> Bbox:
    """Return the box of a point's marker in the figure [pixels]."""
    from matplotlib.transforms import Bbox

    centre_x, centre_y = axes.transData.transform((x, y))
    room = MARKER_ROOM * figure.dpi / 72.0
    return Bbox.from_extents(centre_x - room, centre_y - room, centre_x + room, centre_y + room)


def _name(axes: Axes, text: str, point: tuple[float, float], taken: Sequence[Bbox]) -> Bbox:
    """Write a name in the first place that is free, or the one where it hides least."""
    found: list[tuple[int, Annotation, Bbox]] = []
    for place in _places():
        written = _annotate(axes, text, point, place)
        box = _letters(written)
        hidden = box.count_overlaps(taken) + 2 * (not _holds(axes.bbox, box))
        found.append((hidden, written, box))
        if hidden == 0:
            break
    best = min(range(len(found)), key=lambda k: found[k][0])
    for k, (_, written, _) in enumerate(found):
        if k != best:
            written.remove()
    return found[best][2]


def _places() -> Iterator[Place]:
    """Yield places about a point: beside it first, then farther and farther."""
    for up, vertical in ((-3.0, "top"), (0.0, "center"), (3.0, "bottom")):
        yield -6.0, up, "right", vertical
    for up, vertical in ((3.0, "bottom"), (0.0, "center"), (-3.0, "top")):
        yield 6.0, up, "left", vertical
    for k in range(1, N_STEPS + 1):
        yield -20.0, -3.0 - k * STEP, "right", "top"
        yield 20.0, 3.0 + k * STEP, "left", "bottom"


def _annotate(axes: Axes, text: str, point: tuple[float, float], place: Place) -> Annotation:
    across, up, horizontal, vertical = place
    written = axes.annotate(
        text,
        point,
        xytext=(across, up),
        textcoords="offset points",
        ha=horizontal,
        va=vertical,
        fontsize=SIZE,
        arrowprops=LEADER if abs(up) > STEP else None,
    )
    written.set_in_layout(False)
    return written


def _letters(written: Annotation) -> Bbox:
    """Return the box of a text, without its leader."""
    from matplotlib.text import Text

    written.get_window_extent()
    return Text.get_window_extent(written)


def _holds(outer: Bbox, inner: Bbox) -> bool:
    return bool(
        outer.x0 <= inner.x0
        and outer.y0 <= inner.y0
        and inner.x1 <= outer.x1
        and inner.y1 <= outer.y1
    )
