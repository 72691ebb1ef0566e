"""Neighbour search in three dimensions, with images of particles beyond plane walls."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array, Indices, Mask
from sphrom.kernels.blocks import BLOCK_COLUMNS, Blocks
from sphrom.kernels.space_lists import (
    SpaceGrid,
    SpaceSearch,
    longest_space_list,
    sort_by_space_cell,
)
from sphrom.sph.domain import Domain
from sphrom.sph.neighbourhood import SLACK, Neighbourhood

CELL_RATIO = (0.5, 2.0, 2.0)
"""Edges of a cell over the particle spacing; these are the fastest of several tried."""


@dataclass(frozen=True)
class SpaceSources:
    """Particles and their images, sorted by cell."""

    particle: Indices
    """(n_sources,) the particle of each source; several sources may be its images."""
    flip: Array
    """(3, n_sources) -1 along axes at whose walls a source is reflected, else 1."""
    image: Array
    """(3, n_sources) a source is at flip * x + image [m]."""
    ghost: Indices
    """The sources beyond walls."""


def _images(position: Array, domain: Domain, margin: float) -> tuple[Indices, Array, Array]:
    """Return `particle`, `flip` and `image` of particles and images within a margin [m] of the box.

    The first sources are the particles themselves, moved into the box. A box shorter than the
    margin has further images of images.
    """
    particle = np.arange(position.shape[1])
    flip = np.ones_like(position)
    image = domain.wrap(position.T).T - position
    for axis, length in enumerate(domain.lengths):
        low, high = domain.lower[axis], domain.upper[axis]
        place = flip[axis] * position[axis, particle] + image[axis]
        particles, flips, images = [particle], [flip], [image]
        copies = int(np.ceil(margin / length))
        for copy in (c for c in range(-copies, copies + 1) if c != 0):
            turned = not domain.periodic[axis] and copy % 2 == 1
            # An odd number of reflections turns an axis about the middle of the box.
            moved = (low + high - place if turned else place) + copy * length
            near = np.flatnonzero((moved >= low - margin) & (moved < high + margin))
            flipped = flip[:, near]
            shifted = image[:, near]
            if turned:
                flipped[axis] *= -1.0
                shifted[axis] = low + high - shifted[axis]
            shifted[axis] += copy * length
            particles.append(particle[near])
            flips.append(flipped)
            images.append(shifted)
        particle = np.concatenate(particles)
        flip = np.concatenate(flips, axis=1)
        image = np.concatenate(images, axis=1)
    return particle, flip, image


class SpaceNeighbourhood(Neighbourhood):
    """The sources of a set of moving particles in three dimensions, and the search radius.

    Attributes
    ----------
    near : the sorted sources.
    n_candidates : pairs of targets and their candidates when the list was built.
    """

    near: SpaceSources
    n_candidates: int

    @property
    def search(self) -> SpaceSearch:  # type: ignore[override]
        return self._search._replace(reach=self.reach)

    @property
    def blocks(self) -> Blocks:
        return Blocks(self.near.particle, self._targets, self.block_start, self.scratch)

    def _build(self, position: Array, margin: float) -> None:
        particle, flip, image = _images(position, self._domain, margin)
        place = flip * position[:, particle] + image
        cell = np.multiply(CELL_RATIO, self._spacing)
        origin = place.min(axis=1)
        index = ((place - origin[:, None]) / cell[:, None]).astype(np.int64)
        shape = index.max(axis=1) + 1
        order, cell_start = sort_by_space_cell(place, SpaceGrid(origin, cell, shape))
        flip = np.ascontiguousarray(flip[:, order])
        walled = np.flatnonzero(~np.array(self._domain.periodic))
        low = np.array(self._domain.lower)[walled, None]
        high = np.array(self._domain.upper)[walled, None]
        # Particles themselves may be on a wall.
        beyond: Mask = np.any((place[walled] < low) | (place[walled] > high), axis=0)
        beyond[: position.shape[1]] = False
        self.near = SpaceSources(
            particle[order],
            flip,
            np.ascontiguousarray(image[:, order]),
            np.flatnonzero(beyond[order]),
        )
        self._search = SpaceSearch(
            origin,
            cell,
            shape,
            cell_start,
            self._support_radius,
            1.0 / self._smoothing_length,
        )
        targets = np.flatnonzero(order < position.shape[1])
        self._targets = targets
        index[0] //= BLOCK_COLUMNS
        changes = np.diff(index[:, order[targets]], prepend=-1).any(axis=0)
        first = np.flatnonzero(changes)
        self.block_start = np.append(first, targets.size)
        # Targets may move by the limit, and the reach then grows by as much.
        limit = SLACK * self._move_limit
        farthest = self._search._replace(reach=self._support_radius + 2.0 * limit)
        place = np.ascontiguousarray(place[:, order])
        length, self.n_candidates = longest_space_list(
            place, self._targets, self.block_start, farthest
        )
        self._lengthen(length)
