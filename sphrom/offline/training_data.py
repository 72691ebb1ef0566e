"""The data of error estimates in the operators' artifact, with which no run needs the points.

It is the factor of the residual, and products of some training snapshots with the basis, from which
the errors of reduced training runs follow.

How many modes to integrate, and how many to have: chosen by training runs that are held out.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.reader import DatasetReader
from sphrom.artifacts.records.operators import Estimate, HeldOut
from sphrom.case.models import Case
from sphrom.case.plan import MAX_STEPS, has_error_estimate, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.reduction import reference_model
from sphrom.reduction.calibration import Calibration
from sphrom.reduction.error_calibration import compared_snapshots
from sphrom.reduction.held_out import (
    ProductSums,
    TrainedSizes,
    UnheldShares,
    choose_integrated,
    held_out_errors,
    unheld_shares,
)
from sphrom.reduction.mode_fields import BLOCK_VALUES, FieldProjections, blocks, mode_fields
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.pod import N_FIELD_VALUES
from sphrom.reduction.polynomial_model import step_limit
from sphrom.reduction.reduced_operators import ReducedOperators, ResidualFactor
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.reduction.residual_factor import residual_factor
from sphrom.reduction.trial_basis import TrialBasis, kept_modes, project, truncate
from sphrom.setup import assembly
from sphrom.setup.places import places_of
from sphrom.setup.reduced_runs import amplitude_of, output_times_of
from sphrom.sph.fixed_points import FixedPoints
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
    return factor, _training(workspace, points, name, basis)


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
    asked = name in case.sized_bases
    if runs is None or estimate is None or runs.shape[1] < LEAST_SNAPSHOTS:
        if asked:
            raise CaseError(
                f"rom.n_modes: auto needs training runs of {LEAST_SNAPSHOTS} snapshots or more; "
                "see snapshots.every"
            )
        return None
    repeated = _Repeated(case, case.bases[name], basis, operators, states, runs)
    sizes = TrainedSizes(
        places=places_of(case, case.bases[name]),
        projected=runs,
        products=estimate,
        compared=compared_snapshots(step_plan(case).n_snapshots),
        n_parts=len(basis.singular_values),
    )
    integrated = np.arange(1, sizes.largest + 1)
    if len(runs) > 1:
        integrated = choose_integrated(sizes, [repeated.all(int(n)) for n in integrated])
    error = None
    if asked:
        error = np.stack(
            [
                held_out_errors(sizes, n_modes, repeated.without_each(int(n)))
                for n_modes, n in enumerate(integrated, 1)
            ]
        )
    return HeldOut(integrated=integrated, error=error)


class _Repeated:
    """The training runs, repeated by models of any number of modes."""

    def __init__(
        self,
        case: Case,
        points: Sequence[ParameterPoint],
        basis: TrialBasis,
        operators: ReducedOperators,
        states: Array,
        runs: Array,
    ) -> None:
        self._case, self._points, self._basis = case, points, basis
        self._operators, self._states, self._runs = operators, states, runs

    def all(self, n_modes: int) -> Array:
        """Return the runs (n_runs, n_snapshots, n_modes) of models calibrated on all of them."""
        return self._integrated(n_modes, range(len(self._points)))

    def without_each(self, n_modes: int) -> list[Array]:
        """Return those calibrated on all others, for each run; on itself where there is one."""
        runs = range(len(self._points))
        return [
            self._integrated(n_modes, [other for other in runs if other != run] or [run])
            for run in runs
        ]

    def _integrated(self, n_modes: int, learnt: Sequence[int]) -> Array:
        modes = kept_modes(self._basis, n_modes)
        operators, runs = self._operators.of_modes(modes), self._runs[..., modes]
        points = [self._points[k] for k in learnt]
        calibration = calibrated(self._case, points, operators, runs[list(learnt)])
        basis, states = truncate(self._basis, n_modes), self._states[:, modes]
        return np.stack(
            [
                self._run(point, basis, operators, calibration, run[0], states)
                for point, run in zip(self._points, runs, strict=True)
            ]
        )

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
        case = self._case
        times = output_times_of(case, step_plan(case), basis)
        amplitude = amplitude_of(case, point)
        strongest = 0.0 if amplitude is None else float(np.abs(amplitude(times.time)).max())
        viscosity = case.kinematic_viscosity(point)
        rates = operators.at(viscosity, factors=point.factors)
        polynomial = rates.plus(calibration.at(viscosity, point.factors))
        limit = step_limit(polynomial, np.vstack((start, states)), strongest)
        model = ReferenceModel(
            polynomial=polynomial,
            basis=basis,
            start=start,
            output_times=times,
            mean_density_fluctuation=0.0,
            step_limit=limit,
            amplitude=amplitude,
            linear=polynomial.jacobian(states.mean(axis=0), strongest),
        )
        if times.duration > MAX_STEPS * limit:
            return np.full((times.n_snapshots, len(start)), np.nan)
        return reference_model.automatic(model).run().coordinates[0]
