"""Forces on walls in states of the reference points, from the coordinates alone."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.reduction.forces import ReducedForce
from sphrom.store.forces import drives

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
    viscosity, (speed, amplitude) = case.kinematic_viscosity(point), drives(case, point, time)
    return {
        name: force.at(coordinates, mean_density_fluctuation, viscosity, speed, amplitude)
        for name, force in forces.items()
    }
