"""A lattice over a box whose points fill a domain of any shape as evenly as they can.

Its pitch fits the periods, and its cells are as large as particles. It is shifted so that as many
points lie in the fluid as particles have its area: then both sides of a wall have their share.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from sphrom.sph.domain import Domain

Array = NDArray[np.float64]

N_SHIFTS = 64
"""Shifts that are tried."""
SHIFT = np.array((0.7548776662466927, 0.5698402909980532))
"""From one shift to the next, over the pitch: multiples of it fill a square evenly."""


def pitches(domain: Domain, particle_spacing: float) -> tuple[float, float]:
    """Return the distances of points along x and y [m], whose product is the spacing's square.

    Along periodic axes they divide the period; where both axes are periodic, the product is off by
    what is left.
    """
    counts = [
        [length / n for n in _numbers_near(length / particle_spacing)] if periodic else [None]
        for length, periodic in zip(domain.lengths, domain.periodic, strict=True)
    ]
    square = particle_spacing**2

    def completed(x: float | None, y: float | None) -> tuple[float, float]:
        x = (particle_spacing if y is None else square / y) if x is None else x
        return x, square / x if y is None else y

    found = [completed(x, y) for x, y in itertools.product(*counts)]
    return min(found, key=lambda p: abs(p[0] * p[1] / square - 1.0) + (p[0] / p[1] - 1.0) ** 2)


def _numbers_near(ratio: float) -> Sequence[int]:
    """Return numbers of points that a period may have, the nearest one first."""
    nearest = max(1, round(ratio))
    return [n for n in (nearest, nearest - 1, nearest + 1) if n > 0]


def fitted_lattice(
    domain: Domain, particle_spacing: float, n_particles: int
) -> tuple[Array, Array]:
    """Return points (n_points, 2) [m], and their signed distances from walls (n_points,) [m].

    They cover the box. The first shift is taken of
    which exactly so many points lie in the fluid, else the one that comes nearest.
    """
    tried = _shifts(domain, particle_spacing, n_particles)
    shift, _ = min(tried, key=lambda one: one[1])
    points = _shifted(domain, particle_spacing, shift)
    return points, domain.distance_and_normal(points)[0]


def _shifts(
    domain: Domain, particle_spacing: float, n_particles: int
) -> Iterator[tuple[Array, int]]:
    """Yield shifts (2,), over the pitch, and by how many points they miss; none after a hit."""
    for turn in range(N_SHIFTS):
        shift = np.mod(0.5 + turn * SHIFT, 1.0)
        distance = domain.distance_and_normal(_shifted(domain, particle_spacing, shift))[0]
        missed = abs(int(np.count_nonzero(distance > 0.0)) - n_particles)
        yield shift, missed
        if missed == 0:
            return


def _shifted(domain: Domain, particle_spacing: float, shift: Array) -> Array:
    axes = []
    for axis, pitch in enumerate(pitches(domain, particle_spacing)):
        number = domain.lengths[axis] / pitch
        last = round(number) if domain.periodic[axis] else math.ceil(number - shift[axis])
        axes.append(domain.lower[axis] + (np.arange(last) + shift[axis]) * pitch)
    x, y = np.meshgrid(*axes)
    return np.stack((x.ravel(), y.ravel()), axis=1)
