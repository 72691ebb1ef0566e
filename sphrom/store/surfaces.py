"""Artifacts of flows with a free surface: bases, trained models, and where the surface is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import read_record
from sphrom.artifacts.records.runs import SurfaceModels, TrainedSurfaceModel
from sphrom.case.model_sections import ALL, AUTO, ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.elevation import find_elevation
from sphrom.metrics.measures import Samples
from sphrom.reduction.polynomial_model import OutputTimes
from sphrom.reduction.stream_functions import StreamSpace
from sphrom.reduction.surface_basis import SurfaceBasis, TrainedGraph, chosen_size
from sphrom.setup.assembly import uniform_force
from sphrom.sph.fluid import volume_of
from sphrom.store.trained_models import start
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from sphrom.reduction.graph_model import GraphModel, GraphRun


def read_surface_basis(workspace: Workspace) -> SurfaceBasis:
    """Read the basis of a case with a free surface."""
    with workspace.open(workspace.basis()) as artifact:
        return read_record(artifact, SurfaceBasis, f"bases/{ALL}")


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
        """Return a run."""
        return self.graph.run(self.output_times.time, self.start)

    def sampled(self, points: Array, time: Array, coordinates: Array) -> Samples:
        """Return velocity and pressure at points (n_points, 2) [m], zero above the surface."""
        pressure = self.density * self.graph.pressure(time, coordinates, points)
        samples = Samples(time, self.graph.velocity(coordinates, points), pressure)
        return dried(samples, points, self.graph.elevation(coordinates, points[:, 0]))


class TrainedSurface:
    """A trained model, which can be evaluated at any parameter point.

    Its section has the number of modes, those of noise left out.
    """

    def __init__(
        self,
        workspace: Workspace,
        section: ReducedModelSection,
        stored: TrainedSurfaceModel | None = None,
    ) -> None:
        if stored is None:
            self.trained = trained_size(workspace, section)
            whole = read_surface_basis(workspace)
            self.basis = whole.reduced(self.trained.n_modes, self.trained.n_surface)
        else:
            self.trained = stored.graph
            self.basis = stored.basis
        self.workspace = workspace
        self.section = section.model_copy(update={"n_modes": self.trained.n_modes})
        self._starts: dict[object, Array] = {}

    def at(self, point: ParameterPoint) -> SurfaceModelAt:
        """Return the model at a parameter point."""
        case = self.workspace.case
        graph = self.trained.model(
            self.basis,
            case.plan.depth(point),
            case.scene.gravity,
            case.plan.kinematic_viscosity(point),
            uniform_force(case, point),
            calibrated=self.section.is_calibrated,
        )
        graph = replace(graph, longest_step=case.plan.longest_step(point))
        steps = case.plan.model_steps(self.section)
        density = case.fluid.reference_density
        times = OutputTimes(steps.snapshot_interval, steps.n_snapshots, steps.start_time)
        return SurfaceModelAt(graph, density, self._start(point), times)

    def _start(self, point: ParameterPoint) -> Array:
        """Return the coordinates that runs at a point start from."""
        case = self.workspace.case
        spun_up = self.workspace.case.time.spin_up > 0.0
        begin = case.plan.start_point(point)
        own = ((n, v) for n, v in begin.factors.items() if case.scene.starts_by(n))
        key = begin if spun_up else tuple(own)
        if key not in self._starts:
            state = start(self.workspace, begin)
            columns = case.plan.surface_columns
            level = case.scene.level_at(begin.factors)
            elevation = np.full_like(columns, level)
            if spun_up or not math.isfinite(level):
                elevation = elevation_of(case, self.basis.space, columns)(
                    state.position, state.density_fluctuation
                )
            coefficients, _ = self.basis.space.fit(state.position, state.velocity)
            self._starts[key] = self.basis.project(coefficients[None], elevation[None])[0]
        return self._starts[key]


def trained_size(workspace: Workspace, section: ReducedModelSection) -> TrainedGraph:
    """Return the trained parameters of a model with its number of modes."""
    with workspace.open(workspace.operators()) as artifact:
        trained = read_record(artifact, SurfaceModels).sizes
    size = section.n_modes
    if size == AUTO:
        size = chosen_size({int(size): each for size, each in trained.items()})
    return trained[str(size)]


def elevation_of(case: Case, space: StreamSpace, columns: Array) -> Callable[[Array, Array], Array]:
    """Return a function of positions and density fluctuations for the surface [m] at columns.

    The function raises SphromError if a column has no fluid or more than one surface.
    """
    walls, radius = (space.left, space.right, space.bottom), 2.0 * case.plan.smoothing_length

    def find(position: Array, density: Array) -> Array:
        volume = volume_of(density, case.fluid.reference_density, case.plan.mass)
        return find_elevation(position, volume, columns, radius, walls)

    return find


def dried(samples: Samples, points: Array, surface: Array) -> Samples:
    """Return samples that are zero at points (n_points, 2) [m] above a surface.

    Its heights y are (n_snapshots, n_points) [m].
    """
    wet = points[:, 1] <= surface
    velocity = np.where(wet[..., None], samples.velocity, 0.0)
    return Samples(samples.time, velocity, np.where(wet, samples.pressure, 0.0))
