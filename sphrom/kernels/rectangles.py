"""Distances from walls along the axes: solids are rectangles. Other walls are in `segments.py`."""

from __future__ import annotations

import math

from numba import prange

from sphrom.arrays import Array, Indices
from sphrom.kernels.jit import parallel, term
from sphrom.kernels.sweeps import U, V, X, Y


@term
def _gap(x: float, y: float, solid: Array) -> tuple[float, float]:
    """Return the way from a point to a rectangle [m]."""
    return min(max(x, solid[0]), solid[2]) - x, min(max(y, solid[1]), solid[3]) - y


@parallel
def wall_distances(targets: Indices, target: Array, solids: Array, out: Array) -> None:
    """Compute how far particles are from solid.

    Parameters
    ----------
    targets, target : the fluid's sources, and which of them to look at.
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
    """Return 0 up to one distance, 1 from another on, and what lies between in between."""
    return min(max((distance - zero) / (one - zero), 0.0), 1.0)


@term
def shifting_change(
    towards: float, wanted: float, across: float, distance: float, closest: float, touching: float,
    felt: float,
) -> float:
    """Return what a wall changes of a shifting velocity towards it.

    `wanted` is what the velocity was before any wall changed it, `across` the fluid's velocity.
    """
    allowed = max(wanted, 0.0) * _ramp(distance, touching, felt)
    held = max(across, 0.0) * (1.0 - _ramp(distance, closest, touching))
    return min(towards, allowed - held) - towards


@parallel
def hold_back(
    particle: Indices, targets: Indices, target: Array, solids: Array, closest: float,
    touching: float, felt: float, against: float, shifting: Array,
) -> None:
    """Change shifting velocities so that no particle passes through a wall.

    Shifting never pushes towards a wall that a particle touches (compare Sun et al., Comput.
    Methods Appl. Mech. Eng. 315, 2017, who let particles shift along boundaries only). And it takes
    back what the velocity itself has across the wall at particles that come closer: velocity
    vanishes there but for an error, and where shifting carries the particles is free.

    Parameters
    ----------
    targets, target : the fluid's sources, and which of them to look at.
    closest, touching, felt : distances from a wall [m] at which nothing moves closer, at which
        shifting stops pushing and begins to hold back, and beyond which it is left alone.
    against : how much of the velocity across a wall is taken back: 1 all of it, 0 none.
    shifting : (>= 2, n_particles) rows: shifting velocity x, y [m/s].
    """
    for t in prange(targets.size):
        j = targets[t]
        i = particle[j]
        for k in range(solids.shape[0]):
            wx, wy = _gap(target[X, j], target[Y, j], solids[k])
            distance = math.sqrt(wx * wx + wy * wy)
            if distance < felt and distance > 0.0:
                wx /= distance
                wy /= distance
                towards = shifting[0, i] * wx + shifting[1, i] * wy
                across = target[U, j] * wx + target[V, j] * wy
                change = shifting_change(
                    towards, towards, against * across, distance, closest, touching, felt
                )
                shifting[0, i] += change * wx
                shifting[1, i] += change * wy
