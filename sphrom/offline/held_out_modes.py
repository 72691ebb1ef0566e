"""How many modes to integrate, and how many to have: chosen by training runs that are held out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts.records.operators import Estimate, HeldOut
from sphrom.case.models import Case
from sphrom.case.plan import MAX_STEPS
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.reduction import integrators
from sphrom.reduction.calibration import Calibration
from sphrom.reduction.error_calibration import FieldProducts, compared_snapshots
from sphrom.reduction.mode_choice import TrainedSizes, choose_integrated, held_out_errors
from sphrom.reduction.polynomial_model import step_limit
from sphrom.reduction.reduced_operators import ReducedOperators
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.reduction.trial_basis import TrialBasis, kept_modes, truncate
from sphrom.setup.assembly import amplitude_of, output_times_of, places_of
from sphrom.store.calibration import calibrated
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]

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
    repeated = _Repeated(case, case.plan.bases[name], basis, operators, states, runs)
    sizes = TrainedSizes(
        places=places_of(case, case.plan.bases[name]),
        projected=runs,
        products=FieldProducts(estimate.gram, estimate.projections, estimate.squares),
        compared=compared_snapshots(case.plan.steps.n_snapshots),
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
        times = output_times_of(case, case.plan.steps, basis)
        amplitude = amplitude_of(case, point)
        strongest = 0.0 if amplitude is None else float(np.abs(amplitude(times.time)).max())
        viscosity = case.plan.kinematic_viscosity(point)
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
        return integrators.automatic(model).run().coordinates[0]
