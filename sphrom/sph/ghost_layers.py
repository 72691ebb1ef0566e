"""Ghosts behind walls of any shape: rows along the wall, as far behind it as fluid lies before it.

Each row follows the fluid's outline at half a spacing, one and a half, and so on. It has a ghost in
each of its corners, and is divided evenly between them: fluid that slides along a wall finds the
same ghosts everywhere. Ghosts that are packed without such order are rough. Fluid beside a wall
that turns then has an error of 1.4 % of the wall's speed (50 particles across, most of it across
the wall), and 0.2 % beside rows.
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
"""A row that turns by more than this at a point has a corner there."""
TINY = 1e-6
"""Bends of a row that are smaller, over the spacing, are rounding."""
MITRE_LIMIT = 1.5
"""Rows around corners of the fluid are as sharp as these, up to about a right angle."""


def ghost_rows(fluid: BaseGeometry, frame: BaseGeometry, spacing: float, n_layers: int) -> Array:
    """Return points (n_ghosts, 2) [m] in rows behind the outline of the fluid.

    Parameters
    ----------
    fluid : with its images, as far as rows reach beyond the frame.
    frame : the part of the plane that ghosts are wanted in: one period of the fluid.
    """
    found = [np.empty((0, 2))]
    for layer in range(n_layers):
        depth = (layer + 0.5) * spacing
        grown = shapely.buffer(fluid, depth, join_style="mitre", mitre_limit=MITRE_LIMIT)
        grown = shapely.simplify(grown, TINY * spacing)
        for ring in shapely.get_rings(shapely.get_parts(grown)):
            place = shapely.get_coordinates(ring)[:-1]
            corners = np.flatnonzero(_turns(place) > CORNER)
            found.append(place[corners][_within(place[corners], frame)])
            for stretch in _stretches(place, corners):
                found += [_divided(part, place[corners], spacing) for part in _cut(stretch, frame)]
    return np.concatenate(found)


def _turns(place: Array) -> Array:
    """Return by how much a closed line turns at its points (n_points, 2)."""
    along = np.roll(place, -1, axis=0) - place
    heading = np.arctan2(along[:, 1], along[:, 0])
    return np.abs(np.angle(np.exp(1j * (heading - np.roll(heading, 1)))))


def _within(place: Array, frame: BaseGeometry) -> NDArray[np.bool_]:
    """Return which points lie in a frame, its lower edges included."""
    left, low, right, high = shapely.bounds(frame)
    inside = (place >= (left, low)) & (place < (right, high))
    return np.asarray(inside.all(axis=1))


def _stretches(place: Array, corners: NDArray[np.int64]) -> Iterator[BaseGeometry]:
    """Yield what lies between the corners of a closed line through points (n_points, 2)."""
    if not corners.size:
        yield shapely.linestrings(np.concatenate((place, place[:1])))
    for first, last in zip(corners, np.roll(corners, -1), strict=True):
        steps = (last - first) % len(place) or len(place)
        yield shapely.linestrings(place[(first + np.arange(steps + 1)) % len(place)])


def _cut(line: BaseGeometry, frame: BaseGeometry) -> NDArray[np.object_]:
    """Return the parts of a line within a frame."""
    within = shapely.intersection(line, frame)
    parts = shapely.get_parts(
        shapely.line_merge(within) if isinstance(within, shapely.MultiLineString) else within
    )
    return np.asarray(parts[shapely.length(parts) > 0.0])


def _divided(line: BaseGeometry, corners: Array, spacing: float) -> Array:
    """Return points (n_points, 2) that divide a line evenly, about a spacing apart.

    They are a whole step from an end that is a corner, where another point stands, and half a step
    from an end where the frame has cut the line, or where a closed line begins.
    """
    ends = shapely.get_coordinates(line)[[0, -1]]
    gaps = np.where((ends[:, None] == corners).all(axis=2).any(axis=1), 1.0, 0.5)
    length = float(shapely.length(line))
    number = round(length / spacing - gaps.sum()) + 1
    if number < 1:
        return np.empty((0, 2))
    places = (np.arange(number) + gaps[0]) * (length / (number - 1 + gaps.sum()))
    return np.asarray(shapely.get_coordinates(shapely.line_interpolate_point(line, places)))
