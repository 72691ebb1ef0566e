"""The fields of stored runs, full and reduced: on their own points, and at any places.

All access from the artifact of a run to a field at a place goes through this module. Particles are
sampled by moving least squares, coordinates by the splines of their modes. Measurements of runs at
places have the same values. Within a spacing of walls they include the walls' velocity.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.case.study_sections import FULL
from sphrom.errors import ArtifactError, CaseError
from sphrom.metrics.measures import (
    Probes,
    Quantities,
    Samples,
    grid_points,
    midpoints,
    spread,
    with_coefficients,
)
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.trial_basis import (
    TrialBasis,
    mean_density_fluctuation,
    project,
    reconstruct,
    truncate,
)
from sphrom.sph.fluid import fluctuation_of, pressure_of
from sphrom.store.surfaces import SurfaceModelAt, TrainedSurface
from sphrom.store.trained_models import basis_used, read_basis, read_modes, read_points
from sphrom.store.trajectory import read_quantities, snapshot_fields
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from sphrom.reduction.reference_space import ReferenceMap


class StoredRun:
    """A run of the full model, or of a reduced `model`, at a parameter point, in an open artifact.

    A model on the reference points stores coordinates, from which fields are reconstructed.
    """

    def __init__(
        self,
        workspace: Workspace,
        run: Artifact,
        point: ParameterPoint,
        model: ReducedModelSection | None = None,
    ) -> None:
        self._workspace = workspace
        self._case = workspace.case
        self._run = run
        self._point = point
        self._rebuilt = None if model is None or not model.from_operators else model
        self.name = FULL if model is None else model.name
        self._has_surface = workspace.case.scene.has_surface
        self.time = run.read("time")
        self.mass = run.number("mass")

    @classmethod
    @contextmanager
    def opened(
        cls, workspace: Workspace, point: ParameterPoint, model: ReducedModelSection | None = None
    ) -> Iterator[StoredRun]:
        """Open a run of the case. Raises ArtifactError if it is missing or invalid."""
        target = workspace.full_run(point) if model is None else workspace.reduced_run(model, point)
        with workspace.open(target) as run:
            yield cls(workspace, run, point, model)

    @property
    def is_complete(self) -> bool:
        """Whether the run reached its end."""
        return self._run.text("status") == "complete"

    def measured(self, name: str) -> Quantities:
        """Return a measurement of the case over time, by quantity (n_snapshots, ...)."""
        measured = {name: read_quantities(self._run, name)}
        return with_coefficients(measured, self._case.plan.coefficients)[name]

    @cached_property
    def _used(self) -> tuple[str, int]:
        assert self._rebuilt is not None
        return basis_used(self._workspace, self._rebuilt, self._point)

    @cached_property
    def _basis(self) -> TrialBasis:
        name, n_modes = self._used
        return truncate(read_basis(self._workspace, name), n_modes)

    @cached_property
    def _coordinates(self) -> Array:
        return self._run.read("generalized_coordinates")

    @cached_property
    def _graph(self) -> SurfaceModelAt:
        assert self._rebuilt is not None
        return TrainedSurface(self._workspace, self._rebuilt).at(self._point)

    @property
    def elevation(self) -> Array:
        """The height y of a reduced model's free surface (n_snapshots, n_columns) [m]."""
        return self._graph.graph.elevation(self._coordinates, self._case.plan.surface_columns)

    def position(self, snapshot: int) -> Array:
        """Return the run's own points (n, 2) [m]."""
        if self._rebuilt is not None and self._has_surface:
            return self._case.scene.domain.fill(self._case.plan.particle_spacing)
        if self._rebuilt is not None:
            return read_points(self._workspace)
        return np.asarray(self._run.dataset("position")[snapshot])

    def rebuilt(self, snapshot: int) -> tuple[Array, Array]:
        """Return density fluctuation (n,) [kg/m3] and velocity (n, 2) [m/s] from coordinates."""
        if self._has_surface:
            samples = self.sampled(self.position(snapshot), [snapshot])
            sound_speed = self._case.plan.sound_speed
            return fluctuation_of(samples.pressure[0], sound_speed), samples.velocity[0]
        mean = self._run.number("mean_density_fluctuation")
        return reconstruct(self._basis, self._coordinates[snapshot], mean)

    def fields(self, snapshot: int) -> tuple[Array, Array]:
        """Return velocity (n, 2) [m/s] and pressure (n,) [Pa] on the run's own points."""
        if self._rebuilt is None:
            stored = (self._run.dataset(name)[snapshot] for name in ("velocity", "pressure"))
            velocity, pressure = map(np.asarray, stored)
            return velocity, pressure
        density, velocity = self.rebuilt(snapshot)
        return velocity, pressure_of(density, self._case.plan.sound_speed)

    def sampled(
        self,
        points: Array,
        snapshots: Sequence[int] | None = None,
        advance: Callable[[int], None] = lambda done: None,
    ) -> Samples:
        """Return velocity and pressure at points (n_points, 2) [m], at some or all snapshots.

        A run that became unstable is sampled as long as there are particles near all points.
        """
        chosen = range(len(self.time)) if snapshots is None else snapshots
        if self._rebuilt is None:
            return sample_run(self._case, self._run, points, advance, chosen)
        if self._has_surface:
            return self._graph.sampled(points, self.time[chosen], self._coordinates[chosen])
        basis, splines = read_modes(self._workspace, *self._used)
        means = np.full(len(chosen), self._run.number("mean_density_fluctuation"))
        coordinates = self._coordinates[chosen]
        return expand(self._case, basis, splines, points, self.time[chosen], coordinates, means)


ON_WALL = 1e-6
"""Points closer to a wall than this share of the spacing are on it."""
MISSED_INFLOW, WRONG_INFLOW = 0.02, 0.2
"""Differences from the target inflow, relative, that are told, and that make a run fail."""
LEAST_SHARE = 1e-10
"""Relative size of a combination of modes that contains nothing of a field."""


def probes_of(case: Case) -> Probes:
    """Return the probes at which the runs of a case are compared.

    Raises CaseError if there is no fluid on the line.
    """
    domain = case.scene.domain
    x = case.plan.probe_line
    spans = domain.sections(x)
    if not spans:
        raise CaseError(f"compare.line: there is no fluid at x = {x:g} m")
    n_line = case.compare.line_points
    longer = max(domain.lengths)
    n_columns, n_rows = (max(2, round(case.compare.grid * s / longer)) for s in domain.lengths)
    shape = n_rows, n_columns
    points = grid_points(domain.lower, domain.upper, shape)
    # A grid inside the box may have points exactly on walls; they are not in the fluid.
    in_fluid = domain.wall_distance(points) > ON_WALL * case.plan.particle_spacing
    if (strip := case.plan.strip) is not None:  # the flow in it is artificial
        in_fluid &= ~strip.contains(points.T)
    return Probes(
        line=np.stack((np.full(n_line, float(x)), spread(spans, n_line)), axis=1),
        grid=points[in_fluid],
        grid_shape=shape,
        in_fluid=in_fluid,
        stations=case.scene.stations(case.plan.probe_line),
    )


def sample_run(
    case: Case,
    trajectory: Artifact,
    points: Array,
    advance: Callable[[int], None] = lambda done: None,
    snapshots: Sequence[int] | None = None,
) -> Samples:
    """Sample the particles of a run at points (n_points, 2) [m], at some or all snapshots.

    A run that became unstable is sampled as long as there are particles near all points.
    """
    from sphrom.setup.particles import sampler  # it loads kernels

    times = trajectory.read("time")
    sample = sampler(case, points)
    chosen = range(len(times)) if snapshots is None else snapshots
    velocities = np.empty((len(chosen), len(points), 2))
    pressures = np.empty((len(chosen), len(points)))
    for i, snapshot in enumerate(chosen):
        try:
            density, velocities[i] = sample(*snapshot_fields(trajectory, snapshot))
        except ValueError as error:
            if trajectory.text("status") == "complete":
                raise ArtifactError(f"{trajectory.path}, snapshot {snapshot}: {error}") from error
            return Samples(times[chosen[:i]], velocities[:i], pressures[:i])
        pressures[i] = pressure_of(density, case.plan.sound_speed)
        advance(1)
    return Samples(times[chosen], velocities, pressures)


@dataclass(frozen=True)
class Inflow:
    """The inflow of a full run, and the one that the case asks for."""

    text: str
    miss: float
    """The difference of the flow rates, over the root mean square of the target."""

    @property
    def is_wrong(self) -> bool:
        """Whether the flow is not the one of the case."""
        return self.miss > WRONG_INFLOW

    @property
    def problem(self) -> str | None:
        """A sentence for a run that misses its inflow; None for others."""
        if not self.miss > MISSED_INFLOW:
            return None
        return (
            f"{self.text}. The flow is not the one of the case: raise scene.inflow.strength, take "
            "a wider strip, or let inflow.ramp and time.final_time be longer"
        )


def inflow_of(case: Case, point: ParameterPoint, trajectory: Artifact) -> Inflow | None:
    """Return the target inflow and that of a run's later half; None without a strip.

    Times before the inflow has its speed do not count if there are others.
    """
    strip = case.plan.strip
    force = case.plan.flow(point).body_force
    if strip is None or force is None:
        return None
    domain = case.scene.domain
    along = strip.axis
    across = 1 - along
    n_places = max(2, round(domain.lengths[across] / case.plan.particle_spacing))
    points = np.empty((n_places, 2))
    points[:, across] = midpoints(domain.lower[across], domain.upper[across], n_places)
    points[:, along] = 0.5 * (strip.start + strip.end)
    points = points[domain.contains(points)]
    profile = (force.field(points.T) / strip.rates(points.T)).T
    points[:, along] = strip.end if strip.speed > 0.0 else strip.start
    times = trajectory.read("time")
    later = np.arange(len(times) // 2, len(times))
    driven = later[times[later] >= case.plan.scene.ramp]
    snapshots = driven if driven.size else later[-1:]
    sampled = sample_run(case, trajectory, points, snapshots=snapshots.tolist())
    wanted = np.array([force.amplitude(t) for t in sampled.time])[:, None, None] * profile
    width = domain.lengths[across] * len(points) / n_places  # solids may cross the strip
    target = width * wanted[..., along].mean(axis=1)
    size = math.sqrt(float(np.mean(target**2)))
    if not size > 0.0:
        return None  # a constant of zero stops the inflow
    wanted_rate = float(target.mean())
    actual_rate = width * float(sampled.velocity[..., along].mean())
    miss = (actual_rate - wanted_rate) / size
    off = np.linalg.norm(sampled.velocity.mean(axis=0) - wanted.mean(axis=0), axis=1)
    fastest = float(np.linalg.norm(wanted, axis=2).max())
    text = (
        f"{point.label}: target inflow {wanted_rate:.4g} m2/s, actual inflow {actual_rate:.4g} "
        f"m2/s ({100.0 * math.copysign(miss, miss * wanted_rate):+.2f} %); the profile differs by "
        f"{100.0 * math.sqrt(np.mean(off**2)) / fastest:.2g} % of its largest speed"
    )
    return Inflow(text, abs(miss))


def sample_mapped(case: Case, mapped: Artifact, sample: ReferenceMap) -> Samples:
    """Sample mapped snapshots; they contain only the error of the map."""
    position = mapped.read("reference_position")
    snapshots = zip(mapped.dataset("density_fluctuation"), mapped.dataset("velocity"), strict=True)
    fields = [sample(position, density, velocity) for density, velocity in snapshots]
    density, velocity = map(np.array, zip(*fields, strict=True))
    return Samples(mapped.read("time"), velocity, pressure_of(density, case.plan.sound_speed))


def sample_best(
    case: Case, mapped: Artifact, basis: TrialBasis, splines: ModeSplines, probes: Probes
) -> tuple[Samples, Samples]:
    """Sample the best approximations of mapped snapshots in a basis: of states, and of each field.

    The first result is the projection of states in the inner product of the basis. In the second
    each field has coordinates of its own, so no state with these modes is closer in either field.
    """
    densities = mapped.dataset("density_fluctuation")
    velocities = mapped.dataset("velocity")
    snapshots = zip(densities, velocities, strict=True)
    # Where modes hold the mean density, a state of none has coordinates too: they count once.
    rest = project(basis, 0.0 * densities[0], 0.0 * velocities[0])
    parts = [(project(basis, d, 0.0 * v), project(basis, 0.0 * d, v) - rest) for d, v in snapshots]
    by_density, by_velocity = (np.array(part) for part in zip(*parts, strict=True))
    share = (basis.density_modes * basis.weights) @ basis.density_modes.T
    shares = (share, by_density), (np.eye(basis.n_modes) - share, by_velocity)
    alone = [np.linalg.lstsq(gram, part.T, LEAST_SHARE)[0].T for gram, part in shares]
    means = np.array([mean_density_fluctuation(basis, density) for density in densities])
    times = mapped.read("time")
    states, density, velocity = (
        expand(case, basis, splines, probes.all, times, coordinates, means)
        for coordinates in (by_density + by_velocity, *alone)
    )
    return states, replace(density, velocity=velocity.velocity)


def expand(
    case: Case,
    basis: TrialBasis,
    splines: ModeSplines,
    points: Array,
    times: Array,
    coordinates: Array,
    mean_density: Array,
) -> Samples:
    """Sample the states with coordinates (n_snapshots, n_modes) at points by the modes' splines.

    `mean_density` (n_snapshots,) [kg/m3] is the separate mean of a basis that has one, else zero.
    """
    values = splines.values(points).reshape(len(points), -1, 3)
    fields = np.tensordot(coordinates, values, (1, 1))
    density = basis.inner_product.density_fluctuation(fields[..., 0]) + mean_density[:, None]
    return Samples(times, fields[..., 1:], pressure_of(density, case.plan.sound_speed))
