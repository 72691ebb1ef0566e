"""Maps of the stability of reduced models, by modes and a property that is varied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sphrom.plots.canvas import new_figure, styled
from sphrom.text import exact

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STATES = {
    "stable": ("#56B4E9", ""),
    "inaccurate": ("#E69F00", "~"),
    "unstable": ("#D55E00", "×"),
    "full unstable": ("#999999", "×"),
    "refused": ("#E5E5E5", "–"),
}
"""The colour and the sign of each state."""
PANEL = 3.3
"""Width and height of a map [inch]."""
IN_A_ROW = 4


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
        figure = new_figure(PANEL * n_columns, PANEL * n_rows + 0.5)
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
