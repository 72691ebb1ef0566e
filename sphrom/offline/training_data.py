"""The data of error estimates in the operators' artifact, with which no run needs the points.

It is the factor of the residual, and products of some training snapshots with the basis, from which
the errors of reduced training runs follow. Training runs that are held out also choose how many
modes to have, and how many of them to integrate.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.artifacts.records.reduced_models import Estimate, HeldOut
from sphrom.case.models import Case
from sphrom.case.plan import MAX_STEPS
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.reduction import reference_model
from sphrom.reduction.calibration import Calibration
from sphrom.reduction.decomposition import N_FIELD_VALUES
from sphrom.reduction.error_calibration import compared_snapshots
from sphrom.reduction.held_out import (
    TrainedSizes,
    UnheldShares,
    choose_integrated,
    held_out_errors,
    snapshot_products,
    unheld_shares,
)
from sphrom.reduction.mode_fields import BLOCK_VALUES, FieldProjections, blocks, mode_fields
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.operator_projection import residual_factor
from sphrom.reduction.reduced_operators import ReducedOperators, ResidualFactor
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.reduction.trial_basis import TrialBasis, kept_modes, project, truncate
from sphrom.setup.assembly import amplitude_of, output_times_of, places_of
from sphrom.sph.fixed_points import FixedPoints
from sphrom.store.bases import mapped_runs
from sphrom.store.trained_operators import calibrated
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
) -> tuple[ResidualFactor | None, Estimate | None]:
    """Return the data for error estimates of models with a basis, None where the case has none.

    `states` (n_states, n_modes) are coordinates of training snapshots, which say how large
    coordinates are.
    """
    case = workspace.case
    if not case.plan.has_error_estimate(name):
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
    return factor, _training(workspace, points, name, basis)


def _scales(case: Case) -> dict[str, float]:
    """Return how large the factors of the parameters are, by part."""
    viscosity = case.plan.largest_viscosity
    found = {"viscosity": viscosity, "walls": viscosity}
    for parameter in case.plan.parameter_names[1:]:
        largest = max(abs(point.factors[parameter]) for point in case.plan.train_points) or 1.0
        found |= {f"walls/{parameter}": viscosity * largest, f"force/{parameter}": largest}
    return found


def _training(workspace: Workspace, points: FixedPoints, name: str, basis: TrialBasis) -> Estimate:
    """Return products of training snapshots with a basis, and where their runs start."""
    projections_of = FieldProjections(basis, mode_fields(basis, points))
    starts, projections, squares = [], [], []
    for _, densities, velocities in mapped_runs(workspace, name):
        starts.append(project(basis, densities[0], velocities[0]))
        compared = compared_snapshots(len(densities))
        found = []
        for first in range(0, len(compared), N_AT_ONCE):
            some = compared[first : first + N_AT_ONCE]
            density, velocity = (
                np.stack([field[int(k)] for k in some]) for field in (densities, velocities)
            )
            found.append(projections_of.products(points.density_scale * density, velocity))
        projections.append(np.concatenate([p for p, _ in found]))
        squares.append(np.concatenate([s for _, s in found]))
    return Estimate(
        unheld=_unheld(workspace, points, name, basis),
        start=np.stack(starts),
        gram=projections_of.gram,
        projections=np.stack(projections),
        squares=np.stack(squares),
    )


def _unheld(
    workspace: Workspace, points: FixedPoints, name: str, basis: TrialBasis
) -> UnheldShares:
    """Return the shares of unseen training snapshots that bases cannot represent."""
    case, trained = workspace.case, workspace.case.plan.bases[name]
    compared = compared_snapshots(case.plan.steps.n_snapshots)
    n_snapshots = len(trained) * len(compared)

    def read(runs: list[Artifact]) -> Iterator[tuple[slice, Array, Array]]:
        for rows in blocks(points.n_points, BLOCK_VALUES // (N_FIELD_VALUES * n_snapshots)):
            density, velocity = (
                np.stack([run.dataset(field)[int(k), rows] for run in runs for k in compared])
                for field in ("density_fluctuation", "velocity")
            )
            yield rows, density, velocity

    with ExitStack() as stack:
        runs = [stack.enter_context(workspace.open(workspace.mapped(point))) for point in trained]
        products = snapshot_products(basis, n_snapshots, points.density_scale, read(runs))
    return unheld_shares(products, places_of(case, trained), basis.n_modes)


LEAST_SNAPSHOTS = 3
"""Of training runs that models can be calibrated with."""


def held_out(
    workspace: Workspace,
    name: str,
    basis: TrialBasis,
    operators: ReducedOperators,
    states: Array,
    runs: Array | None,
    estimate: Estimate | None,
) -> HeldOut | None:
    """Return what training runs choose for calibrated models with a basis.

    None where nothing is known of their errors, or they are too short to calibrate with.

    Raises CaseError when a model needs it all the same.

    Parameters
    ----------
    states : (n_states, n_modes) around which steps have to be stable.
    runs : (n_runs, n_snapshots, n_modes) the projected training runs, if they are kept.
    """
    case = workspace.case
    asked = name in case.plan.sized_bases
    if runs is None or estimate is None or runs.shape[1] < LEAST_SNAPSHOTS:
        if asked:
            raise CaseError(
                f"rom.n_modes: auto needs training runs of {LEAST_SNAPSHOTS} snapshots or more; "
                "see snapshots.every"
            )
        return None
    points = case.plan.bases[name]
    repeated = _Repeated(case, points, basis, operators, states, runs)
    sizes = TrainedSizes(
        places=places_of(case, points),
        projected=runs,
        products=estimate,
        compared=compared_snapshots(case.plan.steps.n_snapshots),
    )
    integrated, every = np.arange(1, sizes.largest + 1), range(len(points))
    if len(points) > 1:
        integrated = choose_integrated(sizes, [repeated.by(int(n), every) for n in integrated])
    error = None
    if asked:
        # Calibrated on all other runs; on itself where there is one.
        learnt = [[other for other in every if other != run] or [run] for run in every]
        errors = [
            held_out_errors(sizes, n_modes, [repeated.by(int(n), some) for some in learnt])
            for n_modes, n in enumerate(integrated, 1)
        ]
        error = np.stack(errors)
    return HeldOut(integrated=integrated, error=error)


@dataclass(frozen=True)
class _Repeated:
    """The training runs, repeated by models of any number of modes."""

    case: Case
    points: Sequence[ParameterPoint]
    basis: TrialBasis
    operators: ReducedOperators
    states: Array
    runs: Array

    def by(self, n_modes: int, learnt: Sequence[int]) -> Array:
        """Return the runs (n_runs, n_snapshots, n_modes) of models calibrated on some of them."""
        modes = kept_modes(self.basis, n_modes)
        operators, runs = self.operators.of_modes(modes), self.runs[..., modes]
        points = [self.points[k] for k in learnt]
        calibration = calibrated(self.case, points, operators, runs[list(learnt)])
        basis, states = truncate(self.basis, n_modes), self.states[:, modes]
        found = [
            self._run(point, basis, operators, calibration, run[0], states)
            for point, run in zip(self.points, runs, strict=True)
        ]
        return np.stack(found)

    def _run(
        self,
        point: ParameterPoint,
        basis: TrialBasis,
        operators: ReducedOperators,
        calibration: Calibration,
        start: Array,
        states: Array,
    ) -> Array:
        """Return the coordinates (n_snapshots, n_modes) of a run; NaN where it isn't stable."""
        case, viscosity = self.case, self.case.plan.kinematic_viscosity(point)
        rates = operators.at(viscosity, factors=point.factors)
        model = ReferenceModel(
            polynomial=rates.plus(calibration.at(viscosity, point.factors)),
            basis=basis,
            start=start,
            output_times=output_times_of(case, case.plan.steps, basis),
            amplitude=amplitude_of(case, point),
        )
        (model,) = reference_model.with_limits([model], states)
        if model.output_times.duration > MAX_STEPS * model.step_limit:
            return np.full((model.output_times.n_snapshots, len(start)), np.nan)
        return reference_model.automatic(model).run().coordinates
