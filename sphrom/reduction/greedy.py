"""Weak greedy training: which full run to add to the training set next, and when to stop.

The parameter region is the unit cube, in which distances are comparable. The candidates are a dense
set of places in it. Training starts from some corners, estimates the error of the model at every
candidate, and runs the full model where the estimate is largest, until all estimates are within a
tolerance (Buffa et al. 2012, ESAIM: M2AN 46, 595-603).

An estimate is not a bound. Each new full run is therefore first predicted by the model that was
trained without it, and all estimates are multiplied by the largest ratio of error to estimate found
so far, at least one. Training does not end within the tolerance before one such held-out run.

Errors and estimates have one unit. An estimate is infinite where the model has none.
"""

from __future__ import annotations

from itertools import product
from typing import Literal

import numpy as np

from sphrom.arrays import Array, Indices

MOST_CORNERED = 8
"""Largest number of parameters for which all corners of the region are candidates."""
APART = 0.5
"""Least distance between places chosen together, relative to that of the first from the trained
ones."""
NEAR = 0.25
"""Least distance from the trained places, relative to that of the farthest candidate.

Close to a training run the error is that of training, which a further run would not reduce.
"""

Ending = Literal["within", "floor", "budget"]
"""Why training ends: the estimates are within the tolerance ("within"); the basis cannot represent
the training runs to the tolerance ("floor"); or no further run is allowed ("budget")."""


def first_corners(n_parameters: int) -> Array:
    """Return the corners (2 or 4, n_parameters) of the unit cube that training starts from.

    Both ends of every parameter occur: all low, all high, and the first opposite to the others.
    """
    ends = [np.zeros(n_parameters), np.ones(n_parameters)]
    if n_parameters > 1:
        against = np.concatenate(([1.0], np.zeros(n_parameters - 1)))
        ends += [1.0 - against, against]
    return np.array(ends)


def candidate_places(count: int, n_parameters: int, seed: int) -> Array:
    """Return a dense set of places (n, n_parameters) in the unit cube, with its corners.

    They are the first `count` points of a scrambled Sobol sequence, so sets of one seed are nested.
    """
    from scipy.stats import qmc  # importing it takes long

    sequence = qmc.Sobol(n_parameters, rng=seed)
    inside = sequence.random_base2(max(0, (count - 1).bit_length()))[:count]
    if n_parameters > MOST_CORNERED:
        return np.asarray(inside)
    return np.vstack((np.array(list(product((0.0, 1.0), repeat=n_parameters))), inside))


def safety_factor(estimates: Array, errors: Array) -> float:
    """Return the least factor, at least one, with which estimates cover all held-out errors (n,).

    Runs whose estimate or error is infinite do not count.
    """
    known = np.isfinite(estimates) & np.isfinite(errors) & (estimates > 0.0)
    return float(np.max(errors[known] / estimates[known], initial=1.0))


def choose(
    places: Array, estimates: Array, trained: Array, count: int, tolerance: float
) -> Indices:
    """Return up to `count` candidates for full runs: the worst ones, apart from each other.

    The first has the largest estimate of the candidates that are not close to a trained place, even
    if it is within the tolerance; of equal estimates the farthest from these places wins. Further
    ones have estimates above the tolerance, and keep a distance from the earlier ones: half of the
    earlier one's distance from the trained places.

    Parameters
    ----------
    places : (n_candidates, n_parameters).
    estimates : (n_candidates,).
    trained : (n_trained, n_parameters), the places of the existing full runs.
    """
    distances = np.linalg.norm(places[:, None] - trained, axis=2).min(axis=1)
    free = distances > NEAR * distances.max()
    chosen: list[int] = []
    while len(chosen) < count and free.any():
        # The sort keys are the estimate, then the distance, then the order.
        order = np.lexsort((-np.arange(len(places)), distances, estimates))
        worst = int(next(k for k in order[::-1] if free[k]))
        if chosen and not estimates[worst] > tolerance:
            break
        chosen.append(worst)
        free &= np.linalg.norm(places - places[worst], axis=1) > APART * distances[worst]
    return np.array(chosen, dtype=np.int64)


def ending(
    worst_estimate: float, floor: float, tolerance: float, *, n_held_out: int, n_left: int
) -> Ending | None:
    """Return why training ends, or None if it continues.

    Parameters
    ----------
    worst_estimate : over all candidates, times the safety factor.
    floor : largest error of the best approximation of a training run in the basis.
    n_held_out : number of runs that were predicted before training on them.
    n_left : number of full runs left in the budget.
    """
    if floor > tolerance:
        return "floor"
    if n_held_out and worst_estimate <= tolerance:
        return "within"
    return None if n_left > 0 else "budget"
