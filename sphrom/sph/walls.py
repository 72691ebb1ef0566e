"""Walls as fixed ghost particles that take their fields from the fluid near them (Eq. 2.15-2.16).

After Adami, Hu and Adams (J. Comput. Phys. 231, 2012). Ghosts fill the lattice beyond the fluid's
domain as deep as the kernel reaches. A ghost's pressure is the fluid's, interpolated, with the
weight of the fluid between; its velocity is twice the wall's less the fluid's, so that fluid
sticks to the wall between them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from sphrom.kernels import advection, wall_sweeps
from sphrom.kernels.cells import Grid
from sphrom.kernels.sweeps import FluidConstants, ShiftingConstants, X, gather
from sphrom.sph import state_equation
from sphrom.sph.domain import Domain
from sphrom.sph.fluid import Discretization, Fluid
from sphrom.sph.neighbourhood import MOVE_RATIO, Sources, sort_sources
from sphrom.sph.wall_distance import gap, solids

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

CLOSEST, TOUCHING, FELT = 0.25, 0.5, 1.5
"""Distances from a wall over the spacing: nothing moves closer; the first layer's; the second's."""
TINY = 1e-300
"""Guards 0/0 of a particle on a wall [m]."""
ROUNDING = 1e-9
"""Slack for what is equal but for rounding."""


@dataclass(frozen=True)
class Walls:
    """Ghost particles, fixed in space."""

    position: Array
    """(n_ghosts, 2) [m]."""
    velocity: Array
    """(n_ghosts, 2) that of the wall each belongs to [m/s]."""
    normal: Array
    """(n_ghosts, 2) 1 along the axes of the normals of the walls that a ghost is behind, else 0."""


def n_layers(discretization: Discretization) -> int:
    """Return how many layers of ghosts the kernel's support needs."""
    return math.ceil(
        discretization.support_radius / discretization.particle_spacing * (1.0 - ROUNDING)
    )


def build_walls(
    domain: Domain,
    particle_spacing: float,
    n_layers: int,
    wall_velocity: Callable[[Array], Array] | None = None,
) -> Walls:
    """Return the ghosts around a domain: lattice points within some layers of the fluid.

    Parameters
    ----------
    wall_velocity : the velocity (n_ghosts, 2) [m/s] of the walls that ghosts (n_ghosts, 2) [m]
        belong to; None for walls at rest.
    """
    axes = [_lattice_axis(domain, axis, particle_spacing, n_layers) for axis in range(2)]
    x, y = np.meshgrid(*axes)
    position = np.stack((x.ravel(), y.ravel()), axis=1)
    fluid = domain.contains(position).reshape(x.shape)
    beside, above = (_dilated(fluid, domain, axis, n_layers) for axis in range(2))
    near = _dilated(beside, domain, 1, n_layers)
    ghost = (near & ~fluid).ravel()
    # A ghost behind a corner that faces no wall belongs to both walls that meet there.
    corner = ~(beside | above)
    normal = np.stack(((beside | corner).ravel(), (above | corner).ravel()), axis=1)
    place = position[ghost]
    return Walls(
        position=place,
        velocity=np.zeros_like(place) if wall_velocity is None else wall_velocity(place),
        normal=normal[ghost].astype(np.float64),
    )


def _lattice_axis(domain: Domain, axis: int, spacing: float, n_layers: int) -> Array:
    extra = 0 if domain.periodic[axis] else n_layers
    n_points = round(domain.lengths[axis] / spacing) + 2 * extra
    points = np.arange(n_points, dtype=np.float64) + 0.5 - extra
    return domain.lower[axis] + spacing * points


def _dilated(
    mask: NDArray[np.bool_], domain: Domain, axis: int, n_layers: int
) -> NDArray[np.bool_]:
    """Return where a mask (ny, nx) holds within some layers along an axis (0 is x)."""
    mode = "wrap" if domain.periodic[axis] else "constant"
    return np.asarray(
        ndimage.maximum_filter1d(mask, 2 * n_layers + 1, axis=1 - axis, mode=mode, cval=0)
    )


class GhostParticles:
    """The ghosts beside moving fluid: their fields, and what they add to the fluid's sums.

    `sources` are the fluid's, `source` their fields, laid out as in `sphrom.kernels.sweeps`.
    """

    def __init__(
        self, walls: Walls, domain: Domain, fluid: Fluid, discretization: Discretization
    ) -> None:
        spacing = discretization.particle_spacing
        self.walls = walls
        self._domain = domain
        self._fluid = fluid
        self._discretization = discretization
        self._mass = fluid.reference_density * spacing**2
        self._position = np.ascontiguousarray(walls.position.T)
        self._normal = np.ascontiguousarray(walls.normal.T)
        self._walls_return = discretization.wall_continuity == "adjoint"
        printed = discretization.wall_continuity == "paper"
        self._counted = np.ones_like(self._normal) if printed else self._normal
        # Fluid may have left the box along a periodic axis since it was last wrapped.
        margin = discretization.support_radius + 2.0 * MOVE_RATIO * spacing
        self._near = sort_sources(self._position, domain, margin, spacing)
        self._inverse_length = 1.0 / discretization.smoothing_length
        self._solids = solids(domain)

    def place(
        self, sources: Sources, source: Array, reach: float, body_force: Array | None
    ) -> Array:
        """Return the ghosts' sources with the fields that the fluid gives them (Eq. 2.15-2.16).

        Parameters
        ----------
        body_force : (2, n_particles) [m/s2], or None.
        """
        search = (sources.grid, sources.cell_start, reach, self._inverse_length)
        means = np.empty((5, self._position.shape[1]))
        wall_sweeps.ghost_means(self._position, source, *search, means)
        fluctuation = means[0]
        if body_force is not None:
            density = self._fluid.reference_density + source[wall_sweeps.DENSITY]
            force = density * body_force[:, sources.particle]
            head = np.empty_like(fluctuation)
            wall_sweeps.ghost_heads(self._position, source, force, means[3], *search, head)
            fluctuation = fluctuation + state_equation.density_fluctuation(
                head, self._fluid.sound_speed
            )
        volume = state_equation.volume(fluctuation, self._fluid.reference_density, self._mass)
        fields = np.zeros((wall_sweeps.N_GHOST_ROWS, fluctuation.size))
        fields[:2] = self._position
        fields[wall_sweeps.DENSITY] = fluctuation
        fields[wall_sweeps.U : wall_sweeps.V + 1] = self._velocity(means[1:3])
        fields[wall_sweeps.VOLUME] = volume
        if self._walls_return:
            weights = means[3]
            returned = np.divide(
                volume * means[4], weights, np.zeros_like(weights), where=weights > 0.0
            )
            fields[wall_sweeps.RETURN] = returned
        else:
            fields[wall_sweeps.NORMAL_X : wall_sweeps.NORMAL_Y + 1] = self._counted
        return self._gathered(fields)

    def support(
        self, sources: Sources, source: Array, ghost: Array, shifting: ShiftingConstants
    ) -> Array:
        """Return the sums (4, n_particles) of the kernel's gradients over ghosts [1/m]."""
        out = np.empty((4, sources.targets.size))
        wall_sweeps.wall_support(
            sources.particle, sources.targets, source, ghost, *self._search(), shifting, out
        )
        return out

    def hold_back(self, position: Array, velocity: Array, shifting: Array, support: Array) -> None:
        """Change shifting velocities, in place, so that no particle passes through a wall.

        Shifting never pushes towards a wall that a particle touches (compare Sun et al., Comput.
        Methods Appl. Mech. Eng. 315, 2017, who let particles shift along boundaries only). And it
        takes back what the velocity itself has across the wall at particles that come closer than
        half a spacing, all of it at a quarter: velocity vanishes there but for an error, and where
        shifting carries the particles is free.

        Parameters
        ----------
        position, velocity, shifting : (2, n_particles) [m], [m/s].
        support : what `support` returned: zero where no ghost is felt.
        """
        near = np.flatnonzero(support[:2].any(axis=0))
        place = self._domain.wrap(position[:, near].T).T
        carried, shift = velocity[:, near], shifting[:, near]
        for solid in self._solids:
            way = gap(solid, place)
            distance = np.hypot(way[0], way[1]) / self._discretization.particle_spacing
            into = way / np.maximum(distance * self._discretization.particle_spacing, TINY)
            towards = np.sum(shift * into, axis=0)
            allowed = np.maximum(towards, 0.0) * _ramp(distance, TOUCHING, FELT)
            across = np.maximum(np.sum(carried * into, axis=0), 0.0)
            held = across * (1.0 - _ramp(distance, CLOSEST, TOUCHING))
            shift += (np.minimum(towards, allowed - held) - towards) * into
        shifting[:, near] = shift

    def add_rates(
        self, sources: Sources, source: Array, ghost: Array, fluid: FluidConstants, out: Array
    ) -> None:
        """Add the ghosts' part to the rates (3, n_particles) of density and velocity."""
        wall_sweeps.wall_rates(
            sources.particle,
            sources.targets,
            source,
            ghost,
            *self._search(),
            float(self._walls_return),
            fluid,
            out,
        )

    def transport(self, sources: Sources, source: Array, ghost: Array) -> Array:
        """Return the ghosts' part (3, n_particles) of the advection of Eq. 3.5-3.6."""
        out = np.empty((3, sources.targets.size))
        advection.transport(
            sources.particle,
            sources.targets,
            source,
            ghost,
            *self._search(),
            self._fluid.reference_density,
            out,
        )
        return out

    def _velocity(self, mean: Array) -> Array:
        """Return the ghosts' velocity (2, n_ghosts) from the fluid's interpolated one [m/s]."""
        wall = self.walls.velocity.T
        if self._discretization.no_slip == "whole":
            return 2.0 * wall - mean
        # As printed: walls at rest turn the tangential part round, moving ones keep their speed.
        normal = self._normal
        corner = normal.all(axis=0)
        mirrored = np.where(corner, -mean, (2.0 * normal - 1.0) * mean)
        return np.where(np.any(wall != 0.0, axis=0), wall, mirrored)

    def _gathered(self, fields: Array) -> Array:
        near = self._near
        source = np.empty((len(fields), near.particle.size))
        gather(near.particle, near.image, fields, X, source)
        return source

    def _search(self) -> tuple[Grid, Indices, float, float]:
        near = self._near
        reach = self._discretization.support_radius
        return near.grid, near.cell_start, reach, self._inverse_length


def _ramp(distance: Array, zero: float, one: float) -> Array:
    """Return 0 up to one distance, 1 from another on, and what lies between in between."""
    return np.clip((distance - zero) / (one - zero), 0.0, 1.0)
