"""What is measured in states of the reference points, from the coordinates alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import Quantities
from sphrom.reduction.forces import ReducedForce
from sphrom.reduction.measures import ReducedMeasure
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.store.forces import drives
from sphrom.store.measures import totals

Array = NDArray[np.float64]


def forces_of(
    case: Case,
    point: ParameterPoint,
    forces: Mapping[str, ReducedForce],
    mean_density_fluctuation: Array | float,
    time: Array,
    coordinates: Array,
) -> dict[str, Array]:
    """Return by measurement the forces and torques (n_snapshots, 2, 3) of states [N/m, N].

    Times are (n_snapshots,) [s], coordinates (n_snapshots, n_modes); the mean that is carried apart
    is (n_snapshots,) or one for all [kg/m3].
    """
    if not forces:
        return {}
    viscosity, (speed, amplitude) = case.plan.kinematic_viscosity(point), drives(case, point, time)
    return {
        name: force.at(coordinates, mean_density_fluctuation, viscosity, speed, amplitude)
        for name, force in forces.items()
    }


def fields_of(
    measures: Mapping[str, ReducedMeasure],
    mean_density_fluctuation: Array | float,
    coordinates: Array,
) -> dict[str, Quantities]:
    """Return by measurement what is measured in the fluid, in states as `forces_of` has them."""
    return {name: m.at(coordinates, mean_density_fluctuation) for name, m in measures.items()}


def quantities_of(
    case: Case, point: ParameterPoint, reduced: ReferenceModel, time: Array, coordinates: Array
) -> dict[str, Quantities]:
    """Return all that a case measures, forces and fields, in coordinates (n_states, n_modes).

    Times are (n_states,) [s]; quantities are (n_states, ...).
    """
    mean = reduced.mean_density_fluctuation
    forces = forces_of(case, point, reduced.forces, mean, time, coordinates)
    found = {name: totals(loads) for name, loads in forces.items()}
    found |= fields_of(reduced.measures, mean, coordinates)
    return {name: found[name] for name in case.scene.measure}
