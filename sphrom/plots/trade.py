"""The plots of a trade: error against seconds, and maps of the stability of models."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.plots.canvas import (
    INK,
    label_axes,
    legend_below,
    line_of,
    new_figure,
    plain_logarithmic,
    styled,
)
from sphrom.text import exact

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.text import Annotation
    from matplotlib.transforms import Bbox

Array = NDArray[np.float64]
Place = tuple[float, float, str, str]
"""Offset of a name [points], and how it is aligned there."""

LEAST_MARGIN = 1.3
"""Around errors on a logarithmic axis, as a factor."""
SIDE_MARGIN = 0.2
"""Beside models, for their names, over the axis."""
GAIN = 0.95
"""The largest error over that of the point named before, for a point to be named."""
FRONT_COLOUR = "#777777"
NAME = 7.5
"""Size of the letters of names [points]."""
MARKER_ROOM = 4.0
"""Half-width of a marker's box [points]."""
SAME = 4.0
"""The largest distance of markers that may share a name [points]."""
STEP = 9.0
"""From one place for a name that is tried to the next, across lines [points]."""
N_STEPS = 12
"""Places that are tried in each direction."""
LEADER = {"arrowstyle": "-", "linewidth": 0.6, "color": "#777777", "shrinkA": 0.0, "shrinkB": 3.0}
"""From a name to its point, where it isn't beside it."""
STATES = {
    "stable": ("#56B4E9", ""),
    "inaccurate": ("#E69F00", "~"),
    "unstable": ("#D55E00", "×"),
    "full unstable": ("#999999", "×"),
    "refused": ("#E5E5E5", "–"),
}
"""The colour and the sign of each state."""
MAP = 3.3
"""Width and height of a map [inch]."""
IN_A_ROW = 4


@dataclass(frozen=True)
class Point:
    """One model in the plane of seconds and error."""

    group: str
    """Models of a group share colour and marker."""
    label: str
    seconds: float
    errors: tuple[float, ...]
    """By quantity [%], such as velocity and pressure."""
    on_front: tuple[bool, ...]


def draw_trade(
    points: Sequence[Point],
    full_seconds: float | None,
    measure: str,
    nothing: Mapping[str, tuple[float, ...]],
    quantities: Sequence[str] = ("velocity", "pressure"),
) -> Figure:
    """Return errors against seconds of a run with their Pareto fronts, a panel for each quantity.

    `full_seconds` is the time of the case's own full run [s], None if unknown; `measure` names the
    error; `nothing` has the errors [%] without any model, by name.
    """
    with styled():
        figure = new_figure(5.5 * max(len(quantities), 1.3), 5.2)
        panels = figure.subplots(1, len(quantities), sharex=True, squeeze=False)[0]
        for index, (axes, quantity) in enumerate(zip(panels, quantities, strict=True)):
            without = {
                name: errors[index] for name, errors in nothing.items() if errors[index] > 0.0
            }
            _draw_quantity(axes, points, index, list(without.values()))
            if full_seconds is not None:
                axes.axvline(
                    full_seconds, color=INK, linewidth=1.0, linestyle=":", label="full run"
                )
            for (name, error), dashes in zip(without.items(), ("--", "-."), strict=False):
                axes.axhline(error, color=INK, linewidth=0.9, linestyle=dashes, label=name)
            label_axes(axes, "seconds of a run [s]", f"{quantity}, {measure} [%]")
        legend_below(figure, panels[0])
        for index, axes in enumerate(panels):
            _name(figure, axes, points, index)
        return figure


def _draw_quantity(
    axes: Axes, points: Sequence[Point], index: int, others: Sequence[float]
) -> None:
    """Draw models and their front on axes that have room for other errors too."""
    axes.set_xscale("log")
    # An error of zero, of a run that is the full one, has no place on a logarithmic axis.
    shown = [point for point in points if point.errors[index] > 0.0]
    if shown:
        axes.set_yscale("log")
        axes.set_ylim(*_room([*(point.errors[index] for point in shown), *others]))
        axes.margins(x=SIDE_MARGIN)
        plain_logarithmic(axes.yaxis, *axes.get_ylim())
    front = sorted((p.seconds, p.errors[index]) for p in shown if p.on_front[index])
    if front:
        axes.plot(
            *zip(*front, strict=True),
            color=FRONT_COLOUR,
            linewidth=4.0,
            alpha=0.35,
            drawstyle="steps-post",
            label="Pareto front (models filled)",
            zorder=1,
        )
    _draw_models(axes, points, index)


def _draw_models(axes: Axes, points: Sequence[Point], index: int) -> None:
    """Draw a marker for each model, filled on the front."""
    for number, group in enumerate(dict.fromkeys(point.group for point in points)):
        members = [point for point in points if point.group == group and point.errors[index] > 0.0]
        line = line_of(number)
        for on_front in (False, True):
            drawn = [point for point in members if point.on_front[index] is on_front]
            axes.plot(
                [point.seconds for point in drawn],
                [point.errors[index] for point in drawn],
                color=line.color,
                marker=line.marker,
                linestyle="none",
                markersize=5.5,
                markerfacecolor=line.color if on_front else "white",
                zorder=3 if on_front else 2,
                label=None if on_front else group,
            )


def _room(errors: Sequence[float]) -> tuple[float, float]:
    """Return limits of a logarithmic axis with room around errors, a decade at least."""
    low, high = min(errors), max(errors)
    margin = max(LEAST_MARGIN, (10.0 * low / high) ** 0.5)
    return low / margin, high * margin


def _name(figure: Figure, axes: Axes, points: Sequence[Point], index: int) -> None:
    """Write names beside points on a front: the last, and earlier ones that gain in accuracy."""
    shown = [(p.label, p.seconds, p.errors[index]) for p in points if p.errors[index] > 0.0]
    front = sorted(
        ((p.label, p.seconds, p.errors[index]) for p in points if p.on_front[index]),
        key=lambda point: point[1:],
    )
    named: list[tuple[str, float, float]] = []
    for point in front:
        if point in shown and (not named or point is front[-1] or point[2] < GAIN * named[-1][2]):
            named.append(point)
    name_points(figure, axes, named, [point[1:] for point in shown if point not in named])


def name_points(
    figure: Figure,
    axes: Axes,
    named: Sequence[tuple[str, float, float]],
    others: Sequence[tuple[float, float]],
) -> None:
    """Write names beside points (name, x, y), where they hide neither each other nor any point.

    Points that almost coincide and have one name have it once. Where everything else of the figure
    is has to be settled before.
    """
    from matplotlib.transforms import Bbox

    figure.draw_without_rendering()
    pixel, room = figure.dpi / 72.0, MARKER_ROOM * figure.dpi / 72.0
    centres = axes.transData.transform([*(point[1:] for point in named), *others])
    taken = [Bbox.from_extents(x - room, y - room, x + room, y + room) for x, y in centres]
    written: list[tuple[str, Bbox]] = []
    for (text, x, y), marker in zip(named, taken[: len(named)], strict=True):
        if not any(text == other and marker.overlaps(near) for other, near in written):
            written.append((text, marker.padded(SAME * pixel)))
            taken.append(_name_point(axes, text, (x, y), taken))


def _name_point(axes: Axes, text: str, point: tuple[float, float], taken: Sequence[Bbox]) -> Bbox:
    """Write a name in the first place that is free, or the one where it hides least."""
    found: list[tuple[int, Annotation, Bbox]] = []
    for across, up, horizontal, vertical in _places():
        written = axes.annotate(
            text,
            point,
            xytext=(across, up),
            textcoords="offset points",
            ha=horizontal,
            va=vertical,
            fontsize=NAME,
            arrowprops=LEADER if abs(up) > STEP else None,
        )
        written.set_in_layout(False)
        box = _letters(written)
        inside = axes.bbox.containsx(box.x0) and axes.bbox.containsx(box.x1)
        inside = inside and axes.bbox.containsy(box.y0) and axes.bbox.containsy(box.y1)
        found.append((box.count_overlaps(taken) + 2 * (not inside), written, box))
        if found[-1][0] == 0:
            break
    best = min(found, key=lambda each: each[0])
    for each in found:
        if each is not best:
            each[1].remove()
    return best[2]


def _letters(written: Annotation) -> Bbox:
    """Return the box of a text, without its leader."""
    from matplotlib.text import Text

    written.get_window_extent()
    return Text.get_window_extent(written)


def _places() -> Iterator[Place]:
    """Yield places about a point: beside it first, then farther and farther."""
    for up, vertical in ((-3.0, "top"), (0.0, "center"), (3.0, "bottom")):
        yield -6.0, up, "right", vertical
    for up, vertical in ((3.0, "bottom"), (0.0, "center"), (-3.0, "top")):
        yield 6.0, up, "left", vertical
    for k in range(1, N_STEPS + 1):
        yield -20.0, -3.0 - k * STEP, "right", "top"
        yield 20.0, 3.0 + k * STEP, "left", "bottom"


@dataclass(frozen=True)
class StabilityMap:
    """The state of models by modes and a varied property."""

    title: str
    axis: str
    """The varied property."""
    n_modes: Sequence[int]
    values: Sequence[float]
    """Of the varied property."""
    states: Mapping[tuple[int, float], str]
    """By modes and value: a key of STATES."""


def draw_stability(maps: Sequence[StabilityMap]) -> Figure:
    """Return maps of the models that are stable, and of those that are accurate."""
    n_rows, n_columns = -(-len(maps) // IN_A_ROW), min(len(maps), IN_A_ROW)
    with styled():
        figure = new_figure(MAP * n_columns, MAP * n_rows + 0.5)
        panels = figure.subplots(n_rows, n_columns, squeeze=False).ravel()
        for axes, each in zip(panels, maps, strict=False):
            _draw_map(axes, each)
        for axes in panels[len(maps) :]:
            axes.set_axis_off()
        _explain_states(figure, {state for each in maps for state in each.states.values()})
        return figure


def _draw_map(axes: Axes, drawn: StabilityMap) -> None:
    from matplotlib.patches import Rectangle

    for (n_modes, value), state in drawn.states.items():
        colour, sign = STATES[state]
        x, y = drawn.values.index(value), drawn.n_modes.index(n_modes)
        axes.add_patch(Rectangle((x - 0.5, y - 0.5), 1.0, 1.0, facecolor=colour, edgecolor="white"))
        axes.text(x, y, sign, ha="center", va="center", fontsize=9.0)
    axes.set_xlim(-0.5, len(drawn.values) - 0.5)
    axes.set_ylim(-0.5, len(drawn.n_modes) - 0.5)
    axes.set_xticks(range(len(drawn.values)), [exact(v) for v in drawn.values], rotation=90)
    axes.set_yticks(range(len(drawn.n_modes)), [str(m) for m in drawn.n_modes])
    axes.set_title(drawn.title)
    axes.set_xlabel(drawn.axis)
    axes.set_ylabel("modes M [–]")
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def _explain_states(figure: Figure, shown: Set[str]) -> None:
    from matplotlib.patches import Patch

    handles = [
        Patch(facecolor=colour, label=f"{state} {sign}".strip())
        for state, (colour, sign) in STATES.items()
        if state in shown
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
