"""Pictures of fields, with a colour bar below.

Pictures take fields on a regular grid as (ny, nx), from below; where there is no fluid they are
NaN, and grey. A raster draws scattered points as the value of the nearest one. Where a frame knows
its solids, their outline is drawn as it is, not in the steps of a grid.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree

from sphrom.plots.canvas import SIGNED_MAP, SOLID_COLOUR, SPEED_MAP, limits, symmetric_limits

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

Array = NDArray[np.float64]
Extent = tuple[float, float, float, float]
PIXELS_PER_SPACING = 3.0
MAX_PIXELS = 400
"""Along the longer side of a raster."""
EXTENDED: Any = {
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

    def height(self, width: float) -> float:
        """Return the height of a picture of a width."""
        left, right, lower, upper = self.extent
        return width * (upper - lower) / (right - left)

    def raster(self, position: Array) -> Raster:
        """Return the raster of points (n_points, 2) [m] in this frame."""
        low, high = np.array(self.extent[::2]), np.array(self.extent[1::2])
        spacing = float(np.sqrt(np.prod(high - low) / len(position)))
        pixel = max(spacing / PIXELS_PER_SPACING, float(np.max(high - low)) / MAX_PIXELS)
        nx, ny = np.maximum(1, np.ceil((high - low) / pixel)).astype(int)
        x = low[0] + (np.arange(nx) + 0.5) * (high[0] - low[0]) / nx
        y = low[1] + (np.arange(ny) + 0.5) * (high[1] - low[1]) / ny
        distance, nearest = cKDTree(position).query(np.stack(np.meshgrid(x, y), axis=-1))
        return Raster(np.where(distance <= REACH * spacing, nearest, -1))


@dataclass(frozen=True)
class Raster:
    """Which scattered point each pixel of a picture shows; -1 outside of the fluid."""

    nearest: NDArray[np.int64]

    def picture(self, values: Array) -> Array:
        """Return the values (ny, nx), NaN outside of the fluid."""
        return np.where(self.nearest >= 0, values[self.nearest], np.nan)


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


def scale_of(low: float, high: float) -> tuple[str, tuple[float, float]]:
    """Return the colour map and the scale of fields of a range: about zero where it has zero."""
    ends = np.array([low, high])
    if low < 0.0 < high:
        return SIGNED_MAP, symmetric_limits(ends)
    return SPEED_MAP, limits(ends)


def bar_below(
    figure: Figure,
    image: AxesImage,
    panels: Any,
    label: str,
    aspect: int,
    beyond: tuple[bool, bool] = (False, False),
) -> None:
    """Draw a colour bar under panels; `aspect` in proportion to their width gives one height.

    `beyond` says at which ends values lie beyond the scale: the bar is pointed there. Its labels
    are sparse, with a common factor instead of long numbers.
    """
    from matplotlib.ticker import MaxNLocator, ScalarFormatter

    bar = figure.colorbar(
        image,
        ax=panels,
        location="bottom",
        shrink=0.8,
        aspect=aspect,
        pad=0.03,
        extend=EXTENDED[beyond],
    )
    bar.set_label(label, loc="left")  # a common factor of the numbers stands on the right
    numbers = ScalarFormatter(useMathText=True)
    numbers.set_powerlimits((-2, 4))
    bar.locator, bar.formatter = MaxNLocator(aspect // 6), numbers
    bar.update_ticks()
    bar.ax.xaxis.get_offset_text().set_fontsize(7.5)
