"""The space of own pressures of fast models, from mapped training runs, and the choice of one."""

from __future__ import annotations

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.models.reference.stored import mapped_runs
from sphrom.plots.tables import format_figure
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.operator_projection import project_pressure
from sphrom.reduction.own_pressure import (
    CANDIDATES,
    JOINT,
    WIDER,
    PressureSpace,
    expected_errors,
    pressure_modes,
)
from sphrom.reduction.trained_basis import TrainedBasis
from sphrom.reduction.trial_basis import TrialBasis, weighted_mean
from sphrom.sph.fixed_points import FixedPoints
from sphrom.store.workspace import Workspace

N_AT_ONCE = 10
"""Number of snapshots read at once."""


def pressure_space(
    workspace: Workspace,
    points: FixedPoints,
    name: str,
    basis: TrialBasis,
    splines: ModeSplines,
    compared: Indices,
) -> tuple[PressureSpace, Array] | None:
    """Return the space of training pressures, and all its modes q (n_pressure_modes, n_points).

    None with a single training run, because none can be held out, and with the raw inner product.

    Parameters
    ----------
    name : of the basis.
    compared : the numbers of the snapshots that determine the modes.
    """
    n_runs = len(workspace.case.plan.bases[name])
    if n_runs < 2 or basis.inner_product.name == "raw":
        return None
    weights = basis.weights

    def pressure_of(densities: Array) -> Array:
        """Return the pressure minus its mean, q (n_snapshots, n_points) [m/s]."""
        means = weighted_mean(densities, weights)
        return points.density_scale * (densities - means[:, None])

    some = (
        pressure_of(densities[list(compared)]) for _, densities, _ in mapped_runs(workspace, name)
    )
    modes = pressure_modes(some, weights, WIDER * basis.n_modes)
    if not len(modes):
        return None
    coordinates, squares = [], []
    for _, densities, _ in mapped_runs(workspace, name):
        for first in range(0, len(densities), N_AT_ONCE):
            pressures = pressure_of(densities[first : first + N_AT_ONCE])
            coordinates.append((pressures * weights) @ modes.T)
            squares.append(pressures**2 @ weights)
    space = PressureSpace(
        **vars(project_pressure(points, basis, splines, modes)),
        modes=modes[: basis.n_modes],
        coordinates=np.concatenate(coordinates).reshape(n_runs, -1, len(modes)),
        squares=np.concatenate(squares).reshape(n_runs, -1),
    )
    return space, modes


def report_pressure(workspace: Workspace, model: str, basis: str, trained: TrainedBasis) -> None:
    """Report the expected errors of all candidates for the pressure, and the chosen one."""
    if (errors := trained.pressure_errors) is None:
        return
    (chosen,) = trained.pressure or (JOINT,)
    expected = map(format_figure, 100.0 * expected_errors(errors, trained.places))
    workspace.context.report.table(
        f"pressure of {model}, basis {basis}: training runs choose {chosen}",
        ("pressure", "expected error [%]"),
        list(zip(CANDIDATES, expected, strict=True)),
    )
