"""The delta-plus-SPH functional f (Eq. 2.6-2.14) in three dimensions with plane walls.

The full state is an array (7, n_particles) with rows x, y, z [m], density fluctuation [kg/m3] and
u, v, w [m/s]. Beyond a wall the fluid is continued by the images of its particles, reflected at the
wall, which are exact for plane walls and need no fit:

- an image has the density of its particle, and the head rho_0 (x_g - x_i) . b of a body force b;
- in the continuity equation it has the reflected velocity, so that walls return the flux into them;
- in the momentum equation it has 2 U - u, so that the velocity at the wall is the wall's, U. Beyond
  two walls, at an edge, it has u: as for an odd function of both distances, friction is then not
  stiffer than without walls.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sphrom.arrays import Array
from sphrom.kernels import space_sweeps as sweeps
from sphrom.kernels.fields import FluidConstants, RegularityConstants
from sphrom.kernels.wendland import kernel
from sphrom.sph.domain import SIDES
from sphrom.sph.functional import Functional, Rates
from sphrom.sph.space_neighbourhood import SpaceNeighbourhood

N_DIM = 3


def at_rest(position: Array) -> Array:
    """Return the velocity (n_points, 3) [m/s] of walls at rest."""
    return np.zeros_like(position)


@dataclass(eq=False)
class SpaceFunctional(Functional):
    """Eq. 2.6-2.8 for one fluid in three dimensions."""

    neighbourhood: SpaceNeighbourhood = field(init=False)
    wall_velocity: Callable[[Array], Array] = at_rest
    """The velocity (n_points, 3) [m/s] of the walls of points (n_points, 3) [m] beyond them."""
    speed_at: Callable[[Array], Callable[[float], float | Array] | None] = lambda position: None
    """The factor of this velocity at times, for points beyond walls, or None if it is one."""

    def __post_init__(self) -> None:
        fluid = self.fluid
        discretization = self.discretization
        spacing = discretization.particle_spacing
        length = discretization.smoothing_length
        self.ghosts = None
        self.mass = fluid.reference_density * spacing**N_DIM
        damping = discretization.acoustic_damping * length / fluid.sound_speed
        self._regularity_constants = RegularityConstants(
            magnitude=2.0 * length * fluid.max_speed if discretization.shifting else 0.0,
            amplitude=discretization.shifting_amplitude,
            inverse_kernel=1.0 / kernel(spacing, 1.0 / length, N_DIM),
            as_printed=0.0,
            limit=0.5 * fluid.max_speed,
            damping=damping * fluid.reference_density,
            walls_return=1.0,
        )
        self._fluid_constants = FluidConstants(
            reference_density=fluid.reference_density,
            sound_speed=fluid.sound_speed,
            pair_viscosity=0.0,
            laplacian_viscosity=fluid.kinematic_viscosity,
            diffusion=2.0 * discretization.diffusion_coefficient * length * fluid.sound_speed,
            advective=1.0,
        )
        self.neighbourhood = SpaceNeighbourhood(self.domain, discretization, sweeps.N_FIELDS)
        self._source = np.empty((sweeps.N_FIELDS, 0))

    def evaluate(
        self,
        position: Array,
        density_fluctuation: Array,
        velocity: Array,
        time: float = 0.0,
        along: Array | None = None,
    ) -> Rates:
        assert along is None
        force = None if self.body_force is None else self.body_force(position, time)
        regular = self._prepare(position, density_fluctuation, velocity, time, force)
        out = np.empty((N_DIM + 1, density_fluctuation.size))
        self._rates(regular, self._fluid_constants, out)
        if force is not None:
            out[1:] += force
        if self.discretization.fixed_volume:
            self._fix_volume(density_fluctuation, out[0])
        shifting = regular[sweeps.OWN_SHIFT : sweeps.OWN_SHIFT + N_DIM]
        return Rates(out[0], out[1:], shifting)

    def _rates(self, regular: Array, constants: FluidConstants, out: Array) -> None:
        near = self.neighbourhood
        sweeps.space_rates(near.blocks, near.search, self._source, regular, constants, out)

    def _prepare(
        self,
        position: Array,
        density_fluctuation: Array,
        velocity: Array,
        time: float,
        force: Array | None,
    ) -> Array:
        """Run the first sweep, fill the sources for the second one, and return the result."""
        self.neighbourhood.update(position)
        near = self.neighbourhood.near
        ghost = near.ghost
        shape = (sweeps.N_FIELDS, near.particle.size)
        if self._source.shape != shape:
            self._source = np.empty(shape)
        source = self._source
        volume = self.volume(density_fluctuation)
        self._gather(np.vstack((position, density_fluctuation, velocity, volume)), 0)
        flip = near.flip[:, ghost]
        particle = near.particle[ghost]
        steepness = np.zeros((N_DIM, ghost.size))
        if force is not None:
            scale = self.fluid.reference_density / self.fluid.sound_speed**2
            steepness = scale * force[:, particle]
        way = (source[:N_DIM, ghost] - self.domain.wrap(position.T).T[:, particle]) * (flip < 0.0)
        heads = np.sum(way * steepness, axis=0)
        source[sweeps.VELOCITY : sweeps.VOLUME, ghost] *= flip
        source[sweeps.DENSITY, ghost] += heads
        regular = np.empty((sweeps.N_REGULAR_ROWS, position.shape[1]))
        neighbourhood = self.neighbourhood
        constants = self._regularity_constants
        sweeps.space_regularity(
            neighbourhood.blocks, neighbourhood.search, source, constants, regular
        )
        self._hold_back(position, velocity, regular[sweeps.OWN_SHIFT : sweeps.DIVERGENCE])
        self._gather(regular[: sweeps.OWN_SHIFT], sweeps.PRESSURE)
        if ghost.size:
            source[sweeps.PRESSURE, ghost] += heads
            gradient = source[sweeps.GRADIENT :, ghost]
            source[sweeps.GRADIENT :, ghost] = flip * (gradient - steepness) + steepness
            place = source[:N_DIM, ghost].T
            moving = self.wall_velocity(place).T
            if (speed := self.speed_at(place)) is not None:
                moving = moving * speed(time)
            # Beyond two walls, at an edge, the fluid is turned back twice.
            way = np.prod(flip, axis=0)
            source[sweeps.VELOCITY : sweeps.VOLUME, ghost] = (1.0 - way) * moving + way * velocity[
                :, particle
            ]
        return regular

    def _hold_back(self, position: Array, velocity: Array, shifting: Array) -> None:
        """Limit velocities with which particles near walls approach them, by the shifting.

        An image of a particle repels it less the nearer it is. A particle's speed towards a wall is
        therefore at most the largest expected speed times its distance over the spacing; fields
        are transported with the particles.
        """
        rate = self.fluid.max_speed / self.discretization.particle_spacing
        for axis in np.flatnonzero(~np.array(self.domain.periodic)):
            for way, wall in ((1.0, self.domain.lower[axis]), (-1.0, self.domain.upper[axis])):
                distance = way * (position[axis] - wall)
                approach = -way * (velocity[axis] + shifting[axis])
                shifting[axis] += way * np.maximum(approach - rate * distance, 0.0)

    def _gather(self, fields: Array, first: int) -> None:
        """Copy fields (n_fields, n_particles) to the sources, from a row on."""
        near = self.neighbourhood.near
        sweeps.gather_space(near.particle, near.image, near.flip, fields, first, self._source)

    def wall_loads(self, names: Sequence[str], state: Array, time: float) -> dict[str, Array]:
        """Return the pressure and the viscous force on walls (2, 3) [N], by the walls' names.

        It is that of the fluid on the images behind a wall. At an edge, where images are behind
        two walls, each wall has the force along its own normal, and half of that along the edge.
        """
        position, fluctuation, velocity = np.split(state, (N_DIM, N_DIM + 1))
        force = None if self.body_force is None else self.body_force(position, time)
        regular = self._prepare(position, fluctuation[0], velocity, time, force)
        # Shifting moves momentum within the fluid.
        regular[sweeps.OWN_SHIFT : sweeps.OWN_SHIFT + N_DIM] = 0.0
        source = self._source
        volume = source[sweeps.VOLUME].copy()
        whole = self._fluid_constants
        parts = whole._replace(laplacian_viscosity=0.0), whole._replace(sound_speed=0.0)
        loads = {}
        out = np.empty((N_DIM + 1, position.shape[1]))
        for name in names:
            loads[name] = np.empty((2, N_DIM))
            for axis, share in enumerate(self._shares(name)):
                source[sweeps.VOLUME] = share * volume
                for row, constants in zip(loads[name], parts, strict=True):
                    self._rates(regular, constants, out)
                    row[axis] = -self.mass * np.sum(out[1 + axis])
        return loads

    def _shares(self, name: str) -> Array:
        """Return the shares (3, n_sources) of the force on each source that act on a wall."""
        near = self.neighbourhood.near
        axis = next(n for n, names in enumerate(SIDES) if name in names)
        place = self._source[:N_DIM]
        low = np.array(self.domain.lower)[:, None]
        high = np.array(self.domain.upper)[:, None]
        flipped = near.flip < 0.0
        beyond = place[axis] < low[axis] if name == SIDES[axis][0] else place[axis] > high[axis]
        beyond &= flipped[axis]
        shares = np.tile(beyond.astype(np.float64), (N_DIM, 1))
        for other in (n for n in range(N_DIM) if n != axis):
            along = 3 - axis - other
            shares[other, flipped[other]] = 0.0
            shares[along, flipped[other]] *= 0.5
        return shares


class SpaceWallForces:
    """The forces on some walls of a three-dimensional box, for states of a functional."""

    def __init__(self, functional: SpaceFunctional, walls: Mapping[str, str]) -> None:
        """Measure the forces on `walls`, by the names of the measurements."""
        self._functional = functional
        self.walls = walls

    def __call__(self, state: Array, time: float) -> dict[str, Array]:
        """Return the pressure and the viscous force (2, 3) [N], by name of the measurement."""
        loads = self._functional.wall_loads([*self.walls.values()], state, time)
        return {name: loads[wall] for name, wall in self.walls.items()}
