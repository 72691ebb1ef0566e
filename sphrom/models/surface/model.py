"""Models of flows with a free surface at any parameters, and their runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import write_record
from sphrom.artifacts.records.reduced_models import TrainedSurfaceModel
from sphrom.artifacts.records.runs import SurfaceErrorEstimate
from sphrom.case.measure_sections import ForceMeasure, RecordedMeasure, SurfaceMeasure
from sphrom.case.model_sections import ALL, ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.metrics.grids import grid_points
from sphrom.metrics.measures import (
    Probes,
    Quantities,
    Samples,
    combined,
    items,
    with_coefficients,
)
from sphrom.models.contract import (
    N_TIMED,
    SURFACE,
    Limit,
    Measured,
    Model,
    ModelRun,
    TrainedDifferences,
    best_name,
)
from sphrom.models.estimates import ErrorEstimate, measured_over_time, report_measured
from sphrom.models.starts import RunStarts, start
from sphrom.models.stored_run import ComputedRun
from sphrom.models.surface.errors import estimate, measured_errors
from sphrom.models.surface.stored import elevation_of, trained_size
from sphrom.plots.tables import format_figure
from sphrom.reduction.graph_model import GraphModel, GraphRun, calibrated_model
from sphrom.reduction.polynomial_model import OutputTimes
from sphrom.reduction.surface_basis import SLOPE_BEYOND_TRAINING, SurfaceBasis, TrainedGraph
from sphrom.setup.assembly import field_measures, run_attributes, uniform_force
from sphrom.sph.fluid import fluctuation_of
from sphrom.store.trajectory import field_datasets, force_datasets, write_positions
from sphrom.store.workspace import Workspace


@dataclass(frozen=True)
class SurfaceModelAt:
    """A model at a parameter point, with the start and the snapshots of its runs."""

    graph: GraphModel
    density: float
    """[kg/m3]"""
    start: Array
    """(n_modes + n_surface,)."""
    output_times: OutputTimes

    def run(self) -> GraphRun:
        """Run the model from its start."""
        return self.graph.run(self.output_times.time, self.start)

    def sampled(self, points: Array, time: Array, coordinates: Array) -> Samples:
        """Return velocity and pressure at points (n_points, 2) [m], zero above the surface."""
        wet = points[:, 1] <= self.graph.elevation(coordinates, points[:, 0])
        velocity = self.graph.velocity(coordinates, points)
        pressure = self.density * self.graph.pressure(time, coordinates, points)
        return Samples(time, np.where(wet[..., None], velocity, 0.0), np.where(wet, pressure, 0.0))


class SurfaceModel(Model[SurfaceModelAt]):
    """A trained model, with the number of modes in its section but without modes of noise."""

    def __init__(
        self,
        workspace: Workspace,
        section: ReducedModelSection,
        stored: TrainedSurfaceModel | tuple[SurfaceBasis, TrainedGraph] | None = None,
    ) -> None:
        """Take the model from the content of its file, or its basis and graph, if given."""
        known = None
        if isinstance(stored, TrainedSurfaceModel):
            self.basis = stored.basis
            self.trained = stored.graph
            known = stored.starts
        else:
            self.basis, self.trained = stored or trained_size(workspace, section)
        self.errors = self.trained.errors if section.is_calibrated else None
        """Those of training runs, from which errors of others are estimated."""
        sized = section.model_copy(update={"n_modes": self.trained.n_modes})
        super().__init__(workspace, sized)
        if known is None:
            self._starts = RunStarts(workspace, self.start_from)
        else:
            self._starts = RunStarts(
                workspace, self.start_from, known.parameters, known.coordinates
            )

    def at(self, point: ParameterPoint) -> SurfaceModelAt:
        """Return the model at a parameter point."""
        case = self.workspace.case
        plain = GraphModel(
            self.basis,
            depth=case.plan.depth(point),
            gravity=case.scene.gravity,
            viscosity=case.plan.kinematic_viscosity(point),
            force=uniform_force(case, point),
            longest_step=case.plan.longest_step(point),
        )
        graph = calibrated_model(plain, self.trained) if self.section.is_calibrated else plain
        steps = case.plan.model_steps(self.section)
        density = case.fluid.reference_density
        times = OutputTimes(steps.snapshot_interval, steps.n_snapshots, steps.start_time)
        return SurfaceModelAt(graph, density, self._starts.at(point), times)

    def start_from(self, begin: ParameterPoint) -> Array:
        """Return the coordinates of the state from which a run at a point starts."""
        case = self.workspace.case
        state = start(self.workspace, begin)
        columns = case.plan.surface_columns
        level = case.scene.level_at(begin.factors)
        elevation = np.full_like(columns, level)
        if case.time.spin_up > 0.0 or not math.isfinite(level):
            elevation = elevation_of(case, self.basis.space, columns)(
                state.position, state.density_fluctuation
            )
        coefficients, _ = self.basis.space.fit(state.position, state.velocity)
        return self.basis.project(coefficients[None], elevation[None])[0]

    def run(self, point: ParameterPoint, reduced: SurfaceModelAt | None = None) -> SurfaceRun:
        """Run the model at a parameter point; `reduced` may have other output times."""
        reduced = reduced or self.at(point)
        return self._run_of(point, reduced, reduced.run())

    def runner(self, point: ParameterPoint) -> Callable[[], object]:
        """Return a function that makes one run at a parameter point."""
        return self.at(point).run

    def trained_differences(self, points: Sequence[ParameterPoint]) -> list[TrainedDifferences]:
        """Return the errors of training runs that models of the others predict."""
        if self.errors is None:
            return []
        known = self.errors.held_out
        found = []
        for k, fields in enumerate(known.fields):
            measured = items({name: each.quantities for name, each in known.measure.items()}, k)
            # Differences contain all errors, those due to the basis too.
            missed = combined(items(measured, 0), items(measured, 0), -1.0)
            found.append(TrainedDifferences(measured, fields, missed))
        return found

    def nearest(self, point: ParameterPoint) -> SurfaceRun:
        """Return the states of the basis that are nearest to a full run's snapshots."""
        with self.workspace.open(self.workspace.mapped(point)) as mapped:
            states = self.basis.project(mapped.read("stream_function"), mapped.read("elevation"))
            return self._run_of(point, self.at(point), GraphRun(mapped.read("time"), states))

    def _run_of(self, point: ParameterPoint, reduced: SurfaceModelAt, run: GraphRun) -> SurfaceRun:
        interval = reduced.output_times.interval
        where = f"t = {run.end_time:.6g} s, x = {run.end_place:.4g} m"
        return SurfaceRun(
            model=self,
            point=point,
            reduced=reduced,
            time=run.times,
            coordinates=run.coordinates,
            time_step=interval / math.ceil(interval / reduced.graph.time_step),
            ended=None if run.ended is None else f"ended at {where}: {run.ended}",
        )


@dataclass(frozen=True, kw_only=True)
class SurfaceRun(ModelRun):
    """A run of a model; coordinates are (n_snapshots, n_modes + n_surface), as far as it went."""

    model: SurfaceModel
    reduced: SurfaceModelAt

    @cached_property
    def unlike_training(self) -> tuple[str, ...]:
        """A sentence on the steepness of the surface, if it is much steeper than in training."""
        graph = self.reduced.graph
        steepest = float(graph.steepness(self.coordinates).max(initial=0.0))
        factor = steepest / graph.basis.largest_slope
        if not factor > SLOPE_BEYOND_TRAINING:
            return ()
        return (f"its surface is up to {factor:.2g} times as steep as in training",)

    @property
    def kinetic_energy(self) -> Array:
        """The kinetic energy (n_snapshots,) [J/m]."""
        return self.reduced.density * self.reduced.graph.kinetic_energy(self.coordinates)

    @property
    def largest_speed(self) -> float:
        """The largest speed of all points and snapshots [m/s]."""
        graph = self.reduced.graph
        space = self.reduced.graph.basis.space
        lower, upper = (space.left, space.bottom), (space.right, space.top)
        points = grid_points(lower, upper, (space.n_rows, space.n_columns))
        speed = np.linalg.norm(graph.velocity(self.coordinates, points), axis=-1)
        wet = points[:, 1] <= graph.elevation(self.coordinates, points[:, 0])
        return float(np.max(speed, initial=0.0, where=wet))

    @cached_property
    def measured(self) -> dict[str, Quantities]:
        """All that the case measures, by name and quantity (n_snapshots, ...)."""
        return with_coefficients(self.recorded, self.model.workspace.case.plan.coefficients)

    @cached_property
    def recorded(self) -> dict[str, Quantities]:
        """The measurements without coefficients, as full runs record them."""
        recorded = self.model.workspace.case.scene.recorded
        return {name: self._measure(name, each) for name, each in recorded.items()}

    @property
    def amplitude(self) -> Array:
        """The amplitude of the waves (n_snapshots,) [m]."""
        return self.reduced.graph.amplitude(self.coordinates)

    @cached_property
    def estimate(self) -> ErrorEstimate | None:
        """The estimated errors of the run; None if there are no estimates."""
        return estimate(self)

    @cached_property
    def measured_errors(self) -> Mapping[str, Quantities]:
        """The estimated errors of all measurements (n_snapshots, ...); empty without estimates."""
        return measured_errors(self)

    def _measure(self, name: str, section: RecordedMeasure) -> Quantities:
        graph = self.reduced.graph
        state = self.coordinates
        density = self.reduced.density
        domain = self.model.workspace.case.scene.domain
        if isinstance(section, SurfaceMeasure):
            return section.of(self)
        if isinstance(section, ForceMeasure):
            lower, upper = np.array((domain.lower, domain.upper))
            centre = 0.5 * (lower + upper)
            force, torque = graph.wall_force(self.time, state, section.force_on, centre)
            return {"force": density * force, "torque": density * torque}
        measure = field_measures(self.model.workspace.case)[name]
        samples = self.sampled(measure.position)
        return measure.of(samples.velocity, samples.pressure)

    @property
    def potential_energy(self) -> Array:
        """The potential energy (n_snapshots,) [J/m]."""
        return self.reduced.density * self.reduced.graph.potential_energy(self.coordinates)

    @property
    def centre_of_mass(self) -> Array:
        """The centre of mass (n_snapshots, 2) [m]."""
        return self.reduced.graph.centre_of_mass(self.coordinates)

    def elevation_at(self, x: float) -> Array:
        """Return the height of the surface (n_snapshots,) [m] at a place [m]."""
        return self.reduced.graph.elevation(self.coordinates, np.array([x]))[:, 0]

    def sampled(self, points: Array) -> Samples:
        """Return velocity and pressure at points (n_points, 2) [m], zero above the surface."""
        return self.reduced.sampled(points, self.time, self.coordinates)


class StoredSurfaceRun(ComputedRun):
    """A stored run of a model."""

    @cached_property
    def _reduced(self) -> SurfaceModelAt:
        return SurfaceModel(self._workspace, self.model).at(self._point)

    @property
    def whole(self) -> Measured:
        """The elevation of the whole surface, as mapped snapshots have it."""
        return whole_surface(self._workspace, self._reduced, self.coordinates)

    def position(self, snapshot: int) -> Array:
        """Return the points of a lattice (n, 2) [m]."""
        case = self._workspace.case
        return case.scene.domain.fill(case.plan.particle_spacing)

    def state(self, snapshot: int) -> tuple[Array, Array]:
        """Return density fluctuation (n,) [kg/m3] and velocity (n, 2) [m/s] at these points."""
        samples = self.sampled(self.position(snapshot), [snapshot])
        sound_speed = self._workspace.case.plan.sound_speed
        return fluctuation_of(samples.pressure[0], sound_speed), samples.velocity[0]

    def sampled(
        self,
        points: Array,
        snapshots: Sequence[int] | None = None,
        advance: Callable[[int], None] = lambda done: None,
    ) -> Samples:
        """Return velocity and pressure at points (n_points, 2) [m], zero above the surface."""
        chosen = range(len(self.time)) if snapshots is None else snapshots
        return self._reduced.sampled(points, self.time[chosen], self.coordinates[chosen])


def whole_surface(workspace: Workspace, reduced: SurfaceModelAt, coordinates: Array) -> Measured:
    """Return the height y of the whole surface (n_snapshots, n_columns) [m]."""
    columns = workspace.case.plan.surface_columns
    return {SURFACE: {"elevation": reduced.graph.elevation(coordinates, columns)}}


def limits(
    workspace: Workspace,
    models: Sequence[ReducedModelSection],
    point: ParameterPoint,
    probes: Probes,
) -> Iterator[Limit]:
    """Yield the nearest states of each basis, and runs of models that are not calibrated."""
    runs: dict[str, SurfaceRun] = {}
    for section in models:
        model = SurfaceModel(workspace, section)
        runs[best_name(ALL, model.section.size)] = model.nearest(point)
        if section.is_calibrated:
            plain = SurfaceModel(workspace, section.model_copy(update={"calibrated": False}))
            runs[f"{section.name}, not calibrated"] = plain.run(point)
    for name, run in runs.items():
        samples = run.sampled(probes.all)
        size = run.model.section.size
        if run.failure is not None:
            yield Limit(name, samples, ALL, size, status="unstable")
            continue
        whole = whole_surface(workspace, run.reduced, run.coordinates)
        yield Limit(name, samples, ALL, size, {**run.measured, **whole})


def run_point(workspace: Workspace, section: ReducedModelSection, point: ParameterPoint) -> None:
    """Run a model at a parameter point, and write its artifact."""
    workspace.require(workspace.operators())
    target = workspace.reduced_run(section, point)
    report = workspace.context.report
    run, seconds = SurfaceModel(workspace, section).timed(point, N_TIMED)
    attributes = run_attributes(workspace.case, point, run.time_step)
    with workspace.create(target, attributes) as artifact:
        artifact.write("time", run.time)
        artifact.write("generalized_coordinates", run.coordinates)
        write_positions(artifact, field_measures(workspace.case))
        for name, each in run.measured.items():
            datasets = field_datasets({name: each})
            if "force" in each:  # fluid that slips has no friction
                datasets = force_datasets(name, np.stack([loads_of(each), 0.0 * loads_of(each)], 1))
            for path, values in datasets.items():
                artifact.write(path, values)
        artifact.annotate("status", "complete" if run.failure is None else "unstable")
        artifact.annotate("timing/integration", seconds)
        if (known := run.estimate) is not None:
            stored = SurfaceErrorEstimate(
                velocity=known.velocity,
                pressure=known.pressure,
                training="outside" if known.extrapolated else "inside",
                measure=measured_over_time(run),
            )
            write_record(artifact, stored, "error_estimate")
        if run.unlike_training:
            artifact.annotate("doubts", "\n".join(run.unlike_training))
        for doubt in run.unlike_training:
            report.warn(f"{run.name}: {doubt}")
        if run.failure is not None:
            artifact.annotate("status_detail", str(run.failure))
            report.warn(f"{run.name}: {run.failure}")
            return
    n_steps = round((run.time[-1] - run.time[0]) / run.time_step)
    report.info(f"{run.name}: {n_steps} steps of {run.time_step:.3g} s in {1e3 * seconds:.3g} ms")
    if (found := run.estimate) is not None:
        percents = found.velocity_percent, found.pressure_percent
        velocity, pressure = (f"{format_figure(each)} %" for each in percents)
        text = f"{run.name}: estimated errors: velocity {velocity}, pressure {pressure}"
        report.info("; ".join((text, *run.outside)))
        report_measured(run)


def loads_of(quantities: Quantities) -> Array:
    """Return force and torque as one array (n_snapshots, 3) [N/m, N]."""
    return np.column_stack((quantities["force"], quantities["torque"]))
