"""Pictures of fields: full against reduced, modes (Fig. 6-8), and an overview in one figure.

Pictures take fields on a regular grid as (ny, nx), from below; where there is no fluid they are
NaN, and grey. Modes come on scattered points, and are drawn as the value of the nearest one. Where
a frame knows its solids, their outline is drawn as it is, not in the steps of a grid.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from sphrom.metrics.histories import History
from sphrom.plots.canvas import (
    DIFFERENCE_MAP,
    SIGNED_MAP,
    SOLID_COLOUR,
    SPEED_MAP,
    Fields,
    limits,
    new_figure,
    styled,
    symmetric_limits,
)
from sphrom.plots.curves import plot_errors

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colorbar import Colorbar
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

Array = NDArray[np.float64]
Extent = tuple[float, float, float, float]
PIXELS_PER_SPACING = 3.0
LEAST_OVERVIEW = 3.8
"""Height of an overview, whose errors have a long label [inch]."""
WIDEST_MODES = 15.0
"""Of the panels of modes [inch]."""
MAX_PIXELS = 400
"""Along the longer side of a mode's picture."""
EXTENDED = {
    (False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both",
}  # fmt: skip
"""How matplotlib calls the ends that a colour bar is pointed at."""
REACH = 1.1
"""A pixel farther than this many spacings from any point lies outside of the fluid."""


@dataclass(frozen=True)
class Solids:
    """Where there is no fluid, on pixels."""

    x: Array
    """(nx,) [m]"""
    y: Array
    """(ny,) [m]"""
    wall_distance: Array
    """(ny, nx) the signed distance from walls [m], negative in the solid."""

    def cover(self, axes: Axes) -> None:
        """Draw the solids over what a picture shows there."""
        axes.contourf(
            self.x,
            self.y,
            self.wall_distance,
            levels=(-np.inf, 0.0),
            colors=[SOLID_COLOUR],
            zorder=0.5,  # above images, below everything else
        )


@dataclass(frozen=True)
class Frame:
    """What of the plane a picture shows."""

    extent: Extent
    """Left, right, lower and upper edge [m]."""
    solids: Solids | None = None


@dataclass(frozen=True)
class Modes:
    """Modes of a trial basis on scattered points."""

    position: Array
    """(n_points, 2) [m]"""
    density: Array
    """(n_modes, n_points)"""
    velocity: Array
    """(n_modes, n_points, 2)"""


def draw_fields(
    frame: Frame, full: Fields, reduced: Mapping[str, Fields], *, about: str = ""
) -> Figure:
    """Return full, reduced and difference side by side, a row for each reduced model.

    Speed stands on the left, pressure on the right; each has one colour scale for all of its
    fields and one for all of its differences. Raises ValueError without a reduced model.
    """
    if not reduced:
        raise ValueError("there is no reduced model to draw")
    height, n_rows = panel_height(frame.extent, 1.9), len(reduced)
    with styled():
        figure = new_figure(13.2, n_rows * (height + 0.1) + 1.5)
        panels = figure.subplots(n_rows, 6, squeeze=False, sharex=True, sharey=True)
        models = list(reduced.values())
        speeds, pressures = [m.speed for m in models], [m.pressure for m in models]
        _field_block(figure, panels[:, :3], frame, full.speed, speeds, "speed", "m/s")
        _field_block(figure, panels[:, 3:], frame, full.pressure, pressures, "pressure", "Pa")
        for row, label in zip(panels, reduced, strict=True):
            row[0].set_ylabel(f"{label}\n\ny [m]")
        for axes in panels[-1]:
            axes.set_xlabel("x [m]")
        if about:
            figure.suptitle(about, fontsize=9.5)
        return figure


def draw_modes(
    spaces: Mapping[str, Modes],
    numbers: Sequence[int],
    *,
    unit: str = "–",
    solids: Solids | None = None,
) -> Figure:
    """Return density and velocity of the modes of these numbers (from 1), a column each.

    `spaces` are, for example, reference space and Lagrangian space, side by side. `unit` is that
    of the modes: 1/m where a volume weights them.
    """
    columns = [(space, number) for space in spaces for number in numbers]
    rows = [f"{field} [{unit}]" for field in ("density", "x-velocity", "y-velocity")]
    rasters = {space: Raster.of(modes.position) for space, modes in spaces.items()}
    width = min(1.8, WIDEST_MODES / len(columns))
    height = panel_height(next(iter(rasters.values())).extent, width)
    with styled():
        figure = new_figure(0.8 + (width + 0.15) * len(columns), 3 * (height + 0.55) + 0.9)
        panels = figure.subplots(3, len(columns), squeeze=False, sharex=True, sharey=True)
        for column, (space, number) in enumerate(columns):
            modes, raster = spaces[space], rasters[space]
            velocity = modes.velocity[number - 1]
            for axes, values in zip(
                panels[:, column], (modes.density[number - 1], *velocity.T), strict=True
            ):
                image = _signed_image(axes, Frame(raster.extent, solids), raster.picture(values))
                bar = figure.colorbar(image, ax=axes, location="bottom", aspect=18, pad=0.02)
                _few_ticks(bar, 3 if width > 1.6 else 2)
                axes.locator_params(axis="x", nbins=3)
            panels[0, column].set_title(f"{space}\nmode {number}")
            panels[-1, column].set_xlabel("x [m]")
        for row, label in zip(panels, rows, strict=True):
            row[0].set_ylabel(f"{label}\n\ny [m]")
        return figure


def draw_overview(
    frame: Frame,
    full_speed: Array,
    reduced_speed: Array,
    errors: Mapping[str, History],
    *,
    reduced_label: str = "reduced model",
    about: str = "",
) -> Figure:
    """Return one wide figure: full speed, reduced speed, difference, and error histories.

    `about` says at which parameters and when the fields are.
    """
    with styled():
        figure = new_figure(13.2, max(LEAST_OVERVIEW, panel_height(frame.extent, 2.6) + 1.1))
        panels = figure.subplots(1, 4, width_ratios=(1.0, 1.0, 1.0, 1.35))
        for axes in panels[1:3]:
            axes.sharey(panels[0])
            axes.tick_params(labelleft=False)
        shared = limits(full_speed, reduced_speed)
        difference = reduced_speed - full_speed
        for axes, field, label in zip(
            panels, (full_speed, reduced_speed), ("full model", reduced_label), strict=False
        ):
            image = show(axes, frame, field, SPEED_MAP, shared)
            axes.set_title(label)
        bar_below(figure, image, list(panels[:2]), "speed [m/s]", 40)
        image = show(panels[2], frame, difference, DIFFERENCE_MAP, symmetric_limits(difference))
        panels[2].set_title("difference")
        bar_below(figure, image, panels[2], "difference [m/s]", 20)
        for axes in panels[:3]:
            axes.set_xlabel("x [m]")
        panels[0].set_ylabel("y [m]")
        plot_errors(panels[3], ("velocity_field", "relative_l2"), errors)
        panels[3].set_title("errors at all instants")
        panels[3].legend(loc="best")
        if about:
            figure.suptitle(about, fontsize=9.5)
        return figure


def _field_block(
    figure: Figure,
    panels: NDArray[Any],
    frame: Frame,
    full: Array,
    reduced: Sequence[Array],
    name: str,
    unit: str,
) -> None:
    """Draw three columns of one quantity: full, reduced, difference, and their colour bars."""
    signed = name == "pressure"
    shared = (symmetric_limits if signed else limits)(full, *reduced)
    colours = SIGNED_MAP if signed else SPEED_MAP
    differences = [field - full for field in reduced]
    about_zero = symmetric_limits(*differences)
    for row, field, difference in zip(panels, reduced, differences, strict=True):
        image = show(row[0], frame, full, colours, shared)
        show(row[1], frame, field, colours, shared)
        error = show(row[2], frame, difference, DIFFERENCE_MAP, about_zero)
    for axes, title in zip(panels[0], ("full", "reduced", "difference"), strict=True):
        axes.set_title(f"{name}, {title}")
    bar_below(figure, image, panels[:, :2], f"{name} [{unit}]", 36)
    bar_below(figure, error, panels[:, 2], f"difference [{unit}]", 18)


def bar_below(
    figure: Figure,
    image: AxesImage,
    panels: Any,
    label: str,
    aspect: int,
    beyond: tuple[bool, bool] = (False, False),
) -> None:
    """Draw a colour bar under panels; `aspect` in proportion to their width gives one height.

    `beyond` says at which ends values lie beyond the scale: the bar is pointed there.
    """
    ends: Any = EXTENDED[beyond]
    bar = figure.colorbar(
        image, ax=panels, location="bottom", shrink=0.8, aspect=aspect, pad=0.03, extend=ends
    )
    bar.set_label(label, loc="left")  # a common factor of the numbers stands on the right
    _few_ticks(bar, aspect // 6)


def _few_ticks(bar: Colorbar, count: int) -> None:
    """Label a colour bar sparsely, with a common factor instead of long numbers."""
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    numbers = ScalarFormatter(useMathText=True)
    numbers.set_powerlimits((-2, 4))
    bar.locator, bar.formatter = MaxNLocator(count), numbers
    bar.update_ticks()
    bar.ax.xaxis.get_offset_text().set_fontsize(7.5)


def show(
    axes: Axes, frame: Frame, field: Array, colours: str, scale: tuple[float, float]
) -> AxesImage:
    """Draw a field (ny, nx) into axes, with a colour map and the ends of its scale."""
    axes.set_facecolor(SOLID_COLOUR)
    shown = field if frame.solids is None else _continued(field)
    image = axes.imshow(
        shown, origin="lower", extent=frame.extent, cmap=colours, vmin=scale[0], vmax=scale[1]
    )
    if frame.solids is not None:
        frame.solids.cover(axes)
        axes.set(xlim=frame.extent[:2], ylim=frame.extent[2:])
    return image


def _continued(field: Array) -> Array:
    """Return a field (ny, nx) whose NaN have the value of the nearest pixel that has one."""
    missing = np.isnan(field)
    if missing.all():
        return field
    rows, columns = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return field[rows, columns]


def _signed_image(axes: Axes, frame: Frame, field: Array) -> AxesImage:
    """Draw a field about zero if it changes sign, over its own range if it does not."""
    return show(axes, frame, field, *scale_of(field))


def scale_of(
    field: Array, shared: tuple[float, float] | None = None
) -> tuple[str, tuple[float, float]]:
    """Return the colour map and scale of a field, or of those whose range is shared."""
    ends = np.array(limits(field) if shared is None else shared)
    if ends[0] < 0.0 < ends[1]:
        return SIGNED_MAP, symmetric_limits(ends)
    return SPEED_MAP, limits(ends)


def panel_height(extent: Extent, width: float) -> float:
    """Return the height of a panel of a width that shows an extent."""
    return width * (extent[3] - extent[2]) / (extent[1] - extent[0])


@dataclass(frozen=True)
class Raster:
    """Which scattered point each pixel of a picture shows; -1 outside of the fluid."""

    nearest: NDArray[np.int64]
    extent: Extent

    @classmethod
    def of(cls, position: Array, extent: Extent | None = None) -> Raster:
        """Return the raster of points (n_points, 2) in an extent, or all around them."""
        low, high = position.min(axis=0), position.max(axis=0)
        if extent is not None:
            low, high = np.array(extent[::2]), np.array(extent[1::2])
        spacing = float(np.sqrt(np.prod(high - low) / len(position)))
        if extent is None:
            low, high = low - 0.5 * spacing, high + 0.5 * spacing
        pixel = max(spacing / PIXELS_PER_SPACING, float(np.max(high - low)) / MAX_PIXELS)
        nx, ny = np.maximum(1, np.ceil((high - low) / pixel)).astype(int)
        x = low[0] + (np.arange(nx) + 0.5) * (high[0] - low[0]) / nx
        y = low[1] + (np.arange(ny) + 0.5) * (high[1] - low[1]) / ny
        distance, nearest = cKDTree(position).query(np.stack(np.meshgrid(x, y), axis=-1))
        nearest = np.where(distance <= REACH * spacing, nearest, -1)
        return cls(nearest, (float(low[0]), float(high[0]), float(low[1]), float(high[1])))

    def picture(self, values: Array) -> Array:
        """Return the values (ny, nx), NaN outside of the fluid."""
        return np.where(self.nearest >= 0, values[self.nearest], np.nan)
