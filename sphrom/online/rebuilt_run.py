"""Fields of runs, snapshot by snapshot: rebuilt from coordinates, and at chosen points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.reduction.trial_basis import TrialBasis, reconstruct, truncate
from sphrom.sph import state_equation
from sphrom.store.bases import read_basis, read_points
from sphrom.store.sampling import Samples, sample_snapshot
from sphrom.store.trained_operators import sized
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]


def read_probes(artifact: Artifact) -> Samples | None:
    """Return the samples that a run stored where runs are compared, None if it stored none."""
    if "probes/position" not in artifact:
        return None
    return Samples(
        artifact.read("time"), artifact.read("probes/velocity"), artifact.read("probes/pressure")
    )


class RebuiltRun:
    """The fields of a run on the reference points, snapshot by snapshot, as a trajectory has them.

    `artifact` is that of the run, and `basis` the basis that it used.
    """

    def __init__(self, artifact: Artifact, basis: TrialBasis, sound_speed: float) -> None:
        self._coordinates = artifact.read("generalized_coordinates")
        self._mean = artifact.number("mean_density_fluctuation")
        self._basis = basis
        self._sound_speed = sound_speed
        self.time = artifact.read("time")
        self.mass = artifact.number("mass")

    @classmethod
    def of(
        cls,
        workspace: Workspace,
        artifact: Artifact,
        model: ReducedModelSection,
        point: ParameterPoint,
    ) -> RebuiltRun:
        """Return the fields of a model's run at a parameter point, with the basis of the case."""
        basis = read_basis(workspace, workspace.case.plan.basis_for(model, point))
        return cls(
            artifact,
            truncate(basis, sized(workspace, model, point).size),
            workspace.case.plan.sound_speed,
        )

    def state(self, snapshot: int) -> tuple[Array, Array]:
        """Return density fluctuations (n_points,) [kg/m3] and velocity (n_points, 2) [m/s]."""
        return reconstruct(self._basis, self._coordinates[snapshot], self._mean)

    def fields(self, snapshot: int) -> tuple[Array, Array]:
        """Return velocity (n_points, 2) [m/s] and pressure (n_points,) [Pa] of one snapshot."""
        density, velocity = self.state(snapshot)
        return velocity, state_equation.pressure(density, self._sound_speed)


FieldsAt = Callable[[int], tuple[Array, Array]]
"""Gives velocity (n_points, 2) [m/s] and pressure (n_points,) [Pa] of a snapshot."""


def fields_of(
    workspace: Workspace,
    run: Artifact,
    sample: ReferenceMap,
    point: ParameterPoint,
    model: ReducedModelSection | None = None,
) -> FieldsAt:
    """Return the fields of an open run, of the full model or of a reduced one, where `sample` is.

    A run on the reference points is rebuilt from its coordinates. The returned function
    raises ValueError where no particles are left near a point, as in an unstable run.
    """
    if model is None or model.on_particles:
        return lambda snapshot: sample_snapshot(workspace.case, run, sample, snapshot)
    rebuilt = RebuiltRun.of(workspace, run, model, point)
    points = read_points(workspace)

    def fields_at(snapshot: int) -> tuple[Array, Array]:
        velocity, pressure = rebuilt.fields(snapshot)
        sampled, moved = sample(points, pressure, velocity)
        return moved, sampled

    return fields_at
