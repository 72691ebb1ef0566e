"""Axis-parallel rectangles: how far they are from points, and what they cover."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Block = tuple[int, int, int, int]
"""Left, lower, right and upper edges of a rectangle, in particle spacings."""


@dataclass(frozen=True)
class Rectangle:
    """An axis-parallel rectangle; lengths in [m]."""

    lower: tuple[float, float]
    upper: tuple[float, float]

    @property
    def area(self) -> float:
        """The rectangle's area [m2]."""
        return (self.upper[0] - self.lower[0]) * (self.upper[1] - self.lower[1])

    def contains(self, position: Array) -> NDArray[np.bool_]:
        """Return which positions (n_points, 2) [m] lie in it, its edges among them."""
        inside = (position >= self.lower) & (position <= self.upper)
        return np.asarray(inside.all(axis=1))


def nearest(position: Array, rectangles: Iterable[Rectangle]) -> tuple[Array, Array]:
    """Return distances (n_points,) to the nearest of some rectangles, and ways there (n, 2) [m]."""
    least = np.full(len(position), np.inf)
    way = np.zeros_like(position)
    for rectangle in rectangles:
        gaps = np.clip(position, rectangle.lower, rectangle.upper) - position
        distance = np.hypot(*gaps.T)
        way[distance < least] = gaps[distance < least]
        np.minimum(least, distance, out=least)
    return least, way


def shifted(rectangle: Rectangle, shift: Sequence[float]) -> Rectangle:
    """Return a rectangle moved by a shift (2,) [m]."""
    (left, low), (right, high) = rectangle.lower, rectangle.upper
    along, up = shift
    return Rectangle((left + along, low + up), (right + along, high + up))


def overlap(edges: Array, low: float, high: float) -> Array:
    """Return the share (n_cells,) of each interval between edges that [low, high] covers."""
    length = np.minimum(edges[1:], high) - np.maximum(edges[:-1], low)
    return np.asarray(np.maximum(length, 0.0) / np.diff(edges))


def block(lower: Sequence[float], upper: Sequence[float], spacing: float) -> Block:
    """Return the edges of a rectangle, rounded to particle spacings [m]."""
    left, low, right, up = (round(edge / spacing) for edge in (*lower, *upper))
    return left, low, right, up


def covered(blocks: list[Block]) -> int:
    """Return the area that blocks cover, whether they overlap or not."""
    columns = sorted({edge for b in blocks for edge in (b[0], b[2])})
    return sum(
        (right - left) * _length([(b[1], b[3]) for b in blocks if b[0] <= left and right <= b[2]])
        for left, right in itertools.pairwise(columns)
    )


def _length(intervals: list[tuple[int, int]]) -> int:
    """Return the length that intervals cover."""
    total, reached = 0, min((low for low, _ in intervals), default=0)
    for low, high in sorted(intervals):
        total += max(0, high - max(low, reached))
        reached = max(reached, high)
    return total
