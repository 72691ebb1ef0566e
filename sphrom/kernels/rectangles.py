"""Distances from walls parallel to the axes, as rectangles. See `segments.py` for other walls."""

from __future__ import annotations

import math
from typing import NamedTuple

from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.fields import BesideWalls, U, V, X, Y
from sphrom.kernels.jit import parallel, term


@term
def _gap(x: float, y: float, solid: Array) -> tuple[float, float]:
    """Return the vector from a point to a rectangle [m]."""
    return min(max(x, solid[0]), solid[2]) - x, min(max(y, solid[1]), solid[3]) - y


@parallel
def wall_distances(targets: Indices, target: Array, solids: Array, out: Array) -> None:
    """Compute the distances of particles from solids.

    Parameters
    ----------
    targets, target : the particles among the fluid's sources, and the sources.
    solids : (n_solids, 4) lower and upper corners of rectangles, x before y [m].
    out : (n_targets,) [m].
    """
    for t in prange(targets.size):
        j = targets[t]
        nearest = math.inf
        for k in range(solids.shape[0]):
            wx, wy = _gap(target[X, j], target[Y, j], solids[k])
            nearest = min(nearest, wx * wx + wy * wy)
        out[t] = math.sqrt(nearest)


@term
def _ramp(distance: float, zero: float, one: float) -> float:
    """Return 0 up to one distance, 1 from another one on, and linear values in between."""
    return min(max((distance - zero) / (one - zero), 0.0), 1.0)


class Limits(NamedTuple):
    """Distances from a wall at which shifting is limited [m]."""

    closest: float
    """The least allowed."""
    touching: float
    """Distance at which shifting stops pushing and starts to compensate."""
    felt: float
    """Distance beyond which shifting is not changed."""
    against: float
    """Share of the velocity across a wall that is compensated, 0 to 1."""


@term
def shifting_change(
    towards: float, wanted: float, across: float, distance: float, limits: Limits
) -> float:
    """Return the change that a wall makes to a shifting velocity towards it.

    `wanted` is the velocity before any wall changed it, `across` that of the fluid.
    """
    allowed = max(wanted, 0.0) * _ramp(distance, limits.touching, limits.felt)
    held = max(across, 0.0) * (1.0 - _ramp(distance, limits.closest, limits.touching))
    return min(towards, allowed - held) - towards


@parallel
def hold_back(beside: BesideWalls, solids: Array, limits: Limits, shifting: Array) -> None:
    """Change shifting velocities so that no particle passes through a wall.

    Shifting never pushes towards a wall that a particle touches (compare Sun et al., Comput.
    Methods Appl. Mech. Eng. 315, 2017, who let particles shift only along boundaries). For closer
    particles, it also compensates for the fluid's velocity across the wall. Apart from errors this
    velocity is zero there, and shifting may be chosen freely.

    Parameters
    ----------
    shifting : (>= 2, n_particles) rows: shifting velocity x, y [m/s].
    """
    target = beside.source
    for t in prange(beside.targets.size):
        j = beside.targets[t]
        i = beside.particle[j]
        for k in range(solids.shape[0]):
            wx, wy = _gap(target[X, j], target[Y, j], solids[k])
            distance = math.sqrt(wx * wx + wy * wy)
            if distance < limits.felt and distance > 0.0:
                wx /= distance
                wy /= distance
                towards = shifting[0, i] * wx + shifting[1, i] * wy
                across = target[U, j] * wx + target[V, j] * wy
                against = limits.against * across
                change = shifting_change(towards, towards, against, distance, limits)
                shifting[0, i] += change * wx
                shifting[1, i] += change * wy
