"""What estimates of errors need, in the operators' artifact, so that no run needs the points.

What projection leaves out is factorised, and products of some training snapshots with the basis are
kept: they are what the errors of reduced training runs are made of.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.models import Case
from sphrom.case.plan import has_error_estimate
from sphrom.reduction.columns import columns
from sphrom.reduction.error_calibration import (
    FieldColumns,
    FieldProducts,
    compared_snapshots,
)
from sphrom.reduction.error_estimate import ResidualFactor, residual_factor
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.operators import ReducedOperators
from sphrom.reduction.trial_basis import TrialBasis, project
from sphrom.sph.fixed_points import FixedPoints
from sphrom.stages import memory
from sphrom.stages.workspace import Workspace

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

N_AT_ONCE = 10
"""Snapshots that are read at once."""
PARTS = ("inertia", "viscosity", "walls", "force")


def write_error_estimate(
    workspace: Workspace,
    artifact: ArtifactWriter,
    points: FixedPoints,
    name: str,
    basis: TrialBasis,
    splines: ModeSplines | None,
    operators: ReducedOperators,
    states: Array,
) -> None:
    """Write what estimates of a basis's models need, if the case has them.

    `states` (n_states, n_modes) are coordinates of training snapshots, which say how large
    coordinates are.
    """
    case = workspace.case
    if not has_error_estimate(case, name):
        return
    with workspace.context.report.progress(f"residual, basis {name}", points.n_points) as advance:
        factor = residual_factor(
            points,
            basis,
            operators,
            splines,
            largest=np.max(np.abs(states), axis=0),
            scales=_scales(case),
            advance=advance,
        )
    for part in PARTS:
        if (coefficients := getattr(factor, part)) is not None:
            artifact.write(f"bases/{name}/residual/{part}", coefficients)
    _write_training(workspace, artifact, points, name, basis)


def _scales(case: Case) -> dict[str, float]:
    """Return how large the factors of the parameters are, by part."""
    viscosity = memory.largest_viscosity(case)
    return {"viscosity": viscosity, "walls": viscosity}


def _write_training(
    workspace: Workspace,
    artifact: ArtifactWriter,
    points: FixedPoints,
    name: str,
    basis: TrialBasis,
) -> None:
    """Write products of training snapshots with a basis, and where their runs start."""
    case, group = workspace.case, f"bases/{name}/estimate"
    field_columns = FieldColumns(basis, columns(basis, points))
    starts, projections, squares = [], [], []
    for point in case.bases[name]:
        with workspace.open(workspace.mapped(point)) as mapped:
            densities = mapped.dataset("density_fluctuation")
            velocities = mapped.dataset("velocity")
            starts.append(project(basis, densities[0], velocities[0]))
            compared = compared_snapshots(len(densities))
            found = []
            for first in range(0, len(compared), N_AT_ONCE):
                some = compared[first : first + N_AT_ONCE]
                density = np.stack([densities[int(k)] for k in some])
                velocity = np.stack([velocities[int(k)] for k in some])
                found.append(field_columns.products(points.density_scale * density, velocity))
        projections.append(np.concatenate([p for p, _ in found]))
        squares.append(np.concatenate([s for _, s in found]))
    artifact.write(f"{group}/start", np.stack(starts))
    artifact.write(f"{group}/gram", field_columns.gram)
    artifact.write(f"{group}/projections", np.stack(projections))
    artifact.write(f"{group}/squares", np.stack(squares))


def read_factor(artifact: Artifact, name: str) -> ResidualFactor:
    """Read the residual's factor of a basis back."""
    group = f"bases/{name}/residual"
    inertia, viscosity, walls, force = (
        artifact.read(f"{group}/{part}") if f"{group}/{part}" in artifact else None
        for part in PARTS
    )
    if inertia is None or viscosity is None:
        raise ValueError(f"{group} is not complete")
    driven = artifact.number("walls_driven") == 1.0
    return ResidualFactor(inertia, viscosity, walls, force, driven)


def read_products(artifact: Artifact, name: str) -> FieldProducts:
    """Read the products of training snapshots with a basis back."""
    group = f"bases/{name}/estimate"
    return FieldProducts(
        *(artifact.read(f"{group}/{part}") for part in ("gram", "projections", "squares"))
    )
