"""Which points of a basis to sample: a few rows that tell its coordinates nearly as all of them do.

A sample is a point with all of its fields. `random` draws points; `q-deim` takes the pivots of a QR
factorisation (Drmac & Gugercin 2016), again and again until there are enough; `s-opt` adds to the
first of these whichever point raises most how long and how orthogonal the sampled columns are (S of
Shin & Xiu 2016, chosen greedily as by Lauzon et al. 2024).

Shapes: modes (n_points, n_fields, n_modes), weighted such that they are orthonormal in all rows.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

from sphrom.reduction.trial_basis import TrialBasis

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Method = Literal["random", "q-deim", "s-opt"]

N_CANDIDATES = 5_000
"""Points, drawn at random where there are more, that S-optimality looks at for every sample."""
WORST_CONDITION_NUMBER = 1e6
"""Of sampled modes: beyond it what is no mode counts for more than the modes."""


def weighted_modes(basis: TrialBasis) -> Array:
    """Return the modes of a basis, weighted with the roots of its weights."""
    modes = np.concatenate((basis.density_modes[..., None], basis.velocity_modes), axis=2)
    return np.ascontiguousarray(modes.transpose(1, 2, 0)) * np.sqrt(basis.weights)[:, None, None]


def choose_points(modes: Array, n_samples: int, method: Method, seed: int = 0) -> Indices:
    """Return the points (n_samples,) to sample, rising; all of them where there are no more.

    Raises
    ------
    ValueError
        When the sampled modes are too near to dependent to tell coordinates.
    """
    n_points = len(modes)
    random = np.random.default_rng(seed)
    if n_samples >= n_points:
        return np.arange(n_points)
    if method == "random":
        chosen = random.choice(n_points, n_samples, replace=False)
    elif method == "q-deim":
        chosen = _pivots(modes, n_samples)
    else:
        n_candidates = min(n_points, max(N_CANDIDATES, n_samples))
        drawn = random.choice(n_points, n_candidates, replace=False)
        chosen = drawn[_s_optimal(modes[drawn], n_samples)]
    chosen = np.sort(chosen)
    gappy_projection(modes[chosen])
    return chosen


def gappy_projection(sampled: Array) -> Array:
    """Return what gives coordinates from weighted fields at samples (n_modes, n_samples, n_fields).

    The coordinates are those whose state is nearest at the samples (Everson & Sirovich 1995).

    Raises
    ------
    ValueError
        When the sampled modes are too near to dependent.
    """
    rows = sampled.reshape(-1, sampled.shape[2])
    values = np.linalg.svd(rows, compute_uv=False)
    if rows.shape[0] < rows.shape[1] or values[0] > WORST_CONDITION_NUMBER * values[-1]:
        raise ValueError(f"{len(sampled)} samples do not tell {rows.shape[1]} modes apart")
    return np.asarray(np.linalg.pinv(rows)).reshape(-1, *sampled.shape[:2])


def _pivots(modes: Array, n_samples: int) -> Indices:
    """Return points by repeated pivoted QR, in the order of their pivots."""
    n_fields, n_modes = modes.shape[1:]
    left, chosen = np.arange(len(modes)), np.empty(0, dtype=np.int64)
    while len(chosen) < n_samples:
        _, order = linalg.qr(modes[left].reshape(-1, n_modes).T, mode="r", pivoting=True)
        points = order[:n_modes] // n_fields
        first = points[np.sort(np.unique(points, return_index=True)[1])]
        first = first[: n_samples - len(chosen)]
        chosen = np.append(chosen, left[first])
        left = np.delete(left, first)
    return chosen


def _s_optimal(modes: Array, n_samples: int) -> Indices:
    """Return points such that S of the sampled modes is large, chosen one by one."""
    n_fields, n_modes = modes.shape[1:]
    # As few as hold every mode: the determinant of fewer rows is zero whatever they are.
    chosen = list(_pivots(modes, min(n_modes, n_samples)))
    squares = np.einsum("nfm,nfm->nm", modes, modes)
    gram = np.einsum("nfm,nfk->mk", modes[chosen], modes[chosen])
    while len(chosen) < n_samples:
        solved = modes @ np.linalg.inv(gram)
        growth = np.eye(n_fields) + np.einsum("nfm,ngm->nfg", solved, modes)
        gain = np.linalg.slogdet(growth)[1] - np.log(np.diag(gram) + squares).sum(axis=1)
        gain[chosen] = -np.inf
        chosen.append(int(np.argmax(gain)))
        gram = gram + modes[chosen[-1]].T @ modes[chosen[-1]]
    return np.array(chosen)
