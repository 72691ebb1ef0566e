"""Frames of an animation: fields on a regular grid as coloured pixels, side by side, as PNG."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.plots.canvas import SOLID_COLOUR

Array = NDArray[np.float64]
Pixels = NDArray[np.uint8]

GAP = 4
"""White pixels between two panels."""
LEAST_WIDTH = 160
"""Of a panel [pixels]: on coarser grids each point is a square of several."""


@dataclass(frozen=True)
class Scale:
    """Which colours stand for which values."""

    colours: str
    """Of matplotlib's maps."""
    low: float
    high: float

    def gradient(self, n_colours: int = 9) -> list[str]:
        """Return colours from the lowest value to the highest, as CSS has them."""
        from matplotlib import colormaps
        from matplotlib.colors import to_hex

        return [to_hex(c) for c in colormaps[self.colours](np.linspace(0.0, 1.0, n_colours))]


def paint(field: Array, scale: Scale) -> Pixels:
    """Return a field (ny, nx), from below, as pixels (rows, columns, 3), from above.

    Where it is NaN there is no fluid.
    """
    from matplotlib import colormaps
    from matplotlib.colors import Normalize, to_rgba

    colours = colormaps[scale.colours].with_extremes(bad=to_rgba(SOLID_COLOUR))
    values = Normalize(scale.low, scale.high)(np.ma.masked_invalid(field[::-1]))
    pixels = np.asarray(colours(values, bytes=True))[..., :3]
    times = -(-LEAST_WIDTH // field.shape[1])
    return pixels.repeat(times, axis=0).repeat(times, axis=1)


def side_by_side(panels: Sequence[Pixels], axis: int = 1) -> Pixels:
    """Return panels beside each other, or below with `axis` 0, white between them."""
    shape = list(panels[0].shape)
    shape[axis] = GAP
    gap = np.full(shape, 255, dtype=np.uint8)
    parts = [part for panel in panels for part in (panel, gap)]
    return np.concatenate(parts[:-1], axis=axis)


def as_png(pixels: Pixels) -> bytes:
    """Return pixels as a PNG file."""
    from matplotlib.image import imsave

    content = io.BytesIO()
    imsave(content, pixels, format="png")
    return content.getvalue()
