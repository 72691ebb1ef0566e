"""Packed starting positions, by damped motion down the gradient of the summed kernel.

After Colagrossi, Bouscasse, Antuono and Marrone (Comput. Phys. Commun. 183, 2012): particles start
near a lattice, are pushed along minus the sum of the kernel's gradients, and are damped until this
sum is small; it vanishes for evenly spread particles. It vanishes on a lattice too, but a lattice
breaks up at stagnation points and emits sound waves as it does.

Beside walls the sums include ghosts, and particles keep a distance of half a spacing from walls, so
that they line up along them (compare the packing against a signed distance of Zhu et al., Comput.
Methods Appl. Mech. Eng. 383, 2021).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array
from sphrom.kernels import fields, space_sweeps, sweeps
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import Discretization
from sphrom.sph.neighbourhood import Neighbourhood
from sphrom.sph.space_neighbourhood import SpaceNeighbourhood

MAX_ITERATIONS = 2000
"""Number of iterations after which packing stops."""
STEP_RATIO = 0.5
"""Pseudo-time step over the time that a push takes to cross a smoothing length."""
DAMPING = 0.1
"""Share of the pseudo-velocity lost per step."""
NEAREST = 0.5
"""Least distance of particles from walls, relative to the spacing."""
N_PASSES = 3
"""Number of moves away from the nearest wall; in a corner the nearest wall changes between them."""


NO_SHIFTING = fields.RegularityConstants(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Packing:
    """Packed positions, and a measure of their regularity."""

    position: Array
    """(n_particles, n_dim) [m]."""
    residual: Array
    """(n_iterations + 1,) mean length of the kernel gradient's sum, times the spacing."""


def pack(
    domain: Domain,
    discretization: Discretization,
    *,
    ghosts: Array | None = None,
    seed: int = 0,
    perturbation: float = 0.5,
    tolerance: float = 1e-3,
    advance: Callable[[int], None] = lambda steps: None,
) -> Packing:
    """Pack a domain with evenly spread particles.

    Parameters
    ----------
    ghosts : (n_ghosts, 2) of the domain's walls; they do not move [m].
    perturbation : displacement of the start from a lattice, over the spacing.
    tolerance : the residual at which to stop.
    advance : called with 1 after each iteration.
    """
    spacing = discretization.particle_spacing
    random = np.random.default_rng(seed)
    start = domain.fill(spacing)
    start += perturbation * spacing * random.uniform(-1.0, 1.0, start.shape)
    others = np.empty((domain.n_dim, 0))
    if ghosts is not None:
        others = np.ascontiguousarray(ghosts.T)
    position = _off_walls(np.ascontiguousarray(domain.wrap(start).T), domain, spacing)
    push: Callable[[Array], Array]
    if domain.n_dim > 2:
        push = SpaceGradientSum(domain, discretization)
    else:
        push = KernelGradientSum(_box_around(others, domain), discretization, others)
    time_step = STEP_RATIO * discretization.smoothing_length / math.sqrt(2.0)
    velocity = np.zeros_like(position)
    gradient = push(position)
    residual = [_residual(gradient, spacing)]
    while residual[-1] > tolerance and len(residual) <= MAX_ITERATIONS:
        velocity = (1.0 - DAMPING) * velocity - 2.0 * time_step * gradient
        ahead = _off_walls(position + time_step * velocity, domain, spacing)
        if domain.has_walls:
            velocity = (ahead - position) / time_step
        position = ahead
        gradient = push(position)
        residual.append(_residual(gradient, spacing))
        advance(1)
    return Packing(position=domain.wrap(position.T), residual=np.array(residual))


def off_walls(position: Array, domain: Domain, least: float) -> Array:
    """Return positions (n_points, 2) [m], moved to at least a distance [m] from walls.

    Positions in the solid are moved into the fluid.
    """
    out = position.copy()
    for _ in range(N_PASSES):
        distance, normal = domain.distance_and_normal(out)
        missing = np.maximum(least - distance, 0.0)
        if not missing.any():
            break
        out += missing[:, None] * normal
    return out


def _off_walls(position: Array, domain: Domain, spacing: float) -> Array:
    """Return positions (2, n_points) [m] at least half a spacing from walls, if there are any."""
    if not domain.has_walls:
        return position
    return np.ascontiguousarray(off_walls(position.T, domain, NEAREST * spacing).T)


def _box_around(position: Array, domain: Domain) -> BoxDomain:
    """Return a box with the domain's periods that contains all points (2, n_points) [m]."""
    every = np.column_stack((domain.lower, domain.upper, position))
    lower = np.where(domain.periodic, domain.lower, every.min(axis=1))
    upper = np.where(domain.periodic, domain.upper, every.max(axis=1))
    left, low = lower.tolist()
    right, high = upper.tolist()
    across, along = domain.periodic
    return BoxDomain((left, low), (right, high), (across, along))


def _residual(gradient: Array, spacing: float) -> float:
    return spacing * float(np.mean(np.hypot.reduce(gradient)))


class KernelGradientSum:
    """The sum of the kernel's gradients times the volume, at each particle.

    Parameters
    ----------
    others : (2, n_others) positions of additional points in the sum, such as ghosts [m].
    """

    def __init__(
        self, domain: Domain, discretization: Discretization, others: Array | None = None
    ) -> None:
        self._others = np.empty((2, 0)) if others is None else others
        self._volume = discretization.particle_spacing**2
        self._neighbourhood = Neighbourhood(domain, discretization, n_fields=fields.N_FIELDS)
        self._constants = NO_SHIFTING

    def __call__(self, position: Array) -> Array:
        """Return the sum (2, n_particles) [1/m] at positions (2, n_particles) [m]."""
        n_particles = position.shape[1]
        position = np.concatenate((position, self._others), axis=1)
        self._neighbourhood.update(position)
        near = self._neighbourhood.sources
        source = np.zeros((fields.N_FIELDS, near.particle.size))
        sweeps.gather(near.particle, near.image, position, fields.X, source)
        source[fields.VOLUME] = self._volume
        out = np.empty((fields.N_REGULAR_ROWS, position.shape[1]))
        no_walls = np.empty((6, 0))
        neighbourhood = self._neighbourhood
        sweeps.regularity(
            neighbourhood.blocks, neighbourhood.search, source, self._constants, no_walls, out, ()
        )
        return out[fields.SUPPORT_X :, :n_particles]


class SpaceGradientSum:
    """The same sum in three dimensions, where walls reflect particles."""

    def __init__(self, domain: Domain, discretization: Discretization) -> None:
        self._volume = discretization.particle_spacing**3
        n_fields = space_sweeps.N_FIELDS
        self._neighbourhood = SpaceNeighbourhood(domain, discretization, n_fields)

    def __call__(self, position: Array) -> Array:
        """Return the sum (3, n_particles) [1/m] at positions (3, n_particles) [m]."""
        neighbourhood = self._neighbourhood
        neighbourhood.update(position)
        near = neighbourhood.near
        source = np.zeros((space_sweeps.N_FIELDS, near.particle.size))
        space_sweeps.gather_space(near.particle, near.image, near.flip, position, 0, source)
        source[space_sweeps.VOLUME] = self._volume
        out = np.empty((space_sweeps.N_REGULAR_ROWS, position.shape[1]))
        space_sweeps.space_regularity(
            neighbourhood.blocks, neighbourhood.search, source, NO_SHIFTING, out
        )
        return out[space_sweeps.SUPPORT :]
