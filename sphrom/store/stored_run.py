"""The fields of stored runs, full and reduced: on their own points, and at any places.

All access from the artifact of a run to a field at a place goes through this module. Particles are
sampled by moving least squares, coordinates by the splines of their modes. Measurements of runs at
places have the same values. Within a spacing of walls they include the walls' velocity.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.metrics.measures import Quantities
from sphrom.reduction.trial_basis import TrialBasis, reconstruct, truncate
from sphrom.setup.assembly import surface_columns
from sphrom.sph.fluid import fluctuation_of, pressure_of
from sphrom.store.sampling import Samples, expand, sample_run
from sphrom.store.surfaces import SurfaceModelAt, trained_surface
from sphrom.store.trained_models import basis_used, read_basis, read_modes, read_points
from sphrom.store.trajectory import read_quantities
from sphrom.store.workspace import Workspace


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
        self._workspace, self._run, self._point = workspace, run, point
        self._rebuilt = None if model is None or not model.from_operators else model
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
        return read_quantities(self._run, name)

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
        return trained_surface(self._workspace, self._rebuilt).at(self._point)

    @property
    def elevation(self) -> Array:
        """The height y of a reduced model's free surface (n_snapshots, n_columns) [m]."""
        return self._graph.graph.elevation(self._coordinates, surface_columns(self._workspace.case))

    def position(self, snapshot: int) -> Array:
        """Return the run's own points (n, 2) [m]."""
        if self._rebuilt is not None and self._has_surface:
            return self._workspace.case.scene.domain.fill(
                self._workspace.case.plan.particle_spacing
            )
        if self._rebuilt is not None:
            return read_points(self._workspace)
        return np.asarray(self._run.dataset("position")[snapshot])

    def rebuilt(self, snapshot: int) -> tuple[Array, Array]:
        """Return density fluctuation (n,) [kg/m3] and velocity (n, 2) [m/s] from coordinates."""
        if self._has_surface:
            samples = self.sampled(self.position(snapshot), [snapshot])
            sound_speed = self._workspace.case.plan.sound_speed
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
        return velocity, pressure_of(density, self._workspace.case.plan.sound_speed)

    def sampled(
        self,
        points: Array,
        snapshots: Sequence[int] | None = None,
        advance: Callable[[int], None] = lambda done: None,
    ) -> Samples:
        """Return velocity and pressure at points (n_points, 2) [m], at some or all snapshots.

        A run that became unstable is sampled as long as there are particles near all points.
        """
        case, run = self._workspace.case, self._run
        chosen = range(len(self.time)) if snapshots is None else snapshots
        if self._rebuilt is None:
            return sample_run(case, run, points, advance, chosen)
        if self._has_surface:
            return self._graph.sampled(points, self.time[chosen], self._coordinates[chosen])
        basis, splines = read_modes(self._workspace, *self._used)
        means = np.full(len(chosen), run.number("mean_density_fluctuation"))
        coordinates = self._coordinates[chosen]
        return expand(case, basis, splines, points, self.time[chosen], coordinates, means)
