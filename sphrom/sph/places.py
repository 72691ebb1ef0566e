"""Places in a domain at which fields of a scene are evaluated and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property

import numpy as np
import shapely
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array
from sphrom.metrics.series import sharpened
from sphrom.sph.domain import SIDES, Domain

N_SAMPLES = 200
"""Intervals along a wall between places of checks."""
SAMPLES = {2: N_SAMPLES, 3: 40}
"""Intervals along each edge of a box between places of checks, by the number of its axes."""
BESIDE, N_NEAREST = 1e-6, 4 * N_SAMPLES
"""Distance of places beside a jump from it, relative to that of samples, and samples that lead to
it."""
N_PEAKS = 16
"""Samples with the largest values, from which peaks of a field are searched."""
TOUCHING = 1e-6
"""Tolerated distance of a wall from the edge of the fluid, relative to its length."""


class Places:
    """Places in the fluid of a domain, and on its walls.

    Parameters
    ----------
    solids : the solids of the domain, by name.
    particles : (n_places, 2) [m] places of particles, which `all` contains too.
    """

    def __init__(
        self, domain: Domain, solids: Mapping[str, BaseGeometry], particles: Array
    ) -> None:
        self._domain, self._solids, self.particles = domain, solids, particles
        self._ends = np.array([domain.lower, domain.upper])

    @cached_property
    def samples(self) -> Array:
        """Points (n_points, 2) of the fluid all over the box [m]."""
        # Points on the edge of the box are included, where fields like 1/x aren't finite.
        points = grid(*self._ends)
        return points[self._domain.contains(points)]

    @cached_property
    def all(self) -> Array:
        """The samples and the places of particles (n_places, 2) [m]."""
        return np.concatenate([self.samples, self.particles])

    def wrapped(self, position: Array) -> Array:
        """Return positions (2, n_positions) [m], wrapped into the box along periodic axes."""
        low, high = self._ends[..., None]
        left = ((position < low) | (position > high)).any(axis=0)
        if not left.any():
            return position
        return np.where(left, self._domain.wrap(position.T).T, position)

    @property
    def _n_samples(self) -> int:
        return SAMPLES[self._domain.n_dim]

    def lines(self, axis: int, coordinates: Array) -> Array:
        """Return lines (n_lines,) through the box at coordinates (n_lines,) [m] of an axis."""
        ends = np.tile(self._ends, (len(coordinates), 1, 1))
        ends[..., axis] = coordinates[:, None]
        return np.asarray(shapely.linestrings(ends))

    def edge(self, name: str) -> Array:
        """Return points (n_points, 2) [m] of a wall that touch the fluid, except corners.

        Raises ValueError if there are none.
        """
        if self._domain.n_dim > 2:
            axis = next(n for n, names in enumerate(SIDES) if name in names)
            points = grid(*self._ends)
            end = self._ends[SIDES[axis].index(name), axis]
            inside = np.delete(points, axis, axis=1)
            within = (inside > np.delete(self._ends[0], axis)).all(axis=1)
            within &= (inside < np.delete(self._ends[1], axis)).all(axis=1)
            return points[within & (points[:, axis] == end)]
        if name in self._solids:
            edge = self._solids[name].boundary
        else:
            axis = 0 if name in SIDES[0] else 1
            (edge,) = self.lines(axis, self._ends[[SIDES[axis].index(name)], axis])
        pieces = [
            shapely.get_coordinates(shapely.segmentize(line, edge.length / N_SAMPLES))
            for line in shapely.get_parts(edge)
        ]
        points = np.concatenate([0.5 * (piece[1:] + piece[:-1]) for piece in pieces])
        touched = np.abs(self._domain.distance_and_normal(points)[0]) < TOUCHING * edge.length
        touched &= np.all((points >= self._ends[0]) & (points <= self._ends[1]), axis=1)
        if not touched.any():
            raise ValueError(f"walls.{name}: no fluid touches it")
        return points[touched]

    @cached_property
    def scattered(self) -> Array:
        """Places (n_places, 2) [m] of the fluid, one at random in each cell of a grid."""
        # Equal distances could fit the waves of a field.
        n_dim = self._domain.n_dim
        shares = np.random.default_rng(0).random((*(self._n_samples,) * n_dim, n_dim))
        cells = np.stack(np.meshgrid(*(np.arange(self._n_samples),) * n_dim), axis=-1)
        points = self._ends[0] + np.array(self._domain.lengths) * (cells + shares) / self._n_samples
        points = points.reshape(-1, n_dim)
        return points[self._domain.contains(points)]

    def beside(self, difference: Callable[[Array], Array]) -> Array:
        """Return places (n_places, 2) [m] on both sides of lines where a difference vanishes."""

        def nearness(place: Array) -> Array:
            return -np.abs(difference(place))

        width = np.array(self._domain.lengths) / self._n_samples
        order = np.argsort(-nearness(self.samples.T), kind="stable")
        _, edge = sharpened(nearness, self.samples[order[:N_NEAREST]].T, width, self._ends)
        offsets = BESIDE * np.concatenate([np.diag(width), -np.diag(width)])
        found = np.clip(np.concatenate([edge.T + offset for offset in offsets]), *self._ends)
        return found[self._domain.contains(found)]

    def peak(self, size: Callable[[Array], Array]) -> tuple[float, Array]:
        """Return the largest value of a field in the fluid, and its place (2,) [m].

        A peak narrower than the distance between samples is found by a search from its flanks.
        """
        lengths = np.array(self._domain.lengths)

        def inside(place: Array) -> Array:
            # Walls themselves are samples; beside them a place may be in the solid by rounding.
            fluid = self._domain.wall_distance(place.T) > TOUCHING * lengths.max()
            return np.where(fluid, size(place), -np.inf)

        highest = self.all[np.argsort(-size(self.all.T), kind="stable")[:N_PEAKS]]
        found, places = sharpened(inside, highest.T, lengths / self._n_samples, self._ends)
        best = int(np.argmax(found))
        return float(found[best]), places[:, best]


def grid(lower: Array, upper: Array) -> Array:
    """Return evenly spaced points (n_points, n_dim) [m] of a box, with its edges, x fastest."""
    number = SAMPLES[len(lower)] + 1
    axes = [np.linspace(low, high, number) for low, high in zip(lower, upper, strict=True)]
    rows = np.meshgrid(*axes[::-1], indexing="ij")[::-1]
    return np.stack(rows, axis=-1).reshape(-1, len(axes))
