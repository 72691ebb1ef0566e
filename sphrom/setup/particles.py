"""From a case to the objects that compute on its particles: the functional, ghosts, and maps.

They import the kernels of SPH; `sphrom.setup.assembly` makes everything else without them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sphrom.arrays import Array
from sphrom.case.measure_sections import ElevationMeasure
from sphrom.case.models import Case
from sphrom.case.plan_flows import BEYOND
from sphrom.case.points import ParameterPoint
from sphrom.errors import UnstableError
from sphrom.kernels import SUPPORT_RATIO
from sphrom.metrics.elevation import Filled, Filling, columns_of, lowest_surface
from sphrom.metrics.measures import FLOW_RATES, FieldMeasure, Quantities
from sphrom.metrics.quantities import is_vector
from sphrom.metrics.series import kinetic_energy
from sphrom.reduction.reference_space import ReferenceMap, TooFewParticlesError
from sphrom.scenes.flows import Scene
from sphrom.setup.assembly import field_measures
from sphrom.sph.domain import Walls
from sphrom.sph.fixed_points import FixedPoints
from sphrom.sph.fluid import UnitForcing, pressure_of, volume_of
from sphrom.sph.functional import Functional, MeasuredWall, WallForces, measured_wall
from sphrom.sph.lattice_points import LatticePoints
from sphrom.sph.space_functional import SpaceFunctional, SpaceWallForces
from sphrom.sph.watch import Watch

AnyForces = WallForces | SpaceWallForces

SAMPLING_RATIO = 2.0
"""Smoothing length of the moving least squares that sample particles, relative to the spacing."""
LOOK_EVERY = 8
"""Smallest number of steps between checks of a full run, which then take 0.3 % of its time."""
HEIGHTS = 2
"""Number of heights per particle spacing at which the elevation is searched."""


def functional(case: Case, point: ParameterPoint) -> Functional:
    """Return the full-order functional at a parameter point."""
    flow = case.plan.flow(point)
    if flow.domain.n_dim > 2:
        return SpaceFunctional(
            case.plan.fluid(point),
            case.plan.discretization,
            flow.domain,
            body_force=flow.body_force,
            wall_velocity=flow.wall_velocity,
            speed_at=flow.wall_speed,
        )
    ghosts = walls(case, flow)
    return Functional(
        case.plan.fluid(point),
        case.plan.discretization,
        flow.domain,
        walls=ghosts,
        body_force=flow.body_force,
        wall_speed=None if ghosts is None else flow.wall_speed(ghosts.position),
        resistance=flow.resistance,
        terms=flow.terms,
    )


def walls(case: Case, flow: Scene) -> Walls | None:
    """Return the ghosts of a scene's walls, or None if it has no walls."""
    if not flow.domain.has_walls:
        return None
    at_rest = flow.domain.ghosts(case.plan.particle_spacing, case.plan.n_wall_layers)
    return at_rest.moving(flow.wall_velocity)


def measured_walls(case: Case, flow: Scene) -> dict[str, MeasuredWall]:
    """Return the walls on which a case measures forces, by the names of the measurements."""
    ghosts = walls(case, flow) if case.scene.measured_walls else None
    if ghosts is None:
        return {}
    return {
        name: measured_wall(flow.domain, ghosts, wall, flow.wall_velocity)
        for name, wall in case.scene.measured_walls.items()
    }


def wall_forces(case: Case, point: ParameterPoint, of: Functional) -> AnyForces | None:
    """Return the forces that a case measures, for states of a functional, if there are any."""
    if isinstance(of, SpaceFunctional):
        names = case.scene.measured_walls
        return SpaceWallForces(of, names) if names else None
    measured = measured_walls(case, case.plan.flow(point))
    return WallForces(of, measured) if measured else None


def watch(case: Case, point: ParameterPoint) -> Watch:
    """Return a watch over the snapshots of a full run."""
    plan = case.plan
    flow = case.plan.flow(point)
    domain = flow.domain
    ghosts = walls(case, flow)
    speeds = [] if ghosts is None else np.linalg.norm(ghosts.velocity, axis=1)
    drive = float(np.max(speeds, initial=0.0))
    force = flow.body_force
    if (strip := plan.strip) is not None:  # the same flow passes through the narrowest gap
        wide = domain.lengths[1 - strip.axis] / min(domain.narrowest_gap, *domain.lengths)
        head = case.scene.largest_head(case.time.final_time, point.factors)
        drive = math.hypot(drive, wide * strip.speed, math.sqrt(2.0 * head))
        force = None
    if flow.terms:  # a term may do any work
        drive = math.inf
    return Watch(
        case.fluid.reference_density,
        plan.sound_speed,
        plan.max_speed,
        drive,
        case.scene.gravity,
        force,
        is_driven=plan.is_driven(point),
        has_surface=case.scene.has_surface,
        look_every=max(1, round(LOOK_EVERY / case.snapshots.every)),
    )


def map_onto(case: Case, points: Array) -> ReferenceMap:
    """Return the case's map of particle fields onto points (n_points, n_dim)."""
    return ReferenceMap(
        points,
        case.scene.domain,
        particle_spacing=case.plan.particle_spacing,
        smoothing_length=case.plan.reference_smoothing_length,
        method=case.reference.method,
    )


def driven_measured_walls(case: Case) -> dict[str, tuple[MeasuredWall, dict[str, float]]]:
    """Return the walls on which a case measures forces, without the motion by driving parameters.

    Each comes with the circulation [m2/s] per unit of each driving parameter.
    """
    at_rest, per_unit = case.plan.rest_and_units
    moved = {name: measured_walls(case, flow) for name, flow in per_unit.items()}
    return {
        name: (wall, {p: walls[name].circulation - wall.circulation for p, walls in moved.items()})
        for name, wall in measured_walls(case, at_rest).items()
    }


def drives(case: Case, position: Array) -> dict[str, UnitForcing[Array]]:
    """Return the forcing of ghosts and points (n_points, n_dim) per unit of each parameter."""
    at_rest, per_unit = case.plan.rest_and_units
    ghosts = walls(case, at_rest)
    forcings = {}
    for name, flow in per_unit.items():
        velocity = force = np.zeros(0)
        if ghosts is not None:
            velocity = flow.wall_velocity(ghosts.position) - ghosts.velocity
        if flow.body_force is not None and at_rest.body_force is not None:
            force = flow.body_force.field(position.T) - at_rest.body_force.field(position.T)
        if velocity.any() or force.any():
            forcings[name] = UnitForcing(
                velocity if velocity.any() else None, force if force.any() else None
            )
    return forcings


def fixed_points(case: Case, position: Array) -> FixedPoints:
    """Return the sums over neighbours at the reference points (n_points, n_dim) [m].

    Each driving parameter has a separate part in them.
    """
    point = case.plan.train_points[0]
    flow, _ = case.plan.rest_and_units
    force = None if flow.body_force is None else flow.body_force.field(position.T)
    points_of = FixedPoints if position.shape[1] == 2 else LatticePoints
    return points_of(
        position,
        case.plan.fluid(point),
        case.plan.discretization,
        flow.domain,
        walls(case, flow),
        force,
        walls_driven=flow.wall_amplitude is not None,
        drives=drives(case, position),
        resistance=flow.resistance,
        terms=flow.terms,
    )


def filled(case: Case, points: Array) -> Filled:
    """Return the function for the share that particles fill at points (n_points, 2) [m]."""
    domain = case.scene.domain
    spacing = case.plan.particle_spacing
    solid = np.empty((0, 2))
    if n_solids := len(domain.solid_names):
        ghosts = domain.ghosts(spacing, case.plan.n_wall_layers)
        solid = ghosts.position[ghosts.wall >= len(domain.wall_names) - n_solids]
    radius = SUPPORT_RATIO * case.plan.smoothing_length
    filling = Filling(
        points, radius, domain.lower, domain.upper, domain.periodic, solid, spacing**2
    )
    density = case.fluid.reference_density
    mass = case.plan.mass
    return lambda position, excess: filling(position, volume_of(excess, density, mass))


def sampler(case: Case, points: Array) -> ReferenceMap:
    """Return the interpolation that samples particles at points (n_points, n_dim) [m].

    It is the accurate one, whichever map the case uses. Above a free surface fields are zero.
    """
    return ReferenceMap(
        points,
        case.scene.domain,
        particle_spacing=case.plan.particle_spacing,
        smoothing_length=SAMPLING_RATIO * case.plan.particle_spacing,
        filled=filled(case, points) if case.scene.has_surface else None,
    )


class MeasuredFields:
    """Measured fields, interpolated from particles: affine in the particles' fields.

    On walls, fluid has the walls' velocity. The interpolation's error on the wall is subtracted at
    places: fully on the wall, and not at all from a spacing away. There are three exceptions: flow
    rates, because particles conserve them without a correction; walls whose velocity changes with
    parameters or time, so that all runs are measured alike; and slip or free-surface flows.
    """

    def __init__(self, case: Case, measures: Mapping[str, FieldMeasure]) -> None:
        self.measures = measures
        self._sound_speed = case.plan.sound_speed
        places = np.concatenate([measure.position for measure in measures.values()])
        distance, normal = case.scene.domain.distance_and_normal(places)
        spacing = case.plan.particle_spacing
        at_rest, per_unit = case.plan.rest_and_units
        flows = [np.full(len(m.position), isinstance(m, FLOW_RATES)) for m in measures.values()]
        near = self._near = np.flatnonzero((distance < spacing) & ~np.concatenate(flows))
        on_walls = places[near] - distance[near, None] * normal[near]
        beyond = on_walls - BEYOND * spacing * normal[near]
        self._walls = at_rest.wall_velocity(beyond)
        varies = self._walls.any(axis=1) & (at_rest.wall_amplitude is not None)
        for flow in per_unit.values():
            varies |= (flow.wall_velocity(beyond) != self._walls).any(axis=1)
        varies |= case.scene.free_slip or case.scene.has_surface
        self._share = np.where(varies, 0.0, 1.0 - distance[near] / spacing)[:, None]
        self.position = np.concatenate((places, on_walls))
        """(n_positions, n_dim) [m], the positions at which fields are needed."""
        self._sample = sampler(case, self.position)

    @classmethod
    def of(cls, case: Case) -> MeasuredFields | None:
        """Return the measured fields of a case, or None if it measures none."""
        measures = field_measures(case)
        return cls(case, measures) if measures else None

    def __call__(
        self, position: Array, density_fluctuation: Array, velocity: Array
    ) -> dict[str, Quantities]:
        """Return the measurements of particles (n_particles[, n_dim]), by name.

        Above a free surface, pressure and velocity are zero.

        Raises UnstableError if too few particles are near a place in fluid without a surface.
        """
        try:
            return self.of_fields(*self._sample(position, density_fluctuation, velocity))
        except TooFewParticlesError as error:
            names = np.repeat([*self.measures], [len(m.position) for m in self.measures.values()])
            name = np.concatenate((names, names[self._near]))[error.number]
            place = f"unstable where fields are measured{f' ({name})' if name else ''}"
            raise UnstableError(f"{place}: {error}") from error

    def of_fields(self, density_fluctuation: Array, velocity: Array) -> dict[str, Quantities]:
        """Return the measurements of fields (n_positions[, n_dim]) at `position`, by name."""
        corrected = velocity.copy()
        pressure = pressure_of(density_fluctuation, self._sound_speed)
        ends = np.cumsum([len(measure.position) for measure in self.measures.values()])
        corrected[self._near] += self._share * (self._walls - corrected[ends[-1] :])
        # The positions after those of the last measurement are on walls.
        velocities = np.split(corrected, ends)
        pressures = np.split(pressure, ends)
        return {
            name: measure.of(velocities[n], pressures[n])
            for n, (name, measure) in enumerate(self.measures.items())
        }


class MeasuredParticles:
    """All measurements of particles except forces: fields, the surface, and the whole fluid."""

    def __init__(self, case: Case, point: ParameterPoint) -> None:
        self._fields = MeasuredFields.of(case)
        self.measures = {} if self._fields is None else self._fields.measures
        scene = case.scene
        spacing = case.plan.particle_spacing
        self._surface = scene.measured_surface
        values = dict(point.others)
        self._mass = case.plan.mass
        self._weight = case.plan.mass * scene.gravity
        self._rest = scene.domain.lower[1]
        top = scene.domain.upper[1]
        n_heights = 1 + math.ceil(HEIGHTS * (top - self._rest) / spacing)
        self._heights = np.linspace(self._rest, top, n_heights)
        if self._surface and math.isfinite(scene.level_at(values)):
            self._rest = float(scene.fill(spacing, values)[:, 1].mean())
        surface = self._surface.values()
        self._x = [m.elevation for m in surface if isinstance(m, ElevationMeasure)]
        self._filled = None
        if self._x:
            columns = columns_of(np.array(self._x), self._heights)
            self._filled = filled(case, columns)
            self._solid = ~scene.domain.contains(columns)

    @classmethod
    def of(cls, case: Case, point: ParameterPoint) -> MeasuredParticles | None:
        """Return the measurements of a case's particles at a point, or None if there are none."""
        scene = case.scene
        return cls(case, point) if scene.measured_fields or scene.measured_surface else None

    @property
    def at_rest(self) -> dict[str, Quantities]:
        """Measurements with all values zero, by name; they define the shapes."""
        quantities = {
            name: measure.of(np.zeros_like(measure.position), np.zeros(len(measure.position)))
            for name, measure in self.measures.items()
        }
        for name, section in self._surface.items():
            quantities[name] = {q: np.zeros((2,) * is_vector(q)) for q in section.quantities}
        return quantities

    def __call__(
        self, position: Array, density_fluctuation: Array, velocity: Array
    ) -> dict[str, Quantities]:
        """Return the measurements of particles (n_particles[, n_dim]), by name.

        Raises UnstableError as `MeasuredFields` does.
        """
        measured = dict[str, Quantities]()
        if self._fields is not None:
            measured |= self._fields(position, density_fluctuation, velocity)
        if not self._surface:
            return measured
        heights = np.empty(0)
        if self._filled is not None:
            share = np.where(self._solid, 1.0, self._filled(position, density_fluctuation))
            heights = lowest_surface(share.reshape(-1, len(self._heights)), self._heights)
        fluid = ParticleFluid(
            elevations=dict(zip(self._x, heights, strict=True)),
            centre_of_mass=position.mean(axis=0),
            kinetic_energy=kinetic_energy(velocity, self._mass),
            potential_energy=np.asarray(self._weight * np.sum(position[:, 1] - self._rest)),
        )
        return measured | {name: section.of(fluid) for name, section in self._surface.items()}


@dataclass(frozen=True)
class ParticleFluid:
    """Fluid with a free surface at one instant of a full run, as measurements need it."""

    elevations: Mapping[float, Array]
    """The height of the surface [m] as a function of x [m]."""
    centre_of_mass: Array
    """(2,) [m]."""
    kinetic_energy: Array
    """[J/m]."""
    potential_energy: Array
    """[J/m], zero at rest."""

    def elevation_at(self, x: float) -> Array:
        """Return the height of the surface [m] at a measured place [m]."""
        return np.asarray(self.elevations[x])
