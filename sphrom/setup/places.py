"""Coordinates of parameter points, and whether a basis was trained at them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.reduction.correction import interpolation_weights

Array = NDArray[np.float64]


def places_of(case: Case, points: Sequence[ParameterPoint]) -> Array:
    """Return where points are (n_points, n_parameters): parameters count by their ratios.

    Those beside the Reynolds number may be negative: they count over the largest that is trained.
    """
    places = np.log([[point.reynolds] for point in points])
    if len(case.parameter_names) == 1:
        return places
    trained = np.array([list(point.factors.values()) for point in case.train_points])
    sizes = np.abs(trained).max(axis=0)
    others = np.array([list(point.factors.values()) for point in points])
    return np.hstack((places, others / np.where(sizes > 0.0, sizes, 1.0)))


def role_of(case: Case, basis: str, point: ParameterPoint) -> str:
    """Return `trained` for a point that a basis was trained at, else `predicted`.

    Outside of the range of its training points it is `extrapolated`.
    """
    trained = case.bases[basis]
    if point in trained:
        return "trained"
    places = places_of(case, trained), places_of(case, [point])[0]
    _, distance = interpolation_weights(*places)
    return "extrapolated" if distance > 0.0 else "predicted"
