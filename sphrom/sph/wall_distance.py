"""How far points are from walls and from the fluid, corners of both kinds among them."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from sphrom.sph.domain import Domain, Rectangle

Array = NDArray[np.float64]


def wall_distance(domain: Domain, position: Array) -> Array:
    """Return the distance (n_points,) [m] of positions (n_points, 2) [m] to the nearest wall.

    It is zero within walls, and infinite where there are none.
    """
    wrapped = domain.wrap(position)
    nearest = np.full(len(wrapped), np.inf)
    for solid in solids(domain):
        gaps = np.clip(wrapped, solid.lower, solid.upper) - wrapped
        np.minimum(nearest, np.hypot(*gaps.T), out=nearest)
    return nearest


def fluid_distance(domain: Domain, position: Array) -> Array:
    """Return the distance (n_points,) [m] of positions (n_points, 2) [m] to the nearest fluid.

    It is zero within the fluid.
    """
    wrapped = domain.wrap(position)
    images = (
        (-n, 0.0, n) if p else (0.0,) for n, p in zip(domain.lengths, domain.periodic, strict=True)
    )
    shifts = np.array(list(itertools.product(*images)))
    nearest = np.full(len(wrapped), np.inf)
    for part, shift in itertools.product(domain.parts, shifts):
        gaps = np.clip(wrapped, part.lower + shift, part.upper + shift) - wrapped
        np.minimum(nearest, np.hypot(*gaps.T), out=nearest)
    return nearest


def solids(domain: Domain) -> list[Rectangle]:
    """Return rectangles that cover the solid: all around the box, where an axis isn't periodic.

    Each is as long along x as it may be: where two met within a floor or a ceiling, or behind the
    corner of a box, the further one would look like a corner that juts into the fluid.
    """
    x, y = (_cuts(domain, axis) for axis in (0, 1))
    columns = 0.5 * np.add(x[1:], x[:-1])
    found = []
    for low, high in itertools.pairwise(y):
        centres = np.stack((columns, np.full_like(columns, 0.5 * (low + high))), axis=1)
        solid = np.pad(~domain.contains(centres), 1)
        ends = np.flatnonzero(np.diff(solid)).reshape(-1, 2)
        found += [Rectangle((x[first], low), (x[last], high)) for first, last in ends]
    return found


def _cuts(domain: Domain, axis: int) -> list[float]:
    """Return where an edge of the fluid may lie along an axis, beyond the box on either side."""
    low, high, length = domain.lower[axis], domain.upper[axis], domain.lengths[axis]
    bounds = (
        low,
        high,
        *(edge[axis] for part in domain.parts for edge in (part.lower, part.upper)),
    )
    # Along a periodic axis the nearest wall may be an image; else the box's edge is one.
    images = (-length, 0.0, length) if domain.periodic[axis] else (0.0,)
    cuts = {bound + image for bound in bounds for image in images}
    return sorted(cuts | {low - length, high + length})
