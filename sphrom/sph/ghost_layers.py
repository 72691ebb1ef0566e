"""Ghosts behind walls of any shape: rows along the wall, as far behind it as fluid lies before it.

Each row follows the fluid's outline at half a spacing, one and a half, and so on, and is divided
evenly between corners, so that a fluid that slides along the wall finds the same ghosts everywhere.
Ghosts that are packed without such order are rough: fluid along a wall that moves then has an error
across it of 1 % of the wall's speed, along rows of 0.3 % at first, which fades.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

Array = NDArray[np.float64]

CORNER = math.radians(20.0)
"""A row that turns by more than this at a point has a corner there, and is divided at it."""
MITRE_LIMIT = 1.5
"""Rows around corners of the fluid are as sharp as these, up to about a right angle."""


def ghost_rows(fluid: BaseGeometry, frame: BaseGeometry, spacing: float, n_layers: int) -> Array:
    """Return points (n_ghosts, 2) [m] in rows behind the outline of the fluid.

    Parameters
    ----------
    fluid : with its images, as far as rows reach beyond the frame.
    frame : the part of the plane that ghosts are wanted in: one period of the fluid.
    """
    points = [
        point
        for layer in range(n_layers)
        for row in _rows(fluid, frame, (layer + 0.5) * spacing)
        if len(point := _divided(row, spacing))
    ]
    return np.concatenate(points) if points else np.empty((0, 2))


def _rows(fluid: BaseGeometry, frame: BaseGeometry, depth: float) -> Iterator[BaseGeometry]:
    """Yield the lines at a depth [m] behind the fluid's outline, within the frame."""
    grown = shapely.buffer(fluid, depth, join_style="mitre", mitre_limit=MITRE_LIMIT)
    for ring in shapely.get_rings(shapely.get_parts(grown)):
        for line in _between_corners(shapely.get_coordinates(ring)[:-1]):
            within = shapely.intersection(line, frame)
            if isinstance(within, shapely.MultiLineString):
                within = shapely.line_merge(within)
            yield from shapely.get_parts(within)


def _between_corners(place: Array) -> Iterator[BaseGeometry]:
    """Yield the stretches without corners of a closed line through points (n_points, 2)."""
    along = np.roll(place, -1, axis=0) - place
    heading = np.arctan2(along[:, 1], along[:, 0])
    turn = np.abs(np.angle(np.exp(1j * (heading - np.roll(heading, 1)))))
    corners = np.flatnonzero(turn > CORNER)
    if not corners.size:
        yield shapely.linestrings(np.concatenate((place, place[:1])))
    for first, last in zip(corners, np.roll(corners, -1), strict=True):
        steps = (last - first) % len(place) or len(place)
        yield shapely.linestrings(place[(first + np.arange(steps + 1)) % len(place)])


def _divided(line: BaseGeometry, spacing: float) -> Array:
    """Return the middles (n_points, 2) of equal parts of a line, about as long as the spacing."""
    length = shapely.length(line)
    number = round(length / spacing)
    middles = (np.arange(number) + 0.5) * (length / max(number, 1))
    return np.asarray(shapely.get_coordinates(shapely.line_interpolate_point(line, middles)))
