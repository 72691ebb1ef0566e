"""Neighbour search: a cell-linked list that is kept until particles have moved too far.

Sources are the particles and their periodic images, sorted by cell. The list is rebuilt when some
particle has moved by more than a fraction of the spacing. Until then the search radius is increased
by the largest displacement, so that no pair is missed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike

from sphrom.arrays import Array, Indices
from sphrom.errors import UnstableError
from sphrom.kernels.blocks import N_CHUNKS, Blocks, longest_list, split_targets
from sphrom.kernels.cells import Grid, Search, sort_by_cell
from sphrom.sph.domain import Domain, first_of
from sphrom.sph.fluid import Discretization

CELL_SIZE_RATIO = (0.5, 4.0)
"""Cell width and height over the particle spacing; these are the fastest of several tried."""
MOVE_RATIO = 0.3
"""Displacement of a particle, relative to the spacing, after which the list is rebuilt."""
SLACK = 1.01
"""Safety factor on displacements for the length of candidate lists, against rounding."""


@dataclass(frozen=True)
class Sources:
    """Particles and their periodic images, sorted by cell."""

    particle: Indices
    """(n_sources,) the particle of each source; several sources may be its images."""
    image: Array
    """(2, n_sources) translation from the particle to the source [m]."""
    place: Array
    """(2, n_sources) positions when sorted [m]."""
    targets: Indices
    """(n_particles,) the sources that are the particles themselves, in sorted order."""
    grid: Grid
    cell_start: Indices

    def search(self, reach: float, smoothing_length: float) -> Search:
        """Return the cells with a search radius [m]."""
        return Search(*self.grid, self.cell_start, reach, 1.0 / smoothing_length)


def sort_sources(
    position: Array, domain: Domain, margin: float, particle_spacing: float
) -> Sources:
    """Sort particles at (2, n_particles) [m], and their images within a margin [m] of the box."""
    particle, image = periodic_images(position, domain, margin)
    place = position[:, particle] + image
    width, height = (ratio * particle_spacing for ratio in CELL_SIZE_RATIO)
    origin = place.min(axis=1)
    columns, rows = ((place.max(axis=1) - origin) / (width, height)).astype(int).tolist()
    grid = Grid(float(origin[0]), float(origin[1]), width, height, columns + 1, rows + 1)
    order, cell_start = sort_by_cell(place[0], place[1], grid)
    return Sources(
        particle=particle[order],
        image=np.ascontiguousarray(image[:, order]),
        place=np.ascontiguousarray(place[:, order]),
        targets=np.flatnonzero(order < position.shape[1]),
        grid=grid,
        cell_start=cell_start,
    )


class Neighbourhood:
    """The sources of a set of moving particles, and the search radius.

    Attributes
    ----------
    sources : the sorted sources.
    block_start : (n_blocks + 1,) the first target of each block.
    reach : search radius [m].
    built_at : (2, n_particles) positions at which the list was built [m]; None after a reset.
    scratch : memory for the candidate lists of the blocks, by thread.
    """

    sources: Sources
    block_start: Indices
    reach: float

    def __init__(
        self,
        domain: Domain,
        discretization: Discretization,
        n_fields: int,
        precision: DTypeLike = np.float64,
    ) -> None:
        self._domain = domain
        self._spacing = discretization.particle_spacing
        self._support_radius = discretization.support_radius
        self._smoothing_length = discretization.smoothing_length
        self._move_limit = MOVE_RATIO * self._spacing
        self.built_at: Array | None = None
        self.scratch = np.empty((N_CHUNKS, n_fields, 0), precision)

    @property
    def search(self) -> Search:
        """The cells of the sources with the present search radius."""
        return self.sources.search(self.reach, self._smoothing_length)

    @property
    def blocks(self) -> Blocks:
        """The particles in blocks with common lists of candidates."""
        near = self.sources
        return Blocks(near.particle, near.targets, self.block_start, self.scratch)

    def rebuild_at(self, position: Array | None) -> None:
        """Build the list for positions (2, n_particles) [m]; None resets it.

        Sums over neighbours are in the order of the list, so a run that continues from a state must
        continue with the same list.
        """
        self.built_at = None
        if position is not None:
            self.update(position)

    def update(self, position: Array) -> None:
        """Update the list for positions (2, n_particles) [m].

        Raises UnstableError if a position is not finite, or so far beyond all walls that the list
        does not cover it.
        """
        if self.built_at is not None and self.built_at.shape == position.shape:
            offset = position - self.built_at
            moved = math.sqrt(float(np.max(sum(part**2 for part in offset))))
            if moved <= self._move_limit:
                self.reach = self._support_radius + moved
                return
        # A particle and its neighbour may each move by the limit before the next build.
        margin = self._support_radius + 2.0 * self._move_limit
        _require_near(position, self._domain, margin)
        self._build(position, margin)
        self.reach = self._support_radius
        self.built_at = position.copy()

    def _build(self, position: Array, margin: float) -> None:
        """Build the list, with images within a margin [m] of the box."""
        self.sources = sort_sources(position, self._domain, margin, self._spacing)
        # Targets are divided into blocks, whose candidate lists need memory.
        near = self.sources
        limit = SLACK * self._move_limit
        self.block_start = split_targets(near.targets, near.grid, near.cell_start)
        farthest = near.search(self._support_radius + limit, self._smoothing_length)
        self._lengthen(longest_list(near.place, near.targets, self.block_start, farthest, limit))

    def _lengthen(self, length: int) -> None:
        """Keep memory for lists of a length."""
        if length > self.scratch.shape[2]:
            shape = (*self.scratch.shape[:2], length)
            self.scratch = np.empty(shape, self.scratch.dtype)


def _require_near(position: Array, domain: Domain, margin: float) -> None:
    """Refuse particles that are lost, or farther beyond walls than images extend.

    The cells would not cover them.
    """
    bad = ~np.isfinite(position).all(0)
    for axis in (axis for axis in range(domain.n_dim) if not domain.periodic[axis]):
        low, high = domain.lower[axis] - margin, domain.upper[axis] + margin
        bad |= (position[axis] < low) | (position[axis] > high)
    if bad.any():
        where = first_of(np.flatnonzero(bad), position)
        raise UnstableError(f"{where} is beyond the reach of the neighbour list")


def periodic_images(position: Array, domain: Domain, margin: float) -> tuple[Indices, Array]:
    """Return the particle (n_sources,) and the translation (n_dim, n_sources) [m] of each source.

    The first sources are the particles themselves, moved into the box; then follow their images
    within the margin [m] around it.
    """
    particle = np.arange(position.shape[1])
    image = domain.wrap(position.T).T - position
    for axis in range(len(position)):
        if not domain.periodic[axis]:
            continue
        length = domain.lengths[axis]
        place = position[axis, particle] + image[axis]
        particles, images = [particle], [image]
        copies = math.ceil(margin / length)
        for copy in (c for c in range(-copies, copies + 1) if c != 0):
            moved = place + copy * length
            near = np.flatnonzero(
                (moved >= domain.lower[axis] - margin) & (moved < domain.upper[axis] + margin)
            )
            step = np.zeros((len(position), near.size))
            step[axis] = copy * length
            particles.append(particle[near])
            images.append(image[:, near] + step)
        particle = np.concatenate(particles)
        image = np.concatenate(images, axis=1)
    return particle, image
