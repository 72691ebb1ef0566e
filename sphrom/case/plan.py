"""The plan of a case, `case.plan`: the quantities that follow from its keys, each computed once.

Lengths, speeds and limits of time steps follow from the scene and the discretization; points, bases
and reduced runs follow from the parameters. Each quantity is computed at its first use, so checks
of a case can use those that do not depend on a wrong key.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import shapely

from sphrom.arrays import Array, Mask
from sphrom.case.fields import LARGEST
from sphrom.case.points import REYNOLDS, ParameterPoint, Values, nearest_point
from sphrom.case.sections import ALL, AUTO, LOCAL, ReducedModelSection, SubsetSection
from sphrom.errors import CaseError
from sphrom.metrics.measures import Oscillating, Oscillations, grid_points, midpoints, since
from sphrom.metrics.series import settled_from
from sphrom.reduction.stream_functions import StreamSpace
from sphrom.scenes.flows import Scales, Scene
from sphrom.sph import fluid
from sphrom.sph.box_domain import BoxDomain
from sphrom.sph.fluid import Discretization, Fluid, StepLimits, Strip
from sphrom.sph.polygons import jutting_corners
from sphrom.sph.time_loop import TimeSteps

if TYPE_CHECKING:
    from sphrom.case.models import Case
    from sphrom.case.scene_section import SceneSection

MOST_COLUMNS, ROWS_OF_FLUID, LEAST_CELL = 16, 9, 2
"""Of a tank's splines: cells along it, along the depth, and the least size over the spacing."""
COLUMNS_A_CELL = 4
"""Columns where the surface is looked for, in each cell of the splines."""
N_LINES = 201
"""Lines tried where a solid covers the usual one."""
N_INSTANTS, N_PLACES = 50, 50
"""Times of a run, and places along each axis, at which the driving of the fluid is looked at."""
HIGHEST_CREST = 1.6
"""The height of the splines' box over the depth."""
MOST_TRIED = 12
"""The largest number of modes that `n_modes: auto` tries where the fluid has a free surface."""
SURFACE_CHANGE = 0.01
"""Largest relative change of the density by the fluid's weight, if there is a free surface."""
DENSITY_CHANGE = 0.03
"""Largest relative change of the density by the body force or by friction at walls."""
CORNER_PRESSURE = 2.5
"""Largest pressure over mu U / r, at a distance r from where walls slide apart (Taylor 1962)."""
BEYOND = 1e-6
"""Distance beyond walls at which their velocity is evaluated, over the spacing."""
MLS_SMOOTHING_LENGTH_RATIO = 2.0
"""Smoothing length of moving least squares over the spacing; they need no wider support."""
MODES_WITHOUT_ROM = 10
"""Number of modes to keep without reduced models."""
MOST_CHOSEN = 20
"""Number of modes to keep when a reduced model chooses its number."""
STEPS_PER_PERIOD = 20
"""Fewest steps in a period of the driving; fewer take an oscillation for a slower one."""
N_DRIVING = 1000
"""Number of times of a run at which the driving is sampled."""
MAX_STEPS = 1e9
"""Number of steps of one run beyond which a case is taken for a typing error."""
WHOLE_STEPS_TOLERANCE = 1e-6
"""Relative tolerance for a duration to be a whole number of steps."""
LARGEST_DENOMINATOR = 1000
"""Largest denominator of spin-up over recorded time, so that one automatic step fits both."""
LEAST_SNAPSHOTS = 3
"""Fewest snapshots per training run for a calibration."""
MOST_ESTIMATED_MODES = 30
"""Largest basis with error estimates by default; their work grows with its fourth power."""


class Plan:
    """The quantities that follow from the keys of one case."""

    def __init__(self, case: Case) -> None:
        self._case = case

    @cached_property
    def scene(self) -> SceneSection:
        """The scene with the strip and the checks that fit all points and the particles."""
        end = self._case.time.final_time
        return self._case.scene.over(self._settings, self.particle_spacing, end)

    # Lengths, speeds and particles

    @cached_property
    def particle_spacing(self) -> float:
        """dx [m], the square root of the area of a particle."""
        wanted = self._case.scene.resolved_length / self._case.discretization.resolution
        return self._case.scene.domain.lattice_spacing(wanted)

    @cached_property
    def smoothing_length(self) -> float:
        """h [m]."""
        return self._case.discretization.smoothing_length_ratio * self.particle_spacing

    @cached_property
    def reference_smoothing_length(self) -> float:
        """h of the map onto the reference space [m]."""
        section = self._case.reference
        own = self._case.discretization.smoothing_length_ratio
        usual = MLS_SMOOTHING_LENGTH_RATIO if section.method == "mls" else own
        return (section.smoothing_length_ratio or usual) * self.particle_spacing

    @cached_property
    def n_particles(self) -> int:
        """The number of fluid particles; with a free surface, the largest of all points."""
        scene = self._case.scene
        if scene.has_surface:
            return max(len(scene.fill(self.particle_spacing, v)) for v in self._settings)
        return scene.domain.n_particles(self.particle_spacing)

    @cached_property
    def n_ghosts(self) -> int:
        """The number of ghost particles of the scene's walls."""
        return self._case.scene.domain.n_ghosts(self.particle_spacing, self.n_wall_layers)

    @cached_property
    def n_wall_layers(self) -> int:
        """Layers of ghosts behind walls, by default as far as the kernel reaches."""
        return self._case.discretization.walls.layers or self.discretization.n_layers

    @cached_property
    def walls_fit_lattice(self) -> bool:
        """Whether all walls of the scene lie along the axes, so that a lattice fits them."""
        domain = self._case.scene.domain
        return isinstance(domain, BoxDomain) and domain.has_walls

    @cached_property
    def packed(self) -> bool:
        """Whether particles start packed rather than on a lattice."""
        asked = self._case.discretization.initial_particles
        if self._case.scene.has_surface:
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
        return self.reference_lattice and self._case.scene.domain.fills_box

    @cached_property
    def separate_mean_density(self) -> bool:
        """Whether the mean density fluctuation is a variable apart from the basis."""
        basis = self._case.basis
        if basis.mean_density != "auto":
            return basis.mean_density == "separate"
        walled = not any(self._case.scene.domain.periodic)
        steady = walled or self._case.discretization.fixed_volume
        return steady and basis.inner_product == "acoustic"

    @cached_property
    def probe_line(self) -> float:
        """x of the vertical line on which runs are compared [m]."""
        scene = self._case.scene
        line = self._case.compare.line
        if line is not None or scene.domain.sections(scene.probe_line):
            return scene.probe_line if line is None else line
        places = np.linspace(scene.domain.lower[0], scene.domain.upper[0], N_LINES)
        nearest = sorted(places.tolist(), key=lambda x: abs(x - scene.probe_line))
        return next((x for x in nearest if scene.domain.sections(x)), scene.probe_line)

    @cached_property
    def max_speed(self) -> float:
        """The largest speed at all points: the reference speed, or the speed of a varied wall."""
        scene = self.scene
        end = self._case.time.final_time
        varied = (v for v in self._settings if v or scene.amplitudes)
        walls = (scene.largest_wall_speed(v, end) for v in varied)
        fastest = max(self._case.fluid.reference_speed, *walls, 0.0)
        if not fastest <= LARGEST:
            raise CaseError(f"scene: walls or the inflow have a speed of {fastest:g} m/s; lower it")
        return fastest

    @cached_property
    def sound_speed(self) -> float:
        """c0 [m/s], the same at all points: from the Mach number, or larger for large heads."""
        change = SURFACE_CHANGE if self._case.scene.has_surface else DENSITY_CHANGE
        least = math.sqrt(self.largest_head / change)
        return max(self.max_speed / self._case.fluid.mach_number, least)

    @cached_property
    def heads(self) -> dict[str, float]:
        """Estimates of the largest heads of all runs [m2/s2], by their cause in words."""
        scene = self._case.scene
        end = self._case.time.final_time
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
        domain = self._case.scene.domain
        dx = self.particle_spacing
        edge = shapely.box(*domain.lower, *domain.upper).buffer(BEYOND * dx, join_style="mitre")
        place = shapely.get_coordinates(shapely.segmentize(edge.exterior, dx))
        of_walls = domain.distance_and_normal(place)[0] <= 0.0
        points = {point.others: point for point in self.points}.values()
        velocities = (self.flow(point).wall_velocity(place) for point in points)
        jumps = (np.diff(np.where(of_walls, v.T, np.nan)) for v in velocities)
        largest = max(float(np.nanmax(np.hypot(*jump), initial=0.0)) for jump in jumps)
        return largest * self._case.scene.largest_amplitude(self._case.time.final_time)

    @cached_property
    def mass(self) -> float:
        """The mass of a particle, per metre of depth [kg/m]."""
        return self._case.fluid.reference_density * self.particle_spacing**2

    @cached_property
    def longest_sound_period(self) -> float:
        """The period of the longest standing wave in the scene's box [s]."""
        return 2.0 * max(self._case.scene.domain.lengths) / self.sound_speed

    @cached_property
    def largest_viscosity(self) -> float:
        """The largest kinematic viscosity of training runs [m2/s]."""
        return max(map(self.kinematic_viscosity, self.train_points))

    def kinematic_viscosity(self, point: ParameterPoint) -> float:
        """Return nu [m2/s] at a parameter point."""
        return self._case.fluid.reference_speed * self._case.scene.length_scale / point.reynolds

    # Records of the numerics

    def fluid(self, point: ParameterPoint) -> Fluid:
        """Return the fluid at a parameter point."""
        return Fluid(
            reference_density=self._case.fluid.reference_density,
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
            no_slip="free" if self._case.scene.free_slip else section.walls.no_slip,
            wall_continuity=section.walls.continuity,
            free_surface=self._case.scene.has_surface,
        )

    def depth(self, point: ParameterPoint) -> float:
        """Return the mean depth of fluid with a free surface at a parameter point [m]."""
        scene = self._case.scene
        values = point.factors
        if math.isfinite(level := scene.level_at(values)):
            return level - scene.domain.lower[1]
        area = len(scene.fill(self.particle_spacing, values)) * self.particle_spacing**2
        return area / scene.domain.lengths[0]

    @cached_property
    def stream_space(self) -> StreamSpace:
        """The splines of stream functions in a tank, the same for all runs.

        Their rows resolve the shallowest fluid, and their box holds crests above the deepest.
        """
        domain = self._case.scene.domain
        depths = [self.depth(point) for point in self.points]
        left, bottom, right, top = (*domain.lower, *domain.upper)
        height = min((right - left) / MOST_COLUMNS, min(depths) / ROWS_OF_FLUID)
        n_rows = math.ceil(min(top - bottom, HIGHEST_CREST * max(depths)) / height)
        n_columns = int((right - left) / (LEAST_CELL * self.particle_spacing))
        return StreamSpace(
            left=left,
            right=right,
            bottom=bottom,
            top=min(top, bottom + n_rows * height),
            n_columns=min(MOST_COLUMNS, n_columns),
            n_rows=n_rows,
        )

    @property
    def map_settings(self) -> dict[str, object]:
        """What maps of full runs depend on, besides keys of the case."""
        return {"space": vars(self.stream_space)} if self._case.scene.has_surface else {}

    @property
    def relaxed_points(self) -> bool:
        """Whether the points of the reference space are the last particles of a full run."""
        return self._case.reference.points == "relaxed" and not self._case.scene.has_surface

    @cached_property
    def surface_columns(self) -> Array:
        """The midpoints (n_columns,) [m] of the columns where surfaces are looked for."""
        space = self.stream_space
        return midpoints(space.left, space.right, COLUMNS_A_CELL * space.n_columns)

    @property
    def with_weight(self) -> bool:
        """Whether pressures have a hydrostatic part, which is no flow, and places may fall dry."""
        return self._case.scene.has_surface

    def weight_at(self, point: ParameterPoint, position: Array) -> Array | None:
        """Return the pressure at rest (n_positions,) [Pa] below a level; None without a surface."""
        scene = self._case.scene
        if not scene.has_surface:
            return None
        level = scene.domain.lower[1] + self.depth(point)
        return self._case.fluid.reference_density * scene.gravity * (level - position[:, 1])

    def flow(self, point: ParameterPoint) -> Scene:
        """Return the flow at a parameter point. Raises CaseError if there is none."""
        fluid = self._case.fluid
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

    def is_driven(self, point: ParameterPoint) -> bool:
        """Return whether anything sets the fluid in motion in a full run at a parameter point."""
        scene = self._case.scene
        flow = self.flow(point)
        domain = self._case.scene.domain
        place = grid_points(domain.lower, domain.upper, (N_PLACES, N_PLACES))
        fluid = place[domain.contains(place)]
        level = scene.level_at(point.factors)
        if scene.has_surface and not math.isfinite(level):
            return True  # a shape falls, or moves by its own pressure
        if flow.initial_velocity(fluid).any():
            return True
        if not scene.has_surface and flow.initial_pressure(fluid).any():
            return True
        box = shapely.box(*domain.lower, *domain.upper).buffer(BEYOND * self.particle_spacing)
        edge = shapely.segmentize(box.exterior, max(domain.lengths) / N_PLACES)
        beside = np.concatenate((place, shapely.get_coordinates(edge)))
        if domain.has_walls and flow.wall_velocity(beside).any():
            return True
        if (force := flow.body_force) is None:
            return False
        times = np.linspace(0.0, self._case.time.final_time, N_INSTANTS)
        weight = np.array([[0.0], [scene.gravity]])
        return any((force(fluid.T, float(time)) + weight).any() for time in times)

    def problems_until(self, end: float) -> Iterator[tuple[str, str]]:
        """Yield keys of the scene that don't allow runs until a time [s], with reasons."""
        return self.scene.problems(end, self.fluid(self.points[0]))

    @cached_property
    def strip(self) -> Strip | None:
        """The strip of the inflow; None without an inflow."""
        return self.scene.strip

    # Time steps, their limits, and snapshots

    def step_limits(self, point: ParameterPoint) -> StepLimits:
        """Return the largest stable time steps at a parameter point."""
        scene = self.scene
        sharpness = self._sharpest_corner
        slowing = scene.largest_resistance(self.kinematic_viscosity(point))
        return fluid.step_limits(
            self.fluid(point), self.discretization, scene.domain.has_walls, sharpness, slowing
        )

    @cached_property
    def _sharpest_corner(self) -> float:
        """The sharpness of the sharpest corner that points into the fluid, 0 without corners."""
        domain = self._case.scene.domain
        sharpness = jutting_corners(domain.fluid_with_images, self.particle_spacing)[1]
        return float(sharpness.max(initial=0.0))

    @cached_property
    def limits(self) -> StepLimits:
        """The largest time steps that are stable at every point of the case."""
        return self.step_limits(min(self.points, key=lambda point: point.reynolds))

    @cached_property
    def recorded_time(self) -> float:
        """The recorded time of a run [s]."""
        return self._case.time.final_time - self._case.time.spin_up

    @cached_property
    def step_target(self) -> float:
        """The time step of the case [s], before it is adjusted to fit the durations.

        The automatic step is the same share of all limits.
        """
        time = self._case.time
        if time.step != "auto":
            return time.step
        share = time.courant_number / fluid.COURANT_LIMIT
        return min(share * self.limits.least, self.shortest_period / STEPS_PER_PERIOD)

    @cached_property
    def shortest_period(self) -> float:
        """The shortest period of the driving at all points [s]; infinite if none oscillates."""
        return self.scene.shortest_period(self._settings)

    def longest_step(self, point: ParameterPoint) -> float:
        """Return the longest step [s] that resolves the driving at a point, infinite if steady."""
        return self.scene.shortest_period([point.factors]) / STEPS_PER_PERIOD

    @cached_property
    def spin_up_ratio(self) -> Fraction:
        """The spin-up over the recorded time, or the nearest ratio that whole steps allow."""
        ratio = Fraction(self._case.time.spin_up / self.recorded_time)
        return ratio.limit_denominator(LARGEST_DENOMINATOR)

    @cached_property
    def steps(self) -> TimeSteps:
        """The steps of all full runs, the same at all points so that snapshots coincide.

        An automatic step is shortened: snapshots begin after the spin-up, and end with the run.
        """
        every = self._case.snapshots.every
        step = self._case.time.step
        if step != "auto":
            n_spin_up_steps = round(self._case.time.spin_up / step)
            n_steps = max(1, round(self.recorded_time / step))
            return TimeSteps(step, n_steps, every, n_spin_up_steps * step)
        ratio = self.spin_up_ratio
        unit = math.lcm(every, ratio.denominator)
        steps = self.recorded_time / self.step_target
        n_steps = unit * math.ceil(steps * (1.0 - WHOLE_STEPS_TOLERANCE) / unit)
        step = self.recorded_time / n_steps
        return TimeSteps(step, n_steps, every, int(ratio * n_steps) * step)

    # Measurements

    @cached_property
    def settled_from(self) -> float:
        """The time after the gradual start of the driving [s]; 0 without one."""
        times = np.linspace(0.0, self._case.time.final_time, N_DRIVING)
        with np.errstate(all="ignore"):  # a check refuses amplitudes that are not finite
            found = [settled_from(times, self.flow(p).driving(times)) for p in self.points]
        return max(self._case.scene.ramp, *found)

    @cached_property
    def means_from(self) -> dict[str, float]:
        """The times from which statistics of recorded measurements count [s], by name."""
        own = {name: each.from_time for name, each in self._case.scene.recorded.items()}
        return {name: self.settled_from if t is None else t for name, t in own.items()}

    @property
    def times_in_words(self) -> str:
        """The times from which measurements count, in words; empty if all count from the start."""
        late = sorted({t for t in self.means_from.values() if t > 0.0})
        names = {t: ", ".join(n for n, own in self.means_from.items() if own == t) for t in late}
        times = " and ".join(f"from {t:.4g} s on ({names[t]})" for t in late)
        return times and f"means and errors of measurements count {times}"

    def counted(self, name: str, time: Array) -> Mask:
        """Return whether times (n_snapshots,) [s] count for a measurement of a run."""
        return since(time, self.means_from.get(name, self.settled_from))

    @cached_property
    def oscillations(self) -> Oscillations:
        """The oscillating quantities, by the names of the measurements of their frequency."""
        columns = self._case.scene.columns
        found = Oscillations()
        for name, measure in self._case.scene.measure.items():
            if (section := measure.frequency) is not None:
                column = columns[section.of]
                begin = section.from_time
                begin = self.means_from[column.measure] if begin is None else begin
                found[name] = Oscillating(**vars(column), from_time=begin)
        return found

    @cached_property
    def coefficients(self) -> dict[str, float]:
        """The ratios of coefficients to forces [m/N], by the names of the measurements."""
        density = self._case.fluid.reference_density
        measures = self._case.scene.measure
        scales = ((name, each.coefficient) for name, each in measures.items())
        return {n: 2.0 / (density * c.speed**2 * c.length) for n, c in scales if c is not None}

    def model_steps(self, model: ReducedModelSection) -> TimeSteps:
        """Return the steps of full runs that end when the runs of a reduced model end.

        Raises CaseError when `lengthened` does not allow the model's final time.
        """
        return self.steps if model.until is None else lengthened(self.steps, model.until)

    def ends_with_case(self, model: ReducedModelSection) -> bool:
        """Return whether a model's runs end with the full runs, so that they can be compared."""
        return self.model_steps(model) == self.steps

    def compared_at(self, point: ParameterPoint) -> list[ReducedModelSection]:
        """Return the reduced models whose runs at a point are compared with the full run."""
        models = filter(self.ends_with_case, self._case.rom)
        return [model for model in models if point in self.rom_points(model)]

    # Parameter points

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """The names of the parameters of all points, the Reynolds number first."""
        section = self._case.parameters
        return tuple(dict.fromkeys((REYNOLDS, *section.train.names, *section.test.names)))

    @cached_property
    def driving(self) -> tuple[str, ...]:
        """The parameters that move walls or scale the body force; operators have a part of each."""
        return self._case.scene.driving(self.parameter_names[1:])

    @cached_property
    def own_values(self) -> dict[str, float]:
        """The scene's own values of parameters, with the Reynolds number if training has one."""
        reynolds = self._case.parameters.train.own_reynolds
        own = {} if reynolds is None else {REYNOLDS: reynolds}
        return own | self._case.scene.parameters(self._case.fluid.reference_speed)

    @cached_property
    def usual_values(self) -> dict[str, float]:
        """The values that all training runs have in common; of other parameters, the scene's own.

        Points have these values of all parameters that they do not name.
        """
        rows = [point.as_dict() for point in self.train_points]
        common = {n: v for n, v in rows[0].items() if all(row[n] == v for row in rows)}
        return self.own_values | common

    def point(self, values: Values, usual: Mapping[str, float] | None = None) -> ParameterPoint:
        """Return the point with values by name; missing ones are the `usual_values`.

        Raises CaseError when the Reynolds number is missing, and training runs have several.
        """
        named = values if isinstance(values, dict) else {REYNOLDS: values}
        known = {**(self.usual_values if usual is None else usual), **named}
        if REYNOLDS not in known:
            missing = f"{REYNOLDS}: is missing, and training runs have several"
            raise CaseError(f"{missing}; give its value, such as {REYNOLDS}=100")
        reynolds, *others = [float(known.get(name, 0.0)) for name in self.parameter_names]
        names = self.parameter_names[1:]
        return ParameterPoint(reynolds, tuple(zip(names, others, strict=True)))

    @cached_property
    def train_points(self) -> tuple[ParameterPoint, ...]:
        """The points of training runs; they have the scene's own values of unnamed parameters."""
        rows = self._case.parameters.train.values
        return tuple(self.point(row, self.own_values) for row in rows)

    @cached_property
    def test_points(self) -> tuple[ParameterPoint, ...]:
        """The points of test runs, which only check predictions."""
        return tuple(map(self.point, self._case.parameters.test.values))

    @cached_property
    def points(self) -> tuple[ParameterPoint, ...]:
        """All points of full runs."""
        return self.train_points + self.test_points

    @cached_property
    def _settings(self) -> list[dict[str, float]]:
        """The values of all parameters except the Reynolds number, each combination once."""
        return [dict(others) for others in dict.fromkeys(point.others for point in self.points)]

    def start_point(self, point: ParameterPoint) -> ParameterPoint:
        """Return the point whose initial state a run has.

        Points of full runs have a spin-up of their own; others use that of the nearest training
        run. Without a spin-up, each point starts from the initial conditions of the scene.
        """
        if self._case.time.spin_up == 0.0 or point in self.points:
            return point
        return nearest_point(point, self.train_points)

    # Bases

    @cached_property
    def bases(self) -> dict[str, tuple[ParameterPoint, ...]]:
        """The training points of each basis, by name."""
        subsets = self._case.basis.subsets
        return {ALL: self.train_points, **{n: self._training_points(s) for n, s in subsets.items()}}

    def _training_points(self, subset: SubsetSection) -> tuple[ParameterPoint, ...]:
        """Return the training points of a subset, including listed ones without a full run."""
        trained = self.train_points
        if subset.box is not None:
            bounds = subset.bounds.items()
            rows = zip(trained, (point.as_dict() for point in trained), strict=True)
            return tuple(p for p, row in rows if all(a <= row[n] <= b for n, (a, b) in bounds))
        values = subset.reynolds or ()
        if len(self.parameter_names) == 1:
            return tuple(map(ParameterPoint, values))
        return tuple(point for point in trained if point.reynolds in values)

    def local_bases(self, point: ParameterPoint) -> list[str]:
        """Return the subsets whose boxes contain a point.

        Intervals are half-open, [low, high); only those with the highest end include their end.
        """
        boxes = {name: subset.bounds for name, subset in self._case.basis.subsets.items()}
        ends = (end for bounds in boxes.values() for end in bounds.items())
        # In sorted order, the highest end of each name comes last.
        top = dict(sorted((name, high) for name, (low, high) in ends if low < high))
        at = point.as_dict()
        return [
            subset
            for subset, bounds in boxes.items()
            if all(
                low <= at[name] < high or low < at[name] == high == top[name]
                for name, (low, high) in bounds.items()
            )
        ]

    @cached_property
    def largest_values(self) -> Array:
        """The largest absolute trained value of each parameter (n_parameters,)."""
        return np.abs([[*p.as_dict().values()] for p in self.train_points]).max(axis=0)

    @cached_property
    def n_modes(self) -> int:
        """Number of modes to keep of each basis, unless it has fewer snapshots."""
        asked = (MOST_CHOSEN if m.n_modes == AUTO else m.size for m in self._case.rom)
        return self._case.basis.n_modes or max(asked, default=MODES_WITHOUT_ROM)

    def basis_size(self, name: str) -> int:
        """Return the number of modes of a basis, which is limited by its snapshots."""
        return min(self.n_modes, self.n_basis_snapshots(name))

    def n_basis_snapshots(self, name: str) -> int:
        """Return the number of training snapshots of a basis."""
        return len(self.bases[name]) * self.steps.n_snapshots

    def has_error_estimate(self, name: str) -> bool:
        """Return whether the errors of a basis's models on the reference points are estimated."""
        if self._case.scene.has_surface:
            return False
        wanted = self._case.operators.error_estimate
        if wanted == "auto":
            return self.basis_size(name) <= MOST_ESTIMATED_MODES
        return wanted

    # Reduced runs

    def family(self, model: ReducedModelSection | None = None) -> str:
        """Return the name of a reduced model's family; without one, that of the case's stages."""
        if self._case.scene.has_surface:
            return "surface"
        return "points" if model is None or model.from_operators else "particles"

    def rom_points(self, model: ReducedModelSection) -> tuple[ParameterPoint, ...]:
        """Return the points at which a reduced model is run."""
        if not isinstance(model.parameters, str):
            return tuple(map(self.point, model.parameters))
        named = {"all": self.points, "train": self.train_points, "test": self.test_points}
        return named[model.parameters]

    def basis_for(self, model: ReducedModelSection, point: ParameterPoint) -> str:
        """Return the name of the basis that a reduced model uses at a parameter point.

        Raises CaseError unless a model with a local basis has exactly one there.
        """
        if model.basis != LOCAL:
            return model.basis
        names = self.local_bases(point)
        if len(names) != 1:
            where = f"the intervals of {' and '.join(names)}" if names else "no subset's interval"
            raise CaseError(f"{point.label} lies in {where}, so it has no unique local basis")
        return names[0]

    def bases_for(self, model: ReducedModelSection) -> list[str]:
        """Return the names of the bases that a reduced model uses at its points, each once."""
        return list(dict.fromkeys(self.basis_for(model, point) for point in self.rom_points(model)))

    def is_corrected(self, model: ReducedModelSection, basis: str) -> bool:
        """Return whether training runs correct a model's coordinates in a basis."""
        if model.corrected == "auto":
            several = len(self.bases[basis]) > 1
            return model.from_operators and several and not model.settles_on_cycles
        return model.corrected

    @cached_property
    def _used(self) -> list[tuple[ReducedModelSection, str]]:
        """All pairs of a reduced model and a basis that it uses."""
        return [(model, basis) for model in self._case.rom for basis in self.bases_for(model)]

    @cached_property
    def reference_bases(self) -> tuple[str, ...]:
        """The names of the bases of models on the reference points."""
        return self._in_order(basis for model, basis in self._used if model.from_operators)

    @cached_property
    def models_by_speed(self) -> tuple[ReducedModelSection, ...]:
        """The reduced models, with those of the faster kind first."""
        return tuple(sorted(self._case.rom, key=lambda model: not model.from_operators))

    @cached_property
    def memory_models(self) -> tuple[tuple[str, int], ...]:
        """The basis and number of modes of all APG models on the reference points, each once."""
        pairs = {
            (basis, model.size)
            for model, basis in self._used
            if model.from_operators and model.has_memory and model.n_modes != AUTO
        }
        return tuple(sorted(pairs))

    @cached_property
    def corrected_bases(self) -> tuple[str, ...]:
        """The names of the bases with a model that their training runs calibrate or correct.

        With measured forces these are all bases on the reference points: forces need them too.
        """
        if self._case.scene.measured_walls:
            return self.reference_bases
        return self._in_order(
            basis
            for model, basis in self._used
            if model.is_calibrated or self.is_corrected(model, basis)
        )

    @cached_property
    def surface_sizes(self) -> tuple[int, ...]:
        """The numbers of modes of models with a free surface, which are trained."""
        models = [m for m in self._case.rom if m.from_operators] * self._case.scene.has_surface
        auto = range(2, min(self.basis_size(ALL), MOST_TRIED) + 1)
        asked = (auto if model.n_modes == AUTO else (model.size,) for model in models)
        return tuple(sorted({size for sizes in asked for size in sizes}))

    @cached_property
    def sized_bases(self) -> tuple[str, ...]:
        """The names of the bases with a model whose number of modes their training runs choose."""
        return self._in_order(basis for model, basis in self._used if model.n_modes == AUTO)

    def _in_order(self, used: Iterable[str]) -> tuple[str, ...]:
        names = set(used)
        return tuple(name for name in self.bases if name in names)


def lengthened(steps: TimeSteps, final_time: float) -> TimeSteps:
    """Return steps with the last snapshot at another time [s], earlier or later.

    Raises CaseError unless this is a whole number of snapshot intervals after the first snapshot.
    """
    intervals = (final_time - steps.start_time) / steps.snapshot_interval
    whole = round(intervals) if 0.5 <= intervals <= MAX_STEPS / steps.every else 0
    if not whole or abs(intervals - whole) > WHOLE_STEPS_TOLERANCE * whole:
        nearest = steps.start_time + max(1, whole) * steps.snapshot_interval
        raise CaseError(
            f"final_time: must be a whole number of snapshot intervals of "
            f"{steps.snapshot_interval:.12g} s after {steps.start_time:g} s, and at most "
            f"{MAX_STEPS:g} steps; the nearest is {nearest:.12g}; got {final_time:g}"
        )
    return replace(steps, n_steps=whole * steps.every)
