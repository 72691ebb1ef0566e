"""Velocity and pressure of any run of a case at chosen points, snapshot by snapshot."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.online.rebuilt_run import RebuiltRun
from sphrom.reduction.reference_space import ReferenceMap
from sphrom.store.basis import read_points
from sphrom.store.sampling import sample_snapshot
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]
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
