"""A picture of a case before it runs: particles, ghosts, walls by name, and what is compared."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.plots.canvas import COLOURS, INK, new_figure, styled
from sphrom.plots.pictures import Solids

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

WIDTH, HEIGHT = 9.0, 7.5
"""Of the frame, at most [inch]."""
FLUID, GHOST, MOVING, STATION = COLOURS[5], "#8a8a8a", COLOURS[1], COLOURS[3]
MEASURED = STATION
LONGEST_ARROW = 0.08
"""Of the frame's diagonal, for the fastest wall."""
MOST_ARROWS = 12
"""Of one wall."""
VECTORS_BELOW = 5_000
"""More particles are drawn as pixels, even in a file of vectors."""


@dataclass(frozen=True)
class NamedWall:
    """A wall: where its name stands, and its velocity at some places."""

    name: str
    label_at: Array
    """(2,) [m]."""
    upright: bool
    """Whether the name runs upwards."""
    place: Array
    """(n_places, 2) [m]."""
    velocity: Array
    """(n_places, 2) [m/s]."""

    @property
    def speed(self) -> float:
        """The largest speed [m/s]."""
        return float(np.linalg.norm(self.velocity, axis=1).max(initial=0.0))


@dataclass(frozen=True)
class Preview:
    """What there is to see of a case before it runs; lengths in [m]."""

    frame: tuple[float, float, float, float]
    """Left, right, lower and upper edge of the picture."""
    spacing: float
    position: Array
    """(n_particles, 2)."""
    ghost_position: Array
    """(n_ghosts, 2)."""
    solids: Solids
    walls: Sequence[NamedWall]
    periodic: Sequence[str]
    """Axes along which the flow repeats."""
    line: tuple[float, Sequence[tuple[float, float]]]
    """x of the line that runs are compared along, and its intervals in the fluid."""
    stations: Array
    """(n_stations, 2) where histories are kept."""
    title: str
    measured: Mapping[str, Array] = field(default_factory=dict)
    """By name, the place (1, 2) of a probe, or the ends (2, 2) of a line or section."""
    sections: Collection[str] = ()
    """Names of the sections; flow to the right, seen from start to end, counts as positive."""


def draw_preview(preview: Preview) -> Figure:
    """Return the picture of a case before it runs."""
    left, right, lower, upper = preview.frame
    width = min(WIDTH, HEIGHT * (right - left) / (upper - lower))
    with styled():
        figure = new_figure(max(5.0, width + 0.9), width * (upper - lower) / (right - left) + 1.5)
        axes = figure.subplots()
        _draw_points(axes, preview, 72.0 * width * preview.spacing / (right - left))
        _draw_walls(axes, preview)
        _draw_line(axes, preview)
        _draw_measured(axes, preview)
        axes.set(xlim=(left, right), ylim=(lower, upper), xlabel="x [m]", ylabel="y [m]")
        axes.set_aspect("equal")
        axes.set_title(preview.title)
        figure.legend(loc="outside lower center", ncols=3)
    return figure


def _draw_points(axes: Axes, preview: Preview, spacing_in_points: float) -> None:
    """Draw particles and ghosts, whose spacing is so many points of print."""
    size = max(0.4, 0.5 * spacing_in_points) ** 2
    for position, colour, label in (
        (preview.position, FLUID, "fluid particles"),
        (preview.ghost_position, GHOST, "ghosts"),
    ):
        if len(position):
            axes.scatter(
                position[:, 0],
                position[:, 1],
                s=size,
                color=colour,
                linewidths=0.0,
                label=f"{label}, {len(position)}",
                rasterized=len(position) > VECTORS_BELOW,
            )


def _draw_walls(axes: Axes, preview: Preview) -> None:
    if not preview.walls:
        return
    solids = preview.solids
    solids.cover(axes)
    axes.contour(
        solids.x, solids.y, solids.wall_distance, levels=(0.0,), colors=[INK], linewidths=1.6
    )
    fastest = max(wall.speed for wall in preview.walls)
    left, right, lower, upper = preview.frame
    arrow = LONGEST_ARROW * float(np.hypot(right - left, upper - lower))
    for wall in preview.walls:
        text = wall.name if wall.speed == 0.0 else f"{wall.name}, {wall.speed:.3g} m/s"
        axes.text(
            wall.label_at[0],
            wall.label_at[1],
            text,
            ha="center",
            va="center",
            rotation=90.0 if wall.upright else 0.0,
            fontsize=8.5,
            color=INK if wall.speed == 0.0 else MOVING,
            bbox={"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 1.2},
            zorder=6,
        )
        if wall.speed > 0.0:
            every = -(-len(wall.place) // MOST_ARROWS)
            axes.quiver(
                *wall.place[::every].T,
                *(arrow / fastest * wall.velocity[::every]).T,
                angles="xy",
                scale_units="xy",
                scale=1.0,
                width=0.0035,
                color=MOVING,
                zorder=5,
            )
    if fastest > 0.0:
        axes.plot([], [], color=MOVING, label=f"velocity of walls, at most {fastest:.3g} m/s")


def _draw_measured(axes: Axes, preview: Preview) -> None:
    """Draw probes, lines and sections with their names, and where flow counts as positive."""
    left, right, lower, upper = preview.frame
    length = LONGEST_ARROW * float(np.hypot(right - left, upper - lower))
    labels = dict.fromkeys(("probes", "lines", "sections"))
    for name, ends in preview.measured.items():
        kind = "sections" if name in preview.sections else ("probes", "lines")[len(ends) - 1]
        label = kind if kind in labels else "_nolegend_"
        labels.pop(kind, None)
        middle = ends.mean(axis=0)
        if kind == "probes":
            axes.plot(
                *middle,
                marker="o",
                linestyle="none",
                markersize=6.0,
                label=label,
                color=MEASURED,
                zorder=5,
            )
        else:
            dashes = "-" if kind == "sections" else "-."
            axes.plot(
                *ends.T, linestyle=dashes, linewidth=1.8, label=label, color=MEASURED, zorder=5
            )
        if kind == "sections":
            way = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            arrow = 0.6 * length * np.array([way[1], -way[0]])
            axes.annotate(
                "", middle + arrow, middle, arrowprops={"arrowstyle": "->", "color": MEASURED}
            )
        axes.annotate(
            name,
            0.75 * ends[0] + 0.25 * ends[-1],
            xytext=(5.0, 5.0),
            textcoords="offset points",
            fontsize=8.5,
            color=MEASURED,
            bbox={"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 1.2},
            zorder=7,
        )


def _draw_line(axes: Axes, preview: Preview) -> None:
    """Draw what is compared, and the edges at which the flow repeats."""
    x, intervals = preview.line
    label = "compared line"
    for interval in intervals:
        axes.plot([x, x], interval, color=COLOURS[0], linestyle="--", label=label, zorder=4)
        label = "_nolegend_"
    if len(preview.stations):
        axes.scatter(
            preview.stations[:, 0],
            preview.stations[:, 1],
            marker="D",
            s=36,
            color=STATION,
            label="stations",
            zorder=5,
        )
    left, right, lower, upper = preview.frame
    label = f"repeats along {' and '.join(preview.periodic)}"
    for axis in preview.periodic:
        ends = ((left, right), (axes.axvline)) if axis == "x" else ((lower, upper), axes.axhline)
        for end in ends[0]:
            ends[1](end, color=COLOURS[2], linestyle=":", linewidth=2.5, label=label, zorder=4)
            label = "_nolegend_"
