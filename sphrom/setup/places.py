"""Coordinates of parameter points, and whether a basis was trained at them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.reduction.interpolation_weights import interpolation_weights

Array = NDArray[np.float64]


def places_of(points: Sequence[ParameterPoint]) -> Array:
    """Return the logarithms of the parameters (n_points, n_parameters), so that ratios count."""
    return np.log([list(point.as_dict().values()) for point in points])


def role_of(case: Case, basis: str, point: ParameterPoint) -> str:
    """Return `trained` for a point that a basis was trained at, else `predicted`.

    Outside of the range of its training points it is `extrapolated`.
    """
    trained = case.bases[basis]
    if point in trained:
        return "trained"
    _, distance = interpolation_weights(places_of(trained), places_of([point])[0])
    return "extrapolated" if distance > 0.0 else "predicted"
