"""How a scene's geometry and its particles fit together: lattices, ghosts, supports."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

from sphrom.case.models import Case
from sphrom.sph.domain import Domain

WHOLE_TOLERANCE = 1e-6
"""How far a wall may be from the lattice, over the particle spacing."""
Box = tuple[int, int, int, int]
"""Left, lower, right and upper edges, in particle spacings."""


def n_particles(case: Case) -> int:
    """Return the number of particles that the scene is filled with."""
    return sum((right - left) * (upper - lower) for left, lower, right, upper in _fluid(case))


def n_ghosts(case: Case) -> int:
    """Return the number of ghost particles of the scene's walls."""
    domain = case.scene.domain
    if not domain.has_walls:
        return 0
    layers = case.n_wall_layers
    across, up = (0 if periodic else layers for periodic in domain.periodic)
    ends = _box(case, domain.lower, domain.upper)
    grown = [
        (
            max(left - layers, ends[0] - across),
            max(lower - layers, ends[1] - up),
            min(right + layers, ends[2] + across),
            min(upper + layers, ends[3] + up),
        )
        for left, lower, right, upper in _fluid(case)
    ]
    return _covered(grown) - n_particles(case)


def narrowest(case: Case) -> float:
    """Return the least width of the fluid between walls, or of a periodic box [m]."""
    domain = case.scene.domain
    widths = [part.upper[axis] - part.lower[axis] for part in domain.parts for axis in range(2)]
    return min(widths)


def fits(domain: Domain, resolution: float, length: float) -> bool:
    """Whether all walls lie between the points of a lattice with so many points along a length."""
    places = [edge / length * resolution for edge in _edges(domain)]
    return all(abs(place - round(place)) < WHOLE_TOLERANCE for place in places)


def nearest_fitting_resolution(case: Case) -> int | None:
    """Return the resolution nearest to the case's at which walls fit the lattice, if one is near.

    It is at most half as coarse, or twice as fine.
    """
    domain, length = case.scene.domain, case.scene.resolved_length
    resolution = case.discretization.resolution
    for distance in range(resolution // 2):
        for candidate in (resolution + distance, resolution - distance):
            if fits(domain, candidate, length):
                return candidate
    return None


def _edges(domain: Domain) -> Iterable[float]:
    corners = [corner for part in domain.parts for corner in (part.lower, part.upper)]
    return (c[axis] - domain.lower[axis] for c in corners for axis in range(2))


def _fluid(case: Case) -> list[Box]:
    return [_box(case, part.lower, part.upper) for part in case.scene.domain.parts]


def _box(case: Case, lower: tuple[float, float], upper: tuple[float, float]) -> Box:
    left, low, right, up = (round(edge / case.particle_spacing) for edge in (*lower, *upper))
    return left, low, right, up


def _covered(boxes: list[Box]) -> int:
    """Return the area that boxes cover, whether they overlap or not."""
    columns = sorted({edge for box in boxes for edge in (box[0], box[2])})
    return sum(
        (right - left) * _length([(b[1], b[3]) for b in boxes if b[0] <= left and right <= b[2]])
        for left, right in pairwise(columns)
    )


def _length(intervals: list[tuple[int, int]]) -> int:
    """Return the length that intervals cover."""
    total, reached = 0, min((low for low, _ in intervals), default=0)
    for low, high in sorted(intervals):
        total += max(0, high - max(low, reached))
        reached = max(reached, high)
    return total
