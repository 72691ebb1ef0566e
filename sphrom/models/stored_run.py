"""The fields of stored full and reduced runs, on their own points and at any places.

Full runs and runs on particles store their fields. Runs of other models store coordinates, from
which their family computes the fields.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.case.study_sections import FULL
from sphrom.metrics.measures import Quantities, Samples, with_coefficients
from sphrom.metrics.series import kinetic_energy
from sphrom.models.contract import Measured, family_of
from sphrom.sph.fluid import pressure_of
from sphrom.store.stored_run import sample_run
from sphrom.store.trajectory import read_quantities, snapshot_fields
from sphrom.store.workspace import Workspace

OWN_PRESSURE = "pressure_coordinates"
"""The coordinates of separate pressure modes in a run's artifact, if its model has any."""


class StoredRun:
    """A run of the full model, or of a model on particles, in an open artifact."""

    is_computed = False
    """Whether its fields are computed from coordinates."""

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
        self._model = model
        self.name = FULL if model is None else model.name
        self.time = run.read("time")
        self.mass = run.number("mass")

    @staticmethod
    def of(
        workspace: Workspace,
        run: Artifact,
        point: ParameterPoint,
        model: ReducedModelSection | None = None,
    ) -> StoredRun:
        """Return the run of an open artifact; without a model, a full run."""
        kind: type[StoredRun] = StoredRun
        if model is not None:
            kind = family_of(workspace.case, model).part("stored_run")
        return kind(workspace, run, point, model)

    @classmethod
    @contextmanager
    def opened(
        cls, workspace: Workspace, point: ParameterPoint, model: ReducedModelSection | None = None
    ) -> Iterator[StoredRun]:
        """Open a run of the case. Raises ArtifactError if it is missing or invalid."""
        target = workspace.full_run(point) if model is None else workspace.reduced_run(model, point)
        with workspace.open(target) as run:
            yield cls.of(workspace, run, point, model)

    @property
    def is_complete(self) -> bool:
        """Whether the run reached its end."""
        return self._run.text("status") == "complete"

    def measured(self, name: str) -> Quantities:
        """Return a measurement of the case over time, by quantity (n_snapshots, ...)."""
        measured = {name: read_quantities(self._run, name)}
        return with_coefficients(measured, self._case.plan.coefficients)[name]

    @property
    def kinetic_energy(self) -> Array:
        """The kinetic energy (n_snapshots,) [J/m]."""
        return np.array([kinetic_energy(velocity, self.mass) for velocity in self._velocities()])

    @property
    def largest_speed(self) -> float:
        """The largest speed of all points and snapshots [m/s]."""
        return max(float(np.hypot.reduce(v, axis=1).max()) for v in self._velocities())

    def _velocities(self) -> Iterator[Array]:
        return (self.fields(snapshot)[0] for snapshot in range(len(self.time)))

    @property
    def whole(self) -> Measured:
        """Measurements that are not among those of the case, as `Family.measured_at` has them."""
        return {}

    def position(self, snapshot: int) -> Array:
        """Return the run's own points (n, 2) [m]."""
        return np.asarray(self._run.dataset("position")[snapshot])

    def state(self, snapshot: int) -> tuple[Array, Array]:
        """Return density fluctuation (n,) [kg/m3] and velocity (n, 2) [m/s] on these points."""
        return snapshot_fields(self._run, snapshot)[1:]

    def fields(self, snapshot: int) -> tuple[Array, Array]:
        """Return velocity (n, 2) [m/s] and pressure (n,) [Pa] on the run's own points."""
        stored = (self._run.dataset(name)[snapshot] for name in ("velocity", "pressure"))
        velocity, pressure = map(np.asarray, stored)
        return velocity, pressure

    def sampled(
        self,
        points: Array,
        snapshots: Sequence[int] | None = None,
        advance: Callable[[int], None] = lambda done: None,
    ) -> Samples:
        """Return velocity and pressure at points (n_points, 2) [m], at some or all snapshots.

        A run that became unstable is sampled as long as there are particles near all points.
        """
        return sample_run(self._case, self._run, points, advance, snapshots)


class ComputedRun(StoredRun):
    """A run that stores coordinates, from which its fields are computed."""

    is_computed = True

    @cached_property
    def coordinates(self) -> Array:
        """(n_snapshots, n_modes) of the run."""
        return self._run.read("generalized_coordinates")

    @property
    def model(self) -> ReducedModelSection:
        """The section of the model."""
        assert self._model is not None
        return self._model

    @abstractmethod
    def state(self, snapshot: int) -> tuple[Array, Array]:
        """Return density fluctuation (n,) [kg/m3] and velocity (n, 2) [m/s] from coordinates."""

    def fields(self, snapshot: int) -> tuple[Array, Array]:
        """Return velocity (n, 2) [m/s] and pressure (n,) [Pa] on the run's own points."""
        density, velocity = self.state(snapshot)
        return velocity, pressure_of(density, self._case.plan.sound_speed)
