"""Polygons in a box that is periodic along some axes."""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterable, Iterator

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.affinity import translate
from shapely.geometry.base import BaseGeometry

from sphrom.sph.domain import ROUNDING

Array = NDArray[np.float64]
Lengths = tuple[float, float]
"""Of the box, along x and y [m]."""
Periodic = tuple[bool, bool]

MOST_CROSSINGS = 1e5
"""Of the edges of shapes that are combined, which takes a second."""
N_EDGES = 50
"""Edges whose crossings are counted."""
N_CORNERS = 256
"""Of the polygon that stands for a circle: off by 4e-5 of the radius."""


def disc(centre: tuple[float, float], radius: float) -> BaseGeometry:
    """Return a circle as a polygon of the same area."""
    turns = np.linspace(0.0, 2.0 * math.pi, N_CORNERS, endpoint=False)
    step = 2.0 * math.pi / N_CORNERS
    corner = radius * math.sqrt(step / math.sin(step))
    return shapely.Polygon(
        np.array(centre) + corner * np.stack((np.cos(turns), np.sin(turns)), axis=1)
    )


def digest(shape: BaseGeometry) -> str:
    """Return what tells a shape from any other, to the last bit."""
    return hashlib.sha256(shapely.to_wkb(shape)).hexdigest()[:16]


def edges_of(shapes: Iterable[BaseGeometry]) -> tuple[Array, Array]:
    """Return where the edges of shapes start and end, each (n_edges, 2) [m]."""
    rings = shapely.get_rings(shapely.get_parts(list(shapes)))
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    within = ring[1:] == ring[:-1]
    return corners[:-1][within], corners[1:][within]


def require_few_crossings(shapes: Iterable[BaseGeometry]) -> None:
    """Raise ValueError where edges cross so often that it takes long to combine shapes.

    The number is estimated from a few edges.
    """
    found = np.array(list(shapes), dtype=object)
    one, other = shapely.STRtree(found).query(found)
    # Shapes that are apart from all others have no part in it.
    start, end = (corners.T for corners in edges_of(found[np.unique(one[one != other])]))
    chosen = np.random.default_rng(0).permutation(start.shape[1])[:N_EDGES]
    n_crossings = 0
    for edge in chosen:
        one, other = start[:, [edge]], end[:, [edge]]
        apart = _side(one, other, start) * _side(one, other, end) < 0.0
        crossed = apart & (_side(start, end, one) * _side(start, end, other) < 0.0)
        n_crossings += int(np.sum(crossed))
    crossings = 0.5 * n_crossings * start.shape[1] / max(1, len(chosen))
    if crossings > MOST_CROSSINGS:
        raise ValueError(f"outlines cross about {crossings:.0e} times; simplify them")


def _side(start: Array, end: Array, place: Array) -> Array:
    """Return 1 for places on the left of edges, -1 on their right; x, y are along first axes."""
    (a, b), (x, y) = end - start, place - start
    return np.sign(a * y - b * x)


def periodic_shifts(
    lengths: Lengths, periodic: Periodic, number: int = 1
) -> list[tuple[float, float]]:
    """Return the ways [m] to periodic images, some boxes away on either side."""
    turns = (range(-number, number + 1) if repeats else (0,) for repeats in periodic)
    width, height = lengths
    return [(i * width, j * height) for i, j in itertools.product(*turns)]


def joined_areas(shape: BaseGeometry, lengths: Lengths, periodic: Periodic) -> Array:
    """Return the areas [m2] of a shape's separate parts; periodic edges join some."""
    # Few commands need it, and loading it takes long.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    parts = shapely.get_parts(shape)
    pairs = [
        pair for axis in range(2) if periodic[axis] for pair in _joined_across(axis, parts, lengths)
    ]
    ends = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(len(pairs)), tuple(ends)), shape=(len(parts), len(parts)))
    number, part_of = connected_components(graph, directed=False)
    return np.bincount(part_of, shapely.area(parts), minlength=number).astype(np.float64)


def _joined_across(
    axis: int, parts: NDArray[np.object_], lengths: Lengths
) -> Iterator[tuple[int, int]]:
    """Yield which parts go on in which others, past a periodic edge."""
    shift = [length if i == axis else 0.0 for i, length in enumerate(lengths)]
    moved = np.array([translate(part, *shift) for part in parts])
    here, there = shapely.STRtree(parts).query(moved, predicate="intersects")
    shared = shapely.length(shapely.intersection(moved[here], parts[there]))
    wide = shared > ROUNDING * max(lengths)
    yield from zip(here[wide].tolist(), there[wide].tolist(), strict=True)
