"""Interpolation between training points, and correction of runs by their defects there.

A point is an array (n_points, n_parameters) of scaled parameters, whose distances are comparable:
positive parameters enter by their logarithms. The weights w of `interpolation_weights` are those of
linear interpolation in the simplex of training points around the point (the Delaunay
triangulation): of all w >= 0 with sum w = 1 that reproduce the point, they minimise the sum of
w_k d_k^2, where d_k are the distances. With one parameter they are those of the two neighbours.
Outside the convex hull of the training points, they are those of the nearest point of the hull.

At the training points k the defects d_k = Phi^T x_k - a_k are known, as x_k is the full run. At
other points the corrected coordinates are a(t) + sum_k w_k d_k(t), with the weights of kriging
(`docs/fast-models.md`) with mean zero and the correlation exp(-|p - p_k| / l):

    w = K^-1 (exp(-|p - p_k| / l))_k,    K_jk = exp(-|p_j - p_k| / l).

The length l is chosen by leave-one-out cross-validation: it minimises the sum over the runs of
|e_k|^2 with e_k = (K^-1 d)_k / (K^-1)_kk (Dubrule 1983). Defects that differ from run to run, such
as sound with a random phase, are therefore hardly added.

All modes share one length. Pressure is a small difference of large contributions of modes. A sum of
states with the same weights for all modes keeps such relations between modes; with one length per
mode, the pressure error in channels grew by up to a half. Modes that a model does not integrate are
zero in its runs; they have a length of their own.

In a run that is longer than the training runs, the correction fades out before their end.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.declaration import Labels, Record, dataset, labelled

NEARNESS = 1e-4
"""Weight of the squared distances relative to the error in reproducing the point."""
EVENNESS = 1e-6
"""Weight of the weights' norm, which decides where several sets of points are equally near."""
ROUNDING = 1e-12
"""Two points closer than this share of the largest distance are the same."""
INSIDE = 1e-6
"""A point is inside the hull up to this distance, relative to that of the farthest training
point."""


def spline_weights(places: Array, place: Array) -> Array:
    """Return weights (n_points,) of the smoothest interpolation; they may be negative.

    The interpolant is a sum of radial cubes and a linear polynomial. With one parameter it is the
    natural cubic spline, which is linear outside. Parameters: see `interpolation_weights`.
    """
    n_points = len(places)
    size = float(np.ptp(places, axis=0).max()) or 1.0
    points = (np.vstack((places, place)) - places.mean(axis=0)) / size
    distances = np.linalg.norm(points[:, None] - points[:-1], axis=2)
    # Points in a plane do not determine the slope across it.
    spread = np.linalg.matrix_rank(places - places[0]) == places.shape[1]
    radial = distances**3 if spread else -distances
    polynomial = np.column_stack((np.ones(n_points + 1), *(points.T if spread else ())))
    zero = np.zeros((polynomial.shape[1],) * 2)
    system = np.block([[radial[:-1], polynomial[:-1]], [polynomial[:-1].T, zero]])
    return np.linalg.solve(system, np.append(radial[-1], polynomial[-1]))[:n_points]


def interpolation_weights(places: Array, place: Array) -> tuple[Array, float]:
    """Return weights (n_points,) of the training points, and a point's distance from their hull.

    The distance is zero inside the hull.

    Parameters
    ----------
    places : (n_points, n_parameters), the training points.
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
    if places.shape[1] == 1:
        order = np.argsort(places[:, 0])
        along = places[order, 0]
        within = np.clip(place[0], along[0], along[-1])
        weights = np.array([np.interp(within, along, row) for row in np.eye(len(places))[:, order]])
        missed = float(abs(place[0] - within))
        return weights, missed if missed > INSIDE * largest else 0.0
    if len(places) == 1:
        return np.ones(1), float(np.linalg.norm(offsets[0] / largest)) * largest
    # Importing the solver takes longer than most runs; one parameter does not need it.
    from scipy.optimize import nnls

    scaled, squares = offsets / largest, (distances / largest) ** 2
    # Weights are nonnegative, so minimising the square of their weighted sum minimises the sum.
    evenness = EVENNESS * np.eye(len(places))  # the corners of a rectangle are equally near
    rows = np.vstack((scaled.T, np.ones(len(places)), NEARNESS * squares, evenness))
    target = np.zeros(len(rows))
    target[places.shape[1]] = 1.0
    weights, _ = nnls(rows, target)
    weights /= weights.sum()
    missed = float(np.linalg.norm(weights @ scaled))
    return weights, missed * largest if missed > INSIDE else 0.0


CORRELATIONS = np.concatenate(([1e-6], np.linspace(0.02, 0.98, 49), [1.0 - 1e-6]))
"""Candidate correlations of the defects at the two training points that are farthest apart."""
WORTHWHILE = 0.9
"""Largest share of the squared defects that may remain in held-out runs, for a correction to apply.

With shedding in the open cavity, whose phase depends on the parameter, the share is 0.9 to 1, and a
correction does not help.
"""
FADED = 0.1
"""Final share of the trained time over which the correction of longer runs fades out."""


UNLIMITED = 1e99
"""A correlation length beside which all distances vanish; stored values are finite."""
PLACES = Labels("1", "parameters of the training runs, scaled so that distances are comparable")


class Correction(Record):
    """The defects at the training points and their correlation lengths."""

    places: Array = labelled("corrected_run parameter", PLACES)
    defects: Array = dataset(
        "corrected_run snapshot output",
        "of the outputs",
        "errors of a model in its training runs",
        "d",
    )
    lengths: Array = dataset(
        "output", "1", "correlation lengths of the defects; zero without a correction", "l"
    )

    def at(self, place: Array) -> Array:
        """Return the correction (..., n_snapshots, n_modes) at places (..., n_parameters)."""
        reach = np.linalg.norm(self.places - place[..., None, :], axis=-1)[..., None]
        correction = np.zeros((*place.shape[:-1], *self.defects.shape[1:]))
        for modes, length, alike, defects in self._groups:
            weights = np.linalg.solve(alike, np.exp(-reach / length)).swapaxes(-1, -2)
            added = (weights @ defects).reshape(*correction.shape[:-1], len(modes))
            correction[..., modes] = added
        return correction

    @cached_property
    def _groups(self) -> list[tuple[Indices, float, Array, Array]]:
        """The modes of each correlation length, the length, K, and the defects as rows."""
        between = _distances(self.places, self.places)
        found = []
        for length in np.unique(self.lengths[self.lengths > 0.0]).tolist():
            modes = np.flatnonzero(self.lengths == length)
            defects = self.defects[..., modes]
            rows = defects.reshape(len(defects), math.prod(defects.shape[1:]))
            found.append((modes, length, np.exp(-between / length), rows))
        return found

    def held_out(self, place: Array) -> Array:
        """Return a training run's correction (n_snapshots, n_modes) from the other runs."""
        others = np.any(self.places != place, axis=1)
        return replace(self, places=self.places[others], defects=self.defects[others]).at(place)


def learn_correction(
    places: Array, defects: Array, groups: Sequence[Indices] = (), worthwhile: float = WORTHWHILE
) -> Correction | None:
    """Fit the correlation lengths of the defects (n_runs, n_snapshots, n_modes) of training runs.

    Runs with defects that are not finite are left out. Return None if fewer than two runs remain,
    or if the runs predict too little of each other's defects.

    Parameters
    ----------
    places : (n_runs, n_parameters), scaled so that distances are comparable; all different.
    groups : of modes with a common length; a group that is predicted too poorly has no correction.
        By default all modes are one group.
    worthwhile : largest share of the squared defects that may remain in held-out runs.
    """
    finite = np.isfinite(defects).all(axis=(1, 2))
    places, defects = places[finite], defects[finite]
    if len(places) < 2:
        return None
    between = _distances(places, places)
    lengths = -between.max() / np.log(CORRELATIONS)
    missed = np.empty((len(lengths), defects.shape[2]))  # squared leave-one-out errors
    for k, length in enumerate(lengths):
        inverse = np.linalg.inv(np.exp(-between / length))
        errors = np.einsum("jk,ksm->jsm", inverse / np.diag(inverse)[:, None], defects)
        missed[k] = np.sum(errors**2, axis=(0, 1))
    total = np.sum(defects**2, axis=(0, 1))
    chosen = np.zeros(defects.shape[2])
    for modes in groups or (np.arange(len(total)),):
        left = missed[:, modes].sum(axis=1)
        if left.min() <= worthwhile * total[modes].sum():
            chosen[modes] = lengths[left.argmin()]
    if not chosen.any():
        return None
    return Correction(places=places, defects=defects, lengths=chosen)


def interpolated(
    places: Array, defects: Array, groups: Sequence[Indices] = ()
) -> Correction | None:
    """Return the interpolation of defects, even if training runs predict each other's poorly.

    That of a single run is constant. Parameters: see `learn_correction`.
    """
    correction = learn_correction(places, defects, groups, worthwhile=math.inf)
    if len(places) == 1 and np.isfinite(defects).all():
        # A single run does not determine the correlation length.
        lengths = np.full(defects.shape[2], UNLIMITED)
        correction = Correction(places=places, defects=defects, lengths=lengths)
    return correction


def faded(correction: Array, n_snapshots: int) -> Array:
    """Return a correction (..., n_trained, n_modes) over `n_snapshots` equally spaced snapshots."""
    n_trained = correction.shape[-2]
    if n_snapshots <= n_trained:
        return correction[..., :n_snapshots, :]
    rest = np.arange(n_trained - 1, -1, -1) / max(1.0, FADED * (n_trained - 1))
    # The square of a sine: value and slope are continuous.
    share = np.sin(0.5 * np.pi * np.minimum(rest, 1.0)) ** 2
    out = np.zeros((*correction.shape[:-2], n_snapshots, correction.shape[-1]))
    out[..., :n_trained, :] = share[:, None] * correction
    return out


def _distances(places: Array, others: Array) -> Array:
    return np.asarray(np.linalg.norm(places[:, None] - others, axis=2))
