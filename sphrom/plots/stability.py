"""Maps of the stability of reduced models, by modes and a property that is varied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sphrom.plots.canvas import new_figure, styled
from sphrom.text import exact

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

STATES = {
    "stable": ("#56B4E9", ""),
    "inaccurate": ("#E69F00", "~"),
    "unstable": ("#D55E00", "×"),
    "full unstable": ("#999999", "×"),
    "refused": ("#E5E5E5", "–"),
}
"""The colour and the sign of each state."""
CELL = 0.36
"""Of a map [inch]."""
LEAST_CELLS = 5.5
"""How wide a map is at least, in cells, for its title."""
LEAST_ROWS = 4
"""How tall a map is at least, in cells, for the name of its axis."""
MARGIN_CELLS = 0.8
"""Beside a map, in cells."""


@dataclass(frozen=True)
class StabilityMap:
    """The state of models by modes and what is varied."""

    title: str
    axis: str
    """What is varied."""
    n_modes: Sequence[int]
    values: Sequence[float]
    """Of what is varied."""
    states: Mapping[tuple[int, float], str]
    """By modes and value: a key of STATES."""


def draw_stability(rows: Sequence[Sequence[StabilityMap]]) -> Figure:
    """Return rows of maps: which models are stable, and which accurate."""
    with styled():
        cells = max(sum(_width(each) for each in maps) for maps in rows)
        longest = max(len(each.n_modes) for maps in rows for each in maps)
        height = 1.3 + CELL * max(LEAST_ROWS, longest)
        figure = new_figure(1.2 + CELL * cells, height * len(rows) + 0.3)
        shown = [each for maps in rows for each in maps]
        # The legend stands below all rows.
        below = figure.subfigures(len(rows), 1, squeeze=False)[:, 0]
        for part, maps in zip(below, rows, strict=True):
            _draw_row(part, maps, cells)
        _explain_states(figure, {state for each in shown for state in each.states.values()})
        return figure


def _width(drawn: StabilityMap) -> float:
    """Return how wide a map is, in cells: its title needs some of it."""
    return max(LEAST_CELLS, len(drawn.values)) + MARGIN_CELLS


def _draw_row(part: SubFigure, maps: Sequence[StabilityMap], cells: float) -> None:
    """Draw maps side by side, as wide as they have values, and nothing beside them."""
    widths = [_width(each) for each in maps]
    rest = cells - sum(widths)
    ratios = [*widths, rest] if rest > 0.0 else widths
    panels = part.subplots(1, len(ratios), sharey=True, squeeze=False, width_ratios=ratios)[0]
    for axes, each in zip(panels, maps, strict=False):
        _draw_map(axes, each)
    for axes in panels[len(maps) :]:
        axes.set_axis_off()
    panels[0].set_ylabel("modes M [–]")
    part.align_xlabels(list(panels[: len(maps)]))


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
