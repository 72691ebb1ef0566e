"""Weak greedy training: which full run a reduced model learns from next, and when it may stop.

The region of the parameters is the unit cube, in which distances count alike. Its candidates are a
dense set of places. Training starts from some corners, estimates the error of the model at every
candidate, and runs the full model where the estimate is largest, until it is within a tolerance
everywhere (Buffa et al. 2012, ESAIM: M2AN 46, 595-603).

An estimate is no bound. So each full run is first predicted by the model that hasn't seen it, and
the estimates are multiplied by the largest ratio of error to estimate that such runs have shown, at
least one. Nothing is within the tolerance before one run was held out.

Errors and estimates are in one unit; an estimate is infinite where a model has none, as where its
run diverges.
"""

from __future__ import annotations

from itertools import product
from typing import Literal

import numpy as np

from sphrom.arrays import Array, Indices

MOST_CORNERED = 8
"""Parameters up to which all corners of the region are candidates."""
APART = 0.5
"""Distance of places that are chosen together, over that of the first from the trained ones."""
NEAR = 0.25
"""Least distance from the trained places, over that of the candidate that is farthest from them.

Next to a training run the error is what training leaves there: a further run, which would tell
little new, doesn't change it.
"""

Ending = Literal["within", "floor", "budget"]
"""Why training ends: the estimate is within the tolerance; the best approximations of training
runs aren't; or there may be no further run."""


def first_corners(n_parameters: int) -> Array:
    """Return the corners (2 or 4, n_parameters) of the unit cube that training starts from.

    Every parameter has both ends there: all are low, all high, and the first is against the others.
    """
    ends = [np.zeros(n_parameters), np.ones(n_parameters)]
    if n_parameters > 1:
        against = np.concatenate(([1.0], np.zeros(n_parameters - 1)))
        ends += [1.0 - against, against]
    return np.array(ends)


def candidate_places(count: int, n_parameters: int, seed: int) -> Array:
    """Return a dense set of places (n, n_parameters) in the unit cube, and its corners.

    They are the first `count` of a scrambled Sobol sequence; a longer set begins with a shorter.
    """
    from scipy.stats import qmc  # it takes long to load

    sequence = qmc.Sobol(n_parameters, rng=seed)
    inside = sequence.random_base2(max(0, (count - 1).bit_length()))[:count]
    if n_parameters > MOST_CORNERED:
        return np.asarray(inside)
    return np.vstack((np.array(list(product((0.0, 1.0), repeat=n_parameters))), inside))


def safety_factor(estimates: Array, errors: Array) -> float:
    """Return the factor on estimates that covers all errors (n,) of runs held out, at least one.

    Runs without an estimate or an error, infinite here, don't count.
    """
    known = np.isfinite(estimates) & np.isfinite(errors) & (estimates > 0.0)
    return float(np.max(errors[known] / estimates[known], initial=1.0))


def choose(
    places: Array, estimates: Array, trained: Array, count: int, tolerance: float
) -> Indices:
    """Return up to `count` candidates to run the full model at: the worst, apart from each other.

    The first has the largest estimate of those that aren't next to a trained place, within the
    tolerance or not; of equal ones it is the farthest from these places. Further ones are beyond
    the tolerance, and not within half of the distance of an earlier one from the trained places.

    Parameters
    ----------
    places : (n_candidates, n_parameters).
    estimates : (n_candidates,).
    trained : (n_trained, n_parameters), where there is nothing to run.
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
    """Return why training ends, None where it goes on.

    Parameters
    ----------
    worst_estimate : over all candidates, corrected.
    floor : largest error of the best approximations of training runs in the basis.
    n_held_out : runs that were predicted before they were learnt from.
    n_left : full runs that the budget has left.
    """
    if floor > tolerance:
        return "floor"
    if n_held_out and worst_estimate <= tolerance:
        return "within"
    return None if n_left > 0 else "budget"
