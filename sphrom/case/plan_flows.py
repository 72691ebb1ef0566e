"""The plan of a case, second part: particles, speeds, and the flow at each parameter point."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import shapely

from sphrom.arrays import Array
from sphrom.case.fields import LARGEST
from sphrom.case.plan_points import PointsPlan
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.kernels import SUPPORT_RATIO
from sphrom.metrics.grids import grid_points
from sphrom.scenes.flows import Scales, Scene
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import Discretization, Fluid, Strip
from sphrom.sph.space_box import SpaceBox

if TYPE_CHECKING:
    from sphrom.case.scene_section import SceneSection

N_LINES = 201
"""Number of lines to try if a solid covers the usual one."""
N_INSTANTS, N_PLACES = 50, 50
"""Number of times of a run, and of places along each axis, at which the driving is sampled."""
SURFACE_CHANGE = 0.01
"""Largest relative change of the density by the fluid's weight, if there is a free surface."""
DENSITY_CHANGE = 0.03
"""Largest relative change of the density by the body force or by friction at walls."""
CORNER_PRESSURE = 2.5
"""Largest pressure over mu U / r, at a distance r from where walls slide apart (Taylor 1962)."""
BEYOND = 1e-6
"""Distance beyond walls at which their velocity is evaluated, relative to the spacing."""
MLS_SMOOTHING_LENGTH_RATIO = 2.0
"""Smoothing length of moving least squares relative to the spacing; they need no wider support."""


class FlowsPlan(PointsPlan):
    """The particles of one case, its speeds, and its flow at each parameter point."""

    @cached_property
    def scene(self) -> SceneSection:
        """The scene with the strip and the checks that fit all points and the particles."""
        return self._scene.over(self._settings, self.particle_spacing, self._time.final_time)

    @cached_property
    def strip(self) -> Strip | None:
        """The strip of the inflow; None without an inflow."""
        return self.scene.strip

    def problems_until(self, end: float) -> Iterator[tuple[str, str]]:
        """Yield keys of the scene that don't allow runs until a time [s], with reasons."""
        return self.scene.problems(end, self.fluid(self.points[0]))

    @cached_property
    def particle_spacing(self) -> float:
        """dx [m], the square root of the area of a particle."""
        wanted = self._scene.resolved_length / self._case.discretization.resolution
        return self._scene.domain.lattice_spacing(wanted)

    @cached_property
    def smoothing_length(self) -> float:
        """h [m]."""
        return self._case.discretization.smoothing_length_ratio * self.particle_spacing

    @property
    def n_neighbours(self) -> float:
        """Average number of particles in a kernel's support."""
        radius = SUPPORT_RATIO * self.smoothing_length / self.particle_spacing
        return math.pi * radius**2 * (1.0 if self._scene.domain.n_dim == 2 else 4.0 / 3.0 * radius)

    @cached_property
    def reference_smoothing_length(self) -> float:
        """h of the map onto the reference space [m]."""
        section = self._case.reference
        usual = MLS_SMOOTHING_LENGTH_RATIO
        if section.method != "mls":
            usual = self._case.discretization.smoothing_length_ratio
        return (section.smoothing_length_ratio or usual) * self.particle_spacing

    @cached_property
    def n_particles(self) -> int:
        """The number of fluid particles; with a free surface, the largest of all points."""
        spacing = self.particle_spacing
        if self._scene.has_surface:
            return max(len(self._scene.fill(spacing, values)) for values in self._settings)
        return self._scene.domain.n_particles(spacing)

    @cached_property
    def n_ghosts(self) -> int:
        """The number of ghost particles of the scene's walls."""
        return self._scene.domain.n_ghosts(self.particle_spacing, self.n_wall_layers)

    @cached_property
    def n_wall_layers(self) -> int:
        """Layers of ghosts behind walls, by default as far as the kernel reaches."""
        return self._case.discretization.walls.layers or self.discretization.n_layers

    @cached_property
    def walls_fit_lattice(self) -> bool:
        """Whether all walls of the scene lie along the axes, so that a lattice fits them."""
        domain = self._scene.domain
        return isinstance(domain, BoxDomain | SpaceBox) and domain.has_walls

    @cached_property
    def packed(self) -> bool:
        """Whether particles start packed rather than on a lattice."""
        asked = self._case.discretization.initial_particles
        if self._scene.has_surface:
            return asked == "packed"
        return not self.walls_fit_lattice if asked == "auto" else asked == "packed"

    @cached_property
    def reference_lattice(self) -> bool:
        """Whether the reference points are a lattice."""
        points = self._case.reference.points
        return points == "lattice" or (points == "initial" and not self.packed)

    @cached_property
    def lattice_splines(self) -> bool:
        """Whether modes are B-splines on a lattice rather than polyharmonic splines in cells."""
        if self._case.psi.kind != "auto":
            return self._case.psi.kind == "b-spline"
        return self.reference_lattice and self._scene.domain.fills_box

    @cached_property
    def separate_mean_density(self) -> bool:
        """Whether the mean density fluctuation is a variable apart from the basis."""
        basis = self._case.basis
        if basis.mean_density != "auto":
            return basis.mean_density == "separate"
        walled = not any(self._scene.domain.periodic)
        steady = walled or self._case.discretization.fixed_volume
        return steady and basis.inner_product == "acoustic"

    @cached_property
    def probe_line(self) -> float:
        """x of the vertical line on which runs are compared [m]."""
        if (line := self._case.compare.line) is not None:
            return line
        usual = self._scene.probe_line
        domain = self._scene.domain
        places = np.linspace(domain.lower[0], domain.upper[0], N_LINES).tolist()
        nearest = sorted(places, key=lambda x: abs(x - usual))
        return next(filter(domain.sections, (usual, *nearest)), usual)

    def _beside_box(self, step: float) -> list[Array]:
        """Return paths (n_places, n_dim) [m] just outside the box, in steps of at most one [m].

        In space there are three, each around a slice through the middle.
        """
        domain = self._scene.domain
        middle = 0.5 * np.add(domain.lower, domain.upper)
        paths = []
        for axes in combinations(range(domain.n_dim), 2):
            corners = [[ends[axis] for axis in axes] for ends in (domain.lower, domain.upper)]
            box = shapely.box(*corners[0], *corners[1])
            edge = box.buffer(BEYOND * self.particle_spacing, join_style="mitre").exterior
            around = shapely.get_coordinates(shapely.segmentize(edge, step))
            path = np.tile(middle, (len(around), 1))
            path[:, axes] = around
            paths.append(path)
        return paths

    @cached_property
    def mass(self) -> float:
        """The mass of a particle [kg], in a plane per metre of depth [kg/m]."""
        return self._fluid.reference_density * self.particle_spacing**self._scene.domain.n_dim

    def depth(self, point: ParameterPoint) -> float:
        """Return the mean depth of fluid with a free surface at a parameter point [m]."""
        scene = self._scene
        values = point.factors
        if math.isfinite(level := scene.level_at(values)):
            return level - scene.domain.lower[1]
        area = len(scene.fill(self.particle_spacing, values)) * self.particle_spacing**2
        return area / scene.domain.lengths[0]

    @property
    def with_weight(self) -> bool:
        """Whether pressures have a hydrostatic part, which is not flow, and places may become
        dry."""
        return self._scene.has_surface

    def weight_at(self, point: ParameterPoint, position: Array) -> Array | None:
        """Return the pressure at rest (n_positions,) [Pa] below a level; None without a surface."""
        scene = self._scene
        if not scene.has_surface:
            return None
        level = scene.domain.lower[1] + self.depth(point)
        return self._fluid.reference_density * scene.gravity * (level - position[:, 1])

    @cached_property
    def max_speed(self) -> float:
        """The largest speed at all points: the reference speed, or the speed of a varied wall."""
        scene = self.scene
        end = self._time.final_time
        varied = (v for v in self._settings if v or scene.amplitudes)
        walls = (scene.largest_wall_speed(v, end) for v in varied)
        fastest = max(self._fluid.reference_speed, *walls, 0.0)
        if not fastest <= LARGEST:
            raise CaseError(f"scene: walls or the inflow have a speed of {fastest:g} m/s; lower it")
        return fastest

    @cached_property
    def sound_speed(self) -> float:
        """c0 [m/s], the same at all points: from the Mach number, or larger for large heads."""
        change = SURFACE_CHANGE if self._scene.has_surface else DENSITY_CHANGE
        least = math.sqrt(self.largest_head / change)
        return max(self.max_speed / self._fluid.mach_number, least)

    @cached_property
    def heads(self) -> dict[str, float]:
        """Estimates of the largest heads of all runs [m2/s2], by their cause in words."""
        scene = self._scene
        end = self._time.final_time
        domain = scene.domain
        viscosity = max(map(self.kinematic_viscosity, self.points))
        gap = domain.narrowest_gap or math.inf  # a check refuses a gap of zero
        in_gaps = self.max_speed * (max(domain.lengths) / gap**2 + scene.porous_way)
        at_corners = CORNER_PRESSURE * self._largest_jump / self.particle_spacing
        friction = "friction at walls" if domain.has_walls else "viscous friction in the fluid"
        return {
            "the body force": max(scene.largest_head(end, values) for values in self._settings),
            friction: viscosity * max(in_gaps, at_corners),
        }

    @cached_property
    def largest_head(self) -> float:
        """The largest of the heads [m2/s2]."""
        return max(self.heads.values())

    @cached_property
    def _largest_jump(self) -> float:
        """The largest change of the walls' velocity around the box within a spacing [m/s]."""
        domain = self._scene.domain
        points = {point.others: point for point in self.points}.values()
        largest = 0.0
        for place in self._beside_box(self.particle_spacing):
            of_walls = domain.distance_and_normal(place)[0] <= 0.0
            velocities = (self.flow(point).wall_velocity(place) for point in points)
            jumps = (np.diff(np.where(of_walls, v.T, np.nan)) for v in velocities)
            sizes = (float(np.nanmax(np.hypot.reduce(jump), initial=0.0)) for jump in jumps)
            largest = max(largest, *sizes)
        return largest * self._scene.largest_amplitude(self._time.final_time)

    @cached_property
    def longest_sound_period(self) -> float:
        """The period of the longest standing wave in the scene's box [s]."""
        return 2.0 * max(self._scene.domain.lengths) / self.sound_speed

    @cached_property
    def largest_viscosity(self) -> float:
        """The largest kinematic viscosity of training runs [m2/s]."""
        return max(map(self.kinematic_viscosity, self.train_points))

    def kinematic_viscosity(self, point: ParameterPoint) -> float:
        """Return nu [m2/s] at a parameter point."""
        return self._fluid.reference_speed * self._scene.length_scale / point.reynolds

    def fluid(self, point: ParameterPoint) -> Fluid:
        """Return the fluid at a parameter point."""
        return Fluid(
            reference_density=self._fluid.reference_density,
            sound_speed=self.sound_speed,
            kinematic_viscosity=self.kinematic_viscosity(point),
            max_speed=self.max_speed,
        )

    @cached_property
    def discretization(self) -> Discretization:
        """The parameters of the discretisation."""
        section = self._case.discretization
        return Discretization(
            particle_spacing=self.particle_spacing,
            smoothing_length=self.smoothing_length,
            diffusion_coefficient=section.diffusion_coefficient,
            acoustic_damping=section.acoustic_damping,
            viscosity="pair" if section.viscosity == "paper" else "laplacian",
            shifting=section.shifting.enabled,
            shifting_amplitude=section.shifting.amplitude,
            shifting_as_printed=section.shifting.form == "paper",
            shifting_transport=section.shifting.transport,
            fixed_volume=section.fixed_volume,
            pair_precision=section.pair_precision,
            wall_kind=section.walls.kind,
            free_slip=self._scene.free_slip,
            free_surface=self._scene.has_surface,
        )

    def flow(self, point: ParameterPoint) -> Scene:
        """Return the flow at a parameter point. Raises CaseError if there is none."""
        fluid = self._fluid
        viscosity = self.kinematic_viscosity(point)
        scales = Scales(fluid.reference_speed, fluid.reference_density, viscosity, point.factors)
        try:
            return self.scene.flow(scales)
        except ValueError as error:
            raise CaseError(f"scene: at {point.label}: {error}") from error

    @cached_property
    def rest_and_units(self) -> tuple[Scene, dict[str, Scene]]:
        """The undriven flow, and one flow per driving parameter with that parameter set to one.

        Raises CaseError if an expression has no value there.
        """
        point = self.train_points[0]
        names = self.driving

        def at(one: str | None) -> Scene:
            drives = {name: float(name == one) for name in names}
            others = tuple((name, drives.get(name, value)) for name, value in point.others)
            return self.flow(replace(point, others=others))

        try:
            return at(None), {name: at(name) for name in names}
        except CaseError as error:
            raise CaseError(f"parameters: operators need the flow at 0 and 1: {error}") from error

    def is_driven(self, point: ParameterPoint, *, after_start: bool = False) -> bool:
        """Return whether anything sets the fluid in motion in a full run at a parameter point.

        The initial state does not count `after_start`.
        """
        scene = self._scene
        flow = self.flow(point)
        if any(term.acceleration is not None for term in flow.terms):
            return True  # it may be any force
        domain = scene.domain
        place = grid_points(domain.lower, domain.upper, (N_PLACES,) * domain.n_dim)
        fluid = place[domain.contains(place)]
        if scene.has_surface and not math.isfinite(scene.level_at(point.factors)):
            return True  # a shape falls, or moves by its own pressure
        if not after_start and flow.initial_velocity(fluid).any():
            return True
        if not (after_start or scene.has_surface) and flow.initial_pressure(fluid).any():
            return True
        beside = np.concatenate((place, *self._beside_box(max(domain.lengths) / N_PLACES)))
        if domain.has_walls and flow.wall_velocity(beside).any():
            return True
        if (force := flow.body_force) is None:
            return False
        times = np.linspace(0.0, self._time.final_time, N_INSTANTS)
        weight = np.zeros((domain.n_dim, 1))
        weight[1] = scene.gravity
        return any((force(fluid.T, float(time)) + weight).any() for time in times)
