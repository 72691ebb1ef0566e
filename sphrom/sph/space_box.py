"""A three-dimensional box that fluid fills, with plane walls at the ends of some of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from shapely.geometry.base import BaseGeometry

from sphrom.arrays import Array, Indices, Mask
from sphrom.sph.box_domain import MOST_UNEVEN
from sphrom.sph.domain import SIDES, Domain, Walls, WallSearch

NO_PLANE = "a three-dimensional box has no region in a plane"


@dataclass(frozen=True)
class SpaceBox(Domain):
    """An axis-parallel box without solids; lengths in [m]."""

    lower: tuple[float, ...]
    upper: tuple[float, ...]
    periodic: tuple[bool, ...]

    @property
    def volume(self) -> float:
        """The volume of the fluid [m3]."""
        return math.prod(self.lengths)

    @property
    def fluid(self) -> BaseGeometry:
        raise NotImplementedError(NO_PLANE)

    @property
    def fluid_with_images(self) -> BaseGeometry:
        raise NotImplementedError(NO_PLANE)

    @property
    def separate_areas(self) -> list[float]:
        return [self.volume]

    @property
    def solid_names(self) -> tuple[str, ...]:
        return ()

    def contains(self, position: Array) -> Mask:
        wrapped = self.wrap(position)
        return np.all((wrapped >= self.lower) & (wrapped <= self.upper), axis=1)

    def distance_and_normal(self, position: Array) -> tuple[Array, Array]:
        wrapped = self.wrap(position)
        distance = np.full(len(wrapped), np.inf)
        normal = np.zeros_like(wrapped)
        for axis in np.flatnonzero(~np.array(self.periodic)):
            for way, wall in ((1.0, self.lower[axis]), (-1.0, self.upper[axis])):
                inwards = way * (wrapped[:, axis] - wall)
                nearer = inwards < distance
                distance[nearer] = inwards[nearer]
                normal[nearer] = 0.0
                normal[nearer, axis] = way
        return distance, normal

    def nearest_wall(self, position: Array) -> Indices:
        _, normal = self.distance_and_normal(position)
        wall = np.zeros(len(position), dtype=np.int64)
        for axis in np.flatnonzero(~np.array(self.periodic)):
            low, high = (self.wall_names.index(name) for name in SIDES[axis])
            wall[normal[:, axis] > 0.0] = low
            wall[normal[:, axis] < 0.0] = high
        return wall

    def sections(self, x: float) -> list[tuple[float, float]]:
        return [(self.lower[1], self.upper[1])] if self.lower[0] <= x <= self.upper[0] else []

    def fits_lattice(self, particle_spacing: float) -> bool:
        pitches = self.pitches(particle_spacing)
        return float(np.ptp(pitches)) <= MOST_UNEVEN * particle_spacing

    def lattice_spacing(self, particle_spacing: float) -> float:
        return float((self.volume / self.n_particles(particle_spacing)) ** (1.0 / 3.0))

    def pitches(self, particle_spacing: float) -> tuple[float, ...]:  # type: ignore[override]
        counts = self.counts(particle_spacing)
        return tuple(n / count for n, count in zip(self.lengths, counts, strict=True))

    def wall_search(self, particle_spacing: float) -> WallSearch:
        raise NotImplementedError("walls of a three-dimensional box reflect particles")

    def counts(self, particle_spacing: float) -> tuple[int, ...]:
        """Return the number of particles along each axis."""
        return tuple(max(1, round(length / particle_spacing)) for length in self.lengths)

    def fill(self, particle_spacing: float) -> Array:
        return self._lattice(particle_spacing, 0)

    def n_particles(self, particle_spacing: float) -> int:
        return math.prod(self.counts(particle_spacing))

    def ghosts(self, particle_spacing: float, n_layers: int) -> Walls:
        position = self._lattice(particle_spacing, n_layers)
        place = position[~self.contains(position)]
        normal = (place < self.lower) | (place > self.upper)
        wall = self.nearest_wall(place)
        return Walls(place, np.zeros_like(place), wall, normal.astype(np.float64))

    def n_ghosts(self, particle_spacing: float, n_layers: int) -> int:
        """Return zero: walls reflect particles, and ghosts only give velocities of walls."""
        return 0

    def _lattice(self, particle_spacing: float, n_layers: int) -> Array:
        """Return cell centres (n_points, 3), x fastest, then y, with some layers beyond walls."""
        axes = []
        for axis, count in enumerate(self.counts(particle_spacing)):
            extra = 0 if self.periodic[axis] else n_layers
            pitch = self.lengths[axis] / count
            axes.append(self.lower[axis] + pitch * (np.arange(-extra, count + extra) + 0.5))
        layers, rows, columns = np.meshgrid(*axes[::-1], indexing="ij")
        return np.stack((columns.ravel(), rows.ravel(), layers.ravel()), axis=1)
