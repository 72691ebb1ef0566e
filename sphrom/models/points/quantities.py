"""Measurements of states of models on the reference points."""

from __future__ import annotations

import numpy as np

from sphrom.arrays import Array
from sphrom.case.models import Case
from sphrom.metrics.measures import Quantities, with_coefficients
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.store.trajectory import totals


def forces_of(
    reduced: ReferenceModel,
    time: Array,
    coordinates: Array,
    mean: Array | float | None = None,
    own: Array | None = None,
) -> dict[str, Array]:
    """Return the forces and torques (n_states, 2, 3) of states [N/m, N], by measurement.

    Parameters
    ----------
    time : (n_states,) [s].
    coordinates : (n_states, n_modes).
    mean : separate density fluctuation [kg/m3], (n_states,) or one; by default the model's own.
    own : (n_states, n_own_modes) of separate pressure modes; by default as the model has them.
    """
    mean = reduced.mean_density_fluctuation if mean is None else mean
    if not reduced.forces:
        return {}
    amplitude = reduced.amplitudes(time)
    rates = reduced.polynomial.along(coordinates, amplitude)
    if own is None and any(force.own is not None for force in reduced.forces.values()):
        own = reduced.with_pressure(time, coordinates)[..., coordinates.shape[-1] :]
    states = time, coordinates, rates, amplitude, mean, own
    return {name: force.at(*states) for name, force in reduced.forces.items()}


def quantities_of(
    case: Case,
    reduced: ReferenceModel,
    time: Array,
    coordinates: Array,
    mean: Array | float | None = None,
    own: Array | None = None,
) -> dict[str, Quantities]:
    """Return all measurements (n_states, ...) of a case or model, for states as in `forces_of`."""
    mean = reduced.mean_density_fluctuation if mean is None else mean
    if own is None:
        own = reduced.with_pressure(time, coordinates)[..., coordinates.shape[-1] :]
    forces = forces_of(reduced, time, coordinates, mean, own)
    n_dim = case.scene.domain.n_dim
    measured = {name: totals(loads, n_dim) for name, loads in forces.items()}
    if reduced.measures:
        measured |= reduced.measured(np.concatenate((coordinates, own), axis=-1), mean)
    ordered = {name: measured[name] for name in (*case.scene.recorded, *measured)}
    return with_coefficients(ordered, case.plan.coefficients)
