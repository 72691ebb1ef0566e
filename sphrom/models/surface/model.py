"""Models of flows with a free surface at any parameters, and their runs.

`SurfaceModel` and `SurfaceRun` have the members of `FastModel` and `FastRun`. They have no estimates
of errors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sphrom.arrays import Array
from sphrom.case.hints import beyond_training, extrapolation
from sphrom.case.points import ParameterPoint
from sphrom.case.scene_section import MeasureSection
from sphrom.case.sections import ALL, ReducedModelSection
from sphrom.errors import UnstableError
from sphrom.machine import seconds_of
from sphrom.metrics.measures import Quantities, Samples, grid_points, with_coefficients
from sphrom.reduction.graph_model import GraphRun
from sphrom.setup.assembly import field_measures, run_attributes
from sphrom.sph.fluid import ROUNDING
from sphrom.store.surfaces import SurfaceModelAt, TrainedSurface
from sphrom.store.trajectory import field_datasets, force_datasets, write_positions
from sphrom.store.workspace import Workspace

N_TIMED = 5
"""Repetitions of a run, to time it."""


class SurfaceModel(TrainedSurface):
    """One model of a flow with a free surface: built and run at any parameters."""

    def basis_at(self, point: ParameterPoint) -> str:
        """Return the name of the model's basis."""
        return ALL

    def run(self, point: ParameterPoint, reduced: SurfaceModelAt | None = None) -> SurfaceRun:
        """Run the model at a parameter point; `reduced` may have other output times."""
        reduced = reduced or self.at(point)
        return SurfaceRun(self, point, reduced, reduced.run())

    def timed(self, point: ParameterPoint, repeats: int) -> tuple[SurfaceRun, float]:
        """Return a run, and the least time that some took [s]."""
        reduced = self.at(point)
        run = self.run(point, reduced)
        return run, min(seconds_of(reduced.run) for _ in range(repeats))

    def runner(self, point: ParameterPoint) -> Callable[[], object]:
        """Return what makes one run at a parameter point, to be timed."""
        return self.at(point).run

    def nearest(self, point: ParameterPoint) -> SurfaceRun:
        """Return the states of the basis that are nearest to a full run's snapshots."""
        with self.workspace.open(self.workspace.mapped(point)) as mapped:
            fields = mapped.read("stream_function"), mapped.read("elevation")
            time = mapped.read("time")
        states = self.basis.project(*fields)
        return SurfaceRun(self, point, self.at(point), GraphRun(time, states))

    def trained_differences(
        self, points: Sequence[ParameterPoint]
    ) -> list[tuple[Array, dict[str, Quantities]]]:
        """Return nothing: there are no estimates of errors."""
        return []


@dataclass(frozen=True)
class SurfaceRun:
    """A run of a model, and the model that made it."""

    model: SurfaceModel
    point: ParameterPoint
    reduced: SurfaceModelAt
    graph_run: GraphRun

    correction = estimate = None

    @property
    def name(self) -> str:
        """The model and the point, as messages name them."""
        return f"{self.model.section.name}, {self.point.label}"

    @property
    def time(self) -> Array:
        """(n_snapshots,) [s], as far as the run went."""
        return self.graph_run.times

    @property
    def coordinates(self) -> Array:
        """(n_snapshots, n_modes + n_surface)."""
        return self.graph_run.coordinates

    @property
    def time_step(self) -> float:
        """[s]."""
        interval = self.reduced.output_times.interval
        return interval / math.ceil(interval / self.reduced.graph.time_step)

    @property
    def failure(self) -> UnstableError | None:
        """Why the run ended early; None where it didn't."""
        run = self.graph_run
        if run.ended is None:
            return None
        return UnstableError(
            f"ended at t = {run.end_time:.6g} s, x = {run.end_place:.4g} m: {run.ended}"
        )

    @property
    def _density(self) -> float:
        return self.model.workspace.case.fluid.reference_density

    @property
    def kinetic_energy(self) -> Array:
        """The kinetic energy (n_snapshots,) [J/m]."""
        return self._density * self.reduced.graph.kinetic_energy(self.coordinates)

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
        case = self.model.workspace.case
        measured = {name: self._measure(name, each) for name, each in case.scene.recorded.items()}
        return with_coefficients(measured, case.plan.coefficients)

    def _measure(self, name: str, section: MeasureSection) -> Quantities:
        graph = self.reduced.graph
        state = self.coordinates
        density = self._density
        domain = self.model.workspace.case.scene.domain
        if section.elevation is not None:
            return {"elevation": graph.elevation(state, np.array([section.elevation]))[:, 0]}
        if section.of_fluid == "energy":
            potential = density * graph.potential_energy(state)
            return {"kinetic_energy": self.kinetic_energy, "potential_energy": potential}
        if section.of_fluid is not None:
            return {"centre_of_mass": graph.centre_of_mass(state)}
        if section.force_on is not None:
            lower, upper = np.array((domain.lower, domain.upper))
            centre = 0.5 * (lower + upper)
            force, torque = graph.wall_force(self.time, state, section.force_on, centre)
            return {"force": density * force, "torque": density * torque}
        measure = field_measures(self.model.workspace.case)[name]
        samples = self.sampled(measure.position)
        return measure.of(samples.velocity, samples.pressure)

    @property
    def elevation(self) -> Array:
        """The height y of the surface (n_snapshots, n_columns) [m], as mapped snapshots have it."""
        columns = self.model.workspace.case.plan.surface_columns
        return self.reduced.graph.elevation(self.coordinates, columns)

    def sampled(self, points: Array) -> Samples:
        """Return velocity and pressure at points (n_points, 2) [m], zero above the surface."""
        return self.reduced.sampled(points, self.time, self.coordinates)

    @cached_property
    def outside(self) -> tuple[str, ...]:
        """Warnings of a run outside of the trained values, or longer than training runs."""
        case = self.model.workspace.case
        end = self.reduced.output_times.time[-1]
        trained = case.plan.steps.end_time
        found = [beyond_training(trained)] if end > trained * (1.0 + ROUNDING) else []
        beyond = extrapolation(case, self.point)
        return tuple(found) if beyond is None else (beyond, *found)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why a run that went to its end may be wrong, known without a full run."""
        return self.outside


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
        if run.failure is not None:
            artifact.annotate("status_detail", str(run.failure))
            report.warn(f"{run.name}: {run.failure}")
            return
    n_steps = round((run.time[-1] - run.time[0]) / run.time_step)
    report.info(f"{run.name}: {n_steps} steps of {run.time_step:.3g} s in {1e3 * seconds:.3g} ms")


def loads_of(quantities: Quantities) -> Array:
    """Return force and torque as one array (n_snapshots, 3) [N/m, N]."""
    return np.column_stack((quantities["force"], quantities["torque"]))
