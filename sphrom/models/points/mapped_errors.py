"""Errors of models on the reference points in mapped full runs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sphrom.arrays import Array, Mask
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import Measured
from sphrom.models.points.fast_model import FastModel, FastRun
from sphrom.models.points.quantities import quantities_of
from sphrom.reduction.trial_basis import (
    TrialBasis,
    mean_density_fluctuation,
    project,
    reconstruct,
    weighted_mean,
)

N_BLOCK_SNAPSHOTS = 16
"""Number of snapshots to read at once."""


def compared(
    fast: FastModel,
    point: ParameterPoint,
    run: FastRun | None,
    counted: Callable[[Array], Mask],
) -> tuple[Array, Array, Array, Callable[[], Measured]]:
    """Return sums of squares (2,) over times: of a run's errors, of the nearest states', of fields.

    The first are zero without a run. The last result returns the nearest states' measurements.
    """
    model = fast.at_point(point)
    basis = model.basis
    error, floor, size = np.zeros((3, 2))
    coordinates = []
    with fast.workspace.open(fast.workspace.mapped(point)) as mapped:
        time = mapped.read("time")
        chosen = np.flatnonzero(counted(time))
        end = chosen[-1] + 1
        for begin in range(chosen[0], end, N_BLOCK_SNAPSHOTS):
            block = slice(begin, min(begin + N_BLOCK_SNAPSHOTS, end))
            density = mapped.dataset("density_fluctuation")[block]
            velocity = mapped.dataset("velocity")[block]
            fields = _fields(basis, density, velocity)
            size += _squares(basis, fields)
            mean = mean_density_fluctuation(basis, density)
            coordinates.append(project(basis, density, velocity))
            best = reconstruct(basis, coordinates[-1], mean)
            floor += _squares(basis, _fields(basis, best[0], best[1]), fields)
            if run is not None:
                mean = np.full(len(density), run.reduced.mean_density_fluctuation)
                state = reconstruct(model.whole, run.states[block], mean)
                error += _squares(basis, _fields(basis, state[0], state[1]), fields)

    def nearest() -> Measured:
        reduced = fast.at(point) if run is None else run.reduced
        case = fast.workspace.case
        return quantities_of(case, reduced, time[chosen], np.concatenate(coordinates))

    return error, floor, size, nearest


Fields = tuple[Array, Array]
"""Velocities (n_snapshots, n_points, 2), and densities (n_snapshots, n_points) minus their
means."""


def _fields(basis: TrialBasis, density: Array, velocity: Array) -> Fields:
    return velocity, density - weighted_mean(density, basis.weights)[:, None]


def _squares(basis: TrialBasis, fields: Fields, others: Fields | None = None) -> Array:
    """Return sums of squares (2,) over points and snapshots, of fields or of their differences."""
    velocity, density = fields
    if others is not None:
        velocity, density = velocity - others[0], density - others[1]
    of_velocity = np.sum(np.sum(velocity**2, axis=2) @ basis.weights)
    return np.array([of_velocity, np.sum(density**2 @ basis.weights)])
