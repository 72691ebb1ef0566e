"""The delta-plus-SPH functional f (Eq. 2.6-2.14): rates of the state of moving particles.

The full state is an array (5, n_particles) with rows x, y [m], density fluctuation rho - rho_0
[kg/m3], and velocity u, v [m/s]. The fluctuation is stored because pressure depends on the
difference from rho_0, which would lose digits in the full density.

The force on a ghost acts at the nearest point of its wall. It contains the viscous stress mu du/dn.
The whole stress also has the term mu (grad u)^T n, with the normal n into the fluid. For a solid
the force of this term is zero, because the fluid is incompressible. Its torque is minus mu times
the circulation C of the wall's velocity, which for a rotating solid is twice the angular velocity
times the area. A straight side of the box contributes nothing at a uniform speed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from sphrom.arrays import Array
from sphrom.kernels import advection, fields, printed, sweeps
from sphrom.kernels.wendland import kernel
from sphrom.metrics.measures import TORQUE
from sphrom.sph.domain import Domain, Walls
from sphrom.sph.fluid import ROUNDING, Discretization, Fluid, Resistance, step_limits, volume_of
from sphrom.sph.neighbourhood import Neighbourhood
from sphrom.sph.terms import Term
from sphrom.sph.time_loop import DENSITY_LIMIT, Snapshot
from sphrom.sph.walls.rule import WallTerms

BodyForce = Callable[[Array, float], Array]
"""The acceleration (2, n_particles) [m/s2] at positions (2, n_particles) [m] and a time [s]."""
Constants = TypeVar("Constants", fields.FluidConstants, fields.RegularityConstants)
WallSpeed = Callable[[float], float | Array]
"""The factor of the walls' velocity at a time [s]."""

LARGEST_MACH_NUMBER = 0.3
"""Largest Mach number of a weakly compressible flow."""
PAIR_FACTOR = 8.0
"""2 (n + 2) of Eq. 2.12, in two dimensions."""
BESIDE = 1e-3
"""Distance along a wall at which the walls beside a point of it are found, over a ghost's depth."""
LEAST_TURN = 0.5
"""The least sine of the angle between two walls for forces on ghosts to be resolved along them."""


@dataclass(frozen=True)
class Rates:
    """Rates at particles: density [kg/m3/s], velocity (2, N) [m/s2], and the shifting velocity."""

    density: Array
    velocity: Array
    shifting_velocity: Array
    """(2, n_particles) [m/s], the velocity of particles in addition to that of the fluid."""
    slopes: Array | None = None
    """(n_particles, 3, 2) renormalised gradients (Eq. 2.11) of three fields, if requested."""


@dataclass(frozen=True)
class _FirstSums:
    """The results of the first sweep, and the terms that follow from positions."""

    source: Array
    """The sources with their pressures."""
    walls: WallTerms | None
    force: Array | None
    """(2, n_particles) the body force less resistance [m/s2]."""
    regular: Array
    """The rows of `sweeps.regularity`, with the shifting velocity that transports fields."""
    shifting: Array
    """(2, n_particles) the shifting velocity with which particles move [m/s]."""
    slopes: Array | None


@dataclass(eq=False)
class Functional:
    """Eq. 2.6-2.8 for one fluid in one domain, with walls and a body force if there are any."""

    fluid: Fluid
    discretization: Discretization
    domain: Domain
    walls: Walls | None = None
    body_force: BodyForce | None = None
    wall_speed: WallSpeed | None = None
    resistance: Resistance | None = None
    terms: Sequence[Term] = ()

    def __post_init__(self) -> None:
        fluid = self.fluid
        discretization = self.discretization
        domain = self.domain
        rule = discretization.walls.rule
        self.ghosts = None
        if self.walls is not None:
            self.ghosts = rule(self.walls, domain, fluid, discretization)
        self.mass = fluid.reference_density * discretization.particle_spacing**2
        length = discretization.smoothing_length
        laplacian = discretization.viscosity == "laplacian"
        self._fluid_constants = fields.FluidConstants(
            reference_density=fluid.reference_density,
            sound_speed=fluid.sound_speed,
            pair_viscosity=0.0 if laplacian else PAIR_FACTOR * fluid.kinematic_viscosity,
            laplacian_viscosity=fluid.kinematic_viscosity if laplacian else 0.0,
            diffusion=2.0 * discretization.diffusion_coefficient * length * fluid.sound_speed,
            advective=1.0 if discretization.shifting_transport == "advective" else 0.0,
        )
        damping = discretization.acoustic_damping * length / fluid.sound_speed
        self._regularity_constants = fields.RegularityConstants(
            magnitude=2.0 * length * fluid.max_speed if discretization.shifting else 0.0,
            amplitude=discretization.shifting_amplitude,
            inverse_kernel=1.0 / kernel(discretization.particle_spacing, 1.0 / length),
            as_printed=1.0 if discretization.shifting_as_printed else 0.0,
            limit=0.5 * fluid.max_speed,
            damping=damping * fluid.reference_density,
            walls_return=rule.returns_flux,
        )
        precision = np.dtype(discretization.pair_precision)
        # Sums over particles take constants of their precision; those over ghosts have doubles.
        self._pair_constants = _in_precision(self._fluid_constants, precision)
        self._pair_regularity = _in_precision(self._regularity_constants, precision)
        self._n_fields = fields.N_FIELDS
        self._sweep_rates = sweeps.rates
        if printed.are_selected(self._fluid_constants):
            self._n_fields = printed.N_PRINTED_FIELDS
            self._sweep_rates = printed.rates
        self.neighbourhood = Neighbourhood(domain, discretization, self._n_fields, precision)
        self._source = np.empty((self._n_fields, 0))

    def __call__(self, state: Array, time: float = 0.0) -> Array:
        """Return the rates (2 n_dim + 1, n_particles) of a full state at a time [s]."""
        n = self.domain.n_dim
        rates = self.evaluate(state[:n], state[n], state[n + 1 :], time)
        out = np.empty_like(state)
        np.add(state[n + 1 :], rates.shifting_velocity, out=out[:n])
        out[n] = rates.density
        out[n + 1 :] = rates.velocity
        return out

    def evaluate(
        self,
        position: Array,
        density_fluctuation: Array,
        velocity: Array,
        time: float = 0.0,
        along: Array | None = None,
    ) -> Rates:
        """Evaluate Eq. 2.6-2.7.

        Positions are (2, N) [m], densities (N,) [kg/m3], velocities (2, N) [m/s], time is in [s].

        Parameters
        ----------
        along : (3, n_particles) fields whose gradients are computed in the same sweep.
        """
        sums = self._first_sums(position, density_fluctuation, velocity, time, along)
        near = self.neighbourhood
        constants = self._fluid_constants
        out = np.empty((3, density_fluctuation.size))
        pairs = self._pair_constants
        self._sweep_rates(near.blocks, near.search, sums.source, sums.regular, pairs, out)
        if sums.walls is not None:
            sums.walls.add_rates(constants, sums.regular, out[1:])
        if self.resistance is not None:
            self.resistance.hold(position, out[1:])
        if sums.force is not None:
            out[1:] += sums.force
        if self.discretization.fixed_volume:
            self._fix_volume(density_fluctuation, out[0])
        return Rates(out[0], out[1:], sums.shifting, sums.slopes)

    def _fix_volume(self, density_fluctuation: Array, rates: Array) -> None:
        """Subtract the mean from the rates of density (n_particles,) [kg/m3/s], in place.

        The volume of a domain filled with fluid is constant, which the sums of the continuity
        equation do not ensure: the mean pressure would drift with the particles' arrangement.
        """
        density = self.fluid.reference_density + density_fluctuation
        compressibility = self.mass / density**2
        rates -= np.sum(compressibility * rates) / np.sum(compressibility)

    def _first_sums(
        self,
        position: Array,
        density_fluctuation: Array,
        velocity: Array,
        time: float,
        along: Array | None = None,
    ) -> _FirstSums:
        """Run the first sweep at some positions, with gradients of the fields `along` if given."""
        source = self._sources(position, density_fluctuation, velocity)
        near = self.neighbourhood
        blocks = near.blocks
        image = near.sources.image
        walls, force = self._around(source, position, velocity, time)
        constants = self._regularity_constants
        wall_sums = np.empty((6, 0)) if walls is None else walls.regularity(constants)
        regular = np.empty((fields.N_REGULAR_ROWS, blocks.targets.size))
        slopes: tuple[Array, ...] = ()
        if along is not None:
            sweeps.gather(blocks.particle, image, along, fields.FIRST, source)
            slopes = (np.empty((along.shape[1], 3, 2)),)
        constants = self._pair_regularity
        sweeps.regularity(blocks, near.search, source, constants, wall_sums, regular, slopes)
        if self.discretization.free_surface:
            self._settle_spray(regular)
        shifting = regular[fields.OWN_SHIFT_U : fields.OWN_SHIFT_V + 1]
        if walls is not None and (self.discretization.shifting or self.discretization.free_surface):
            shifting = self._held_back(shifting, walls)
        shared = regular[: self._n_fields - fields.PRESSURE]
        sweeps.gather(blocks.particle, image, shared, fields.PRESSURE, source)
        if walls is not None and self.discretization.acoustic_damping > 0.0:
            walls.damp(source[fields.PRESSURE])
        return _FirstSums(
            source, walls, force, regular, shifting, slopes=slopes[0] if slopes else None
        )

    def _settle_spray(self, regular: Array) -> None:
        """Set to zero, in place, the values that no neighbours, or those on one line, determine."""
        regular[~np.isfinite(regular)] = 0.0
        steepest = DENSITY_LIMIT * self.fluid.reference_density
        slope = regular[fields.OWN_GRADIENT_X : fields.OWN_GRADIENT_Y + 1]
        slope[:, np.hypot(*slope) * self.discretization.smoothing_length > steepest] = 0.0

    def _held_back(self, shifting: Array, walls: WallTerms) -> Array:
        """Limit the transport of fields beside walls, in place; return the limited shifting.

        Advective terms transport fields with the particles. The printed terms do not include the
        limit: a particle that is held at a corner would gain the momentum of the flow through it
        indefinitely.
        """
        if self.discretization.shifting_transport == "advective":
            walls.hold_back(shifting)
            return shifting
        held = shifting.copy()
        walls.hold_back(held)
        walls.hold_back(shifting, against=0.0)
        return held

    def ghost_forces(self, state: Array, time: float = 0.0) -> Array:
        """Return the pressure and the viscous force on each ghost (2, 2, n_ghosts) [N/m].

        They are per metre of depth, and the negative of the ghosts' contribution to the momentum of
        a full state. The force on a wall is the sum over its ghosts. The viscous part has the
        stress mu du/dn. Along a wall at rest this is the whole stress; along a rotating wall the
        torque lacks -2 mu times the angular velocity and the enclosed area.
        """
        walls = self._first_sums(state[:2], state[2], state[3:], time).walls
        assert walls is not None
        return walls.forces(self._fluid_constants)

    def _around(
        self, source: Array, position: Array, velocity: Array, time: float
    ) -> tuple[WallTerms | None, Array | None]:
        """Return the wall terms, and the body force less resistance (2, n_particles) [m/s2].

        The body force includes the terms that a user adds.

        The wall terms are None without walls, the force is None without force and resistance.
        """
        force = None if self.body_force is None else self.body_force(position, time)
        if self.resistance is not None:
            slowing = self.resistance.rates(position, self.fluid.kinematic_viscosity) * velocity
            force = -slowing if force is None else force - slowing
        for term in self.terms:
            added = term(self.domain.wrap(position.T), velocity, time)
            force = added if force is None else force + added
        if self.ghosts is None:
            return None, force
        near = self.neighbourhood
        speed = 1.0 if self.wall_speed is None else self.wall_speed(time)
        return self.ghosts.beside(near.sources, source, near.search, force, speed), force

    def advection(
        self, position: Array, density_fluctuation: Array, velocity: Array, time: float = 0.0
    ) -> Array:
        """Return u . grad rho and u . grad u (3, N) as in Eq. 3.5-3.6, including ghosts."""
        source = self._sources(position, density_fluctuation, velocity)
        near = self.neighbourhood.sources
        out = np.empty((3, density_fluctuation.size))
        nowhere = np.full(near.targets.size, np.inf)
        particles = fields.BesideWalls(near.particle, near.targets, source, distance=nowhere)
        depth = np.zeros(source.shape[1])
        search = self.neighbourhood.search
        advection.transport(particles, source, search, depth, self.fluid.reference_density, out)
        walls, _ = self._around(source, position, velocity, time)
        if walls is not None:
            walls.add_transport(out)
        return out

    def volume(self, density_fluctuation: Array) -> Array:
        """Return the particle volumes (N,) [m2]."""
        return volume_of(density_fluctuation, self.fluid.reference_density, self.mass)

    def _sources(self, position: Array, density_fluctuation: Array, velocity: Array) -> Array:
        self.neighbourhood.update(position)
        near = self.neighbourhood.sources
        shape = (self._n_fields, near.particle.size)
        # Kept, because allocating so much memory takes as long as filling it.
        if self._source.shape != shape:
            self._source = np.empty(shape)
        volume = self.volume(density_fluctuation)
        particles = np.vstack((position, density_fluctuation, velocity, volume))
        sweeps.gather(near.particle, near.image, particles, fields.X, self._source)
        return self._source

    # The interface of the time loop

    rates = __call__

    def position(self, state: Array) -> Array:
        """Return the positions (n_dim, n_particles) [m]."""
        return state[: self.domain.n_dim]

    def wrapped(self, state: Array) -> Array:
        """Return the state with its particles wrapped into the box; reset the neighbour list."""
        self.neighbourhood.rebuild_at(None)
        n = self.domain.n_dim
        return np.vstack((self.domain.wrap(state[:n].T).T, state[n:]))

    def snapshot(self, state: Array) -> Snapshot:
        """Return the fields of a state."""
        n = self.domain.n_dim
        return Snapshot(state[:n], state[n], state[n + 1 :])

    def remedy(self, state: Array, time_step: float) -> str:
        """Return a suggestion for a run that became unstable near a state."""
        sound = self.fluid.sound_speed
        limit = step_limits(self.fluid, self.discretization, self.ghosts is not None).least
        now = self.snapshot(state)
        if time_step > limit * (1.0 + ROUNDING):
            return f"the time step is beyond its limit of {limit:.4g} s"
        if (speed := float(np.hypot.reduce(now.velocity).max())) > LARGEST_MACH_NUMBER * sound:
            return f"c0 = {sound:.4g} m/s is too low for {speed:.3g} m/s: raise the reference speed"
        if (
            np.abs(now.density_fluctuation).max()
            > 0.5 * DENSITY_LIMIT * self.fluid.reference_density
        ):
            return f"c0 = {sound:.4g} m/s is too low for the pressure: lower the Mach number"
        return "a smaller time step or a finer resolution may help"


def _in_precision(constants: Constants, precision: np.dtype[np.floating]) -> Constants:
    """Return a record of constants as numbers of a precision."""
    return type(constants)._make(map(precision.type, constants))


@dataclass(frozen=True)
class MeasuredWall:
    """A wall on which the force is measured."""

    weights: Array
    """(3, 2, n_ghosts) that give force along x and y, and torque [m], from forces on ghosts."""
    circulation: float
    """C of the wall's velocity, anticlockwise [m2/s]."""

    @property
    def arm(self) -> float:
        """The root mean square distance of its ghosts from the centre of rotation [m]."""
        squares = np.sum(self.weights**2, axis=(1, 2))
        return float(np.sqrt(squares[TORQUE] / squares[0]))

    def loads(self, ghost_forces: Array) -> Array:
        """Return force and torque (3, ...), given the forces on ghosts (2, n_ghosts, ...) [N/m]."""
        return np.tensordot(self.weights, ghost_forces, 2)


def measured_wall(
    domain: Domain, walls: Walls, name: str, wall_velocity: Callable[[Array], Array]
) -> MeasuredWall:
    """Return a wall of a domain, prepared for the measurement of its force.

    Parameters
    ----------
    wall_velocity : returns the walls' velocity (n_points, 2) [m/s] at places (n_points, 2) [m].
    """
    weights = np.zeros((3, 2, len(walls.wall)))
    weights[:TORQUE] = _shares(domain, walls, domain.wall_names.index(name))
    ghosts = np.flatnonzero(weights.any(axis=(0, 1)))
    x, y = domain.arms(name, domain.on_wall(domain.wrap(walls.position[ghosts]))).T
    weights[TORQUE][:, ghosts] = x * weights[1][:, ghosts] - y * weights[0][:, ghosts]
    return MeasuredWall(weights, domain.circulation(name, wall_velocity))


def _shares(domain: Domain, walls: Walls, wall: int) -> Array:
    """Return the matrices (2, 2, n_ghosts) that give a wall's part of the forces on ghosts.

    Behind a corner in which two walls meet, a force is the sum of two, along their normals:
    pressure pushes each wall along its normal only. Any other force is that on the nearest wall.
    """
    place = domain.wrap(walls.position)
    way = domain.on_wall(place) - place
    along = BESIDE * np.stack((-way[:, 1], way[:, 0]), axis=1)
    # The nearest point of a ghost behind a corner is the corner, with a wall on either side.
    sides = [place + (1.0 - BESIDE**2) * way + step for step in (along, -along)]
    owners = [domain.nearest_wall(side) for side in sides]
    normals = [domain.distance_and_normal(side)[1].T for side in sides]
    a, b = (
        normal[:, None] * (owner == wall) for normal, owner in zip(normals, owners, strict=True)
    )
    along_a, along_b = (np.stack((-normal[1], normal[0])) for normal in normals)
    turn = np.sum(along_a * normals[1], axis=0)
    shared = (owners[0] != owners[1]) & (np.abs(turn) > LEAST_TURN)
    parts = (b * along_a - a * along_b) / np.where(shared, turn, 1.0)
    return np.where(shared, parts, np.eye(2)[..., None] * (walls.wall == wall))


class WallForces:
    """The forces on some walls, for states of a functional."""

    def __init__(self, functional: Functional, walls: Mapping[str, MeasuredWall]) -> None:
        self._functional = functional
        self.walls = walls

    def __call__(self, state: Array, time: float) -> dict[str, Array]:
        """Return pressure and viscous force with torque (2, 3) [N/m, N], by name.

        States are full ones (5, n_particles), times in [s].
        """
        forces = self._functional.ghost_forces(state, time)
        functional = self._functional
        speed = 1.0 if functional.wall_speed is None else functional.wall_speed(time)
        viscosity = functional.fluid.reference_density * functional.fluid.kinematic_viscosity
        loads = {}
        for name, wall in self.walls.items():
            loads[name] = np.stack([wall.loads(part) for part in forces])
            # Factors of all ghosts of one wall are equal; it has part of the force on others.
            own = np.all(wall.weights[[0, 1], [0, 1]] == 1.0, axis=0)
            factor = np.broadcast_to(speed, own.size)[own]
            loads[name][1, TORQUE] -= viscosity * factor[:1].sum() * wall.circulation
        return loads
