"""Where a parameter point lies among training points: weights to interpolate with.

Points are given by numbers in which distances count alike, (n_points, n_parameters): logarithms of
parameters that are positive. The weights w are those of linear interpolation in the simplex of
training points around a point (the Delaunay triangulation's): of all w >= 0 with sum w = 1 that
give the point, they have the least sum of w_k d_k^2, d_k the distances. With one parameter
they are those of the two neighbours. Outside of the training points they give the nearest point of
their hull.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEARNESS = 1e-4
"""Weight of the distances beside that of the error at the point."""
ROUNDING = 1e-12
"""Distance over the largest, below which two points are one."""
INSIDE = 1e-6
"""Distance over the farthest training point's, up to which a point lies inside of them."""


def spline_weights(places: Array, place: Array) -> Array:
    """Return weights (n_points,) of the smoothest interpolation, which may be negative.

    It is that of radial cubes and a linear polynomial: with one parameter the natural cubic spline,
    which goes on as a straight line outside. Parameters are those of `interpolation_weights`.
    """
    from scipy.interpolate import RBFInterpolator

    # Points that lie in a plane tell no slope across it.
    spread = np.linalg.matrix_rank(places - places[0]) == places.shape[1]
    kernel, degree = ("cubic", 1) if spread else ("linear", 0)
    interpolate = RBFInterpolator(places, np.eye(len(places)), kernel=kernel, degree=degree)
    return np.asarray(interpolate(place[None])[0])


def interpolation_weights(places: Array, place: Array) -> tuple[Array, float]:
    """Return weights (n_points,) of training points, and the distance of a point from their hull.

    The distance is zero inside.

    Parameters
    ----------
    places : (n_points, n_parameters) of the training points.
    place : (n_parameters,).
    """
    offsets = places - place
    distances = np.linalg.norm(offsets, axis=1)
    largest = float(distances.max())
    if largest == 0.0:
        return np.full(len(places), 1.0 / len(places)), 0.0
    nearest = int(distances.argmin())
    if distances[nearest] <= ROUNDING * largest:
        return np.eye(len(places))[nearest], 0.0
    if len(places) == 1:
        return np.ones(1), float(np.linalg.norm(offsets[0] / largest)) * largest
    # Loading it takes longer than most runs, and at training points nobody asks for it.
    from scipy.optimize import nnls

    scaled, squares = offsets / largest, (distances / largest) ** 2
    # Weights are not negative: the square of their sum of squares is least where that is.
    rows = np.vstack((scaled.T, np.ones(len(places)), NEARNESS * squares))
    target = np.zeros(len(rows))
    target[places.shape[1]] = 1.0
    weights, _ = nnls(rows, target)
    weights /= weights.sum()
    missed = float(np.linalg.norm(weights @ scaled))
    return weights, missed * largest if missed > INSIDE else 0.0
