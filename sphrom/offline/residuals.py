"""The data of error estimates in the operators' artifact, with which no run needs the points.

It is the factor of the residual, and products of some training snapshots with the basis, from which
the errors of reduced training runs follow.
"""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.reader import DatasetReader
from sphrom.artifacts.records.operators import DriveResidual, Estimate, Residual, Unheld
from sphrom.case.models import Case
from sphrom.case.plan import has_error_estimate, step_plan
from sphrom.reduction.error_calibration import compared_snapshots
from sphrom.reduction.held_out import ProductSums, UnheldShares, unheld_shares
from sphrom.reduction.mode_fields import FieldProjections, mode_fields
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.reduced_operators import ReducedOperators
from sphrom.reduction.residual_factor import residual_factor
from sphrom.reduction.sizes import BLOCK_VALUES, N_FIELD_VALUES, blocks
from sphrom.reduction.trial_basis import TrialBasis, project
from sphrom.setup import assembly
from sphrom.setup.places import places_of
from sphrom.sph.fixed_points import FixedPoints
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

N_AT_ONCE = 10
"""Snapshots that are read at once."""


def residual_and_estimate(
    workspace: Workspace,
    points: FixedPoints,
    name: str,
    basis: TrialBasis,
    splines: ModeSplines,
    operators: ReducedOperators,
    states: Array,
) -> tuple[Residual | None, Estimate | None]:
    """Return the data for error estimates of models with a basis, None where the case has none.

    `states` (n_states, n_modes) are coordinates of training snapshots, which say how large
    coordinates are.
    """
    case = workspace.case
    if not has_error_estimate(case, name):
        return None, None
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
    drives = {parameter: DriveResidual.of(drive) for parameter, drive in factor.drives.items()}
    return Residual.of(factor, drives=drives), _training(workspace, points, name, basis)


def _scales(case: Case) -> dict[str, float]:
    """Return how large the factors of the parameters are, by part."""
    viscosity = assembly.largest_viscosity(case)
    found = {"viscosity": viscosity, "walls": viscosity}
    for parameter in case.parameter_names[1:]:
        largest = max(abs(point.factors[parameter]) for point in case.train_points) or 1.0
        found |= {f"walls/{parameter}": viscosity * largest, f"force/{parameter}": largest}
    return found


def _training(workspace: Workspace, points: FixedPoints, name: str, basis: TrialBasis) -> Estimate:
    """Return products of training snapshots with a basis, and where their runs start."""
    case = workspace.case
    projections_of = FieldProjections(basis, mode_fields(basis, points))
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
                found.append(projections_of.products(points.density_scale * density, velocity))
        projections.append(np.concatenate([p for p, _ in found]))
        squares.append(np.concatenate([s for _, s in found]))
    return Estimate(
        unheld=Unheld.of(_unheld(workspace, points, name, basis)),
        start=np.stack(starts),
        gram=projections_of.gram,
        projections=np.stack(projections),
        squares=np.stack(squares),
    )


def _unheld(
    workspace: Workspace, points: FixedPoints, name: str, basis: TrialBasis
) -> UnheldShares:
    """Return the shares of unseen training snapshots that bases cannot represent."""
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
    return unheld_shares(
        products, places_of(case, trained), n_modes, centred=basis.offset is not None
    )


def _some(snapshots: DatasetReader, compared: Indices, rows: slice) -> Array:
    """Read some snapshots (n_compared, n, ...) at some points."""
    return np.stack([snapshots[int(k), rows] for k in compared])
