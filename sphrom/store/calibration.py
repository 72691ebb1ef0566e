"""Training runs in generalized coordinates, and the calibration of reduced models with them.

Modes are orthonormal, so that the coordinates of fewer modes are the first of those kept here, and
a model of any size is calibrated when it is built.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.reduction.calibration import Calibration, TrainingRun, calibrate
from sphrom.reduction.reduced_operators import ReducedOperators
from sphrom.reduction.trial_basis import TrialBasis, project
from sphrom.setup.assembly import amplitude_of
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]

N_BLOCK_SNAPSHOTS = 16
"""Snapshots that are projected at once."""


def training_runs(workspace: Workspace, basis: TrialBasis, name: str) -> Array:
    """Return all snapshots that a basis learnt from (n_runs, n_snapshots, n_modes), projected."""
    runs = []
    for point in workspace.case.plan.bases[name]:
        with workspace.open(workspace.mapped(point)) as mapped:
            densities, velocities = (
                mapped.dataset("density_fluctuation"),
                mapped.dataset("velocity"),
            )
            blocks = [
                slice(first, first + N_BLOCK_SNAPSHOTS)
                for first in range(0, len(densities), N_BLOCK_SNAPSHOTS)
            ]
            parts = [project(basis, densities[some], velocities[some]) for some in blocks]
            runs.append(np.concatenate(parts))
    return np.stack(runs)


def read_calibration(
    case: Case,
    artifact: Artifact,
    name: str,
    operators: ReducedOperators,
    modes: NDArray[np.int64],
    *,
    required: bool,
) -> Calibration | None:
    """Return what is added to the rates of some modes of a basis, by viscosity.

    Training runs may have too few snapshots: it is then None, unless it is required.

    Raises CaseError when it is.
    """
    runs = artifact.read(f"bases/{name}/training_runs")[..., modes]
    try:
        return calibrated(case, case.plan.bases[name], operators, runs)
    except ValueError as error:
        if not required:
            return None
        raise CaseError(f"rom.calibrated: {error}; see snapshots.every") from error


def calibrated(
    case: Case, points: Sequence[ParameterPoint], operators: ReducedOperators, runs: Array
) -> Calibration:
    """Calibrate operators with training runs (n_runs, n_snapshots, n_modes) at some points.

    Raises ValueError when they have too few snapshots.
    """
    plan = case.plan.steps
    known = [
        TrainingRun(
            operators.at(case.plan.kinematic_viscosity(point), factors=point.factors),
            coordinates,
            case.plan.kinematic_viscosity(point),
            _amplitude(case, point),
            point.factors,
        )
        for point, coordinates in zip(points, runs, strict=True)
    ]
    return calibrate(known, plan.snapshot_interval, case.plan.longest_sound_period)


def _amplitude(case: Case, point: ParameterPoint) -> Array | None:
    """Return how strongly a flow is driven at snapshots (n_snapshots,), where that changes."""
    amplitude = amplitude_of(case, point)
    return None if amplitude is None else amplitude(snapshot_times(case))


def snapshot_times(case: Case) -> Array:
    """Return the times of the snapshots of a case's runs (n_snapshots,) [s]."""
    plan = case.plan.steps
    return plan.start_time + plan.snapshot_interval * np.arange(plan.n_snapshots, dtype=np.float64)
