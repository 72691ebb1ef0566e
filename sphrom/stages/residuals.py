"""What estimates of errors need, in the operators' artifact, so that no run needs the points.

What projection leaves out is factorised, and products of some training snapshots with the basis are
kept: they are what the errors of reduced training runs are made of.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.artifacts.dataset_reader import DatasetReader
from sphrom.case.models import Case
from sphrom.case.plan import has_error_estimate, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.errors import ArtifactError
from sphrom.reduction.columns import columns
from sphrom.reduction.error_calibration import (
    FieldColumns,
    FieldProducts,
    compared_snapshots,
)
from sphrom.reduction.error_estimate import ResidualFactor, residual_factor
from sphrom.reduction.held_out import ProductSums, UnheldShares, unheld_shares
from sphrom.reduction.interpolation_weights import interpolation_weights
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.operators import BLOCK_VALUES, ReducedOperators, blocks
from sphrom.reduction.pod import N_FIELD_VALUES
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
    shares = _unheld(workspace, points, name, basis)
    artifact.write(f"{group}/unheld/parameters", shares.parameters)
    artifact.write(f"{group}/unheld/time", shares.time)


def _unheld(
    workspace: Workspace, points: FixedPoints, name: str, basis: TrialBasis
) -> UnheldShares:
    """Return what bases hold of training snapshots that they have not learnt."""
    case, trained = workspace.case, workspace.case.bases[name]
    compared = compared_snapshots(step_plan(case).n_snapshots)
    sums = ProductSums(len(trained) * len(compared), basis)
    with ExitStack() as stack:
        runs = [stack.enter_context(workspace.open(workspace.mapped(point))) for point in trained]
        for rows in blocks(points.n_points, BLOCK_VALUES // (N_FIELD_VALUES * sums.n_snapshots)):
            fields = [
                np.concatenate([_some(run.dataset(field), compared, rows) for run in runs])
                for field in ("density_fluctuation", "velocity")
            ]
            sums.add(rows, *fields)
    products = sums.products(points.density_scale, len(trained))
    n_modes = basis.n_modes // len(basis.singular_values)
    return unheld_shares(products, places_of(trained), n_modes, centred=basis.offset is not None)


def _some(snapshots: DatasetReader, compared: Indices, rows: slice) -> Array:
    """Read some snapshots (n_compared, n, ...) at some points."""
    return np.stack([snapshots[int(k), rows] for k in compared])


def places_of(points: Sequence[ParameterPoint]) -> Array:
    """Return where points are (n_points, n_parameters): parameters count by their ratios."""
    return np.log([list(point.as_dict().values()) for point in points])


def role_of(case: Case, basis: str, point: ParameterPoint) -> str:
    """Return what a point is to a basis: `trained`, else `predicted` inside of its training points.

    Outside of them it is `extrapolated`.
    """
    trained = case.bases[basis]
    if point in trained:
        return "trained"
    _, distance = interpolation_weights(places_of(trained), places_of([point])[0])
    return "extrapolated" if distance > 0.0 else "predicted"


def read_unheld(artifact: Artifact, name: str) -> UnheldShares:
    """Read what bases hold of snapshots that they have not learnt."""
    group = f"bases/{name}/estimate/unheld"
    if f"{group}/parameters" not in artifact:
        raise ArtifactError(
            f"{artifact.path} lacks what estimates of errors need, as an older version made it; "
            "`sphrom operators CASE --force` makes it anew"
        )
    return UnheldShares(artifact.read(f"{group}/parameters"), artifact.read(f"{group}/time"))


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
