"""Interpolation between training points, and defect correction of runs at other parameters.

Points are given by numbers in which distances count alike, (n_points, n_parameters): logarithms of
parameters that are positive. The weights w are those of linear interpolation in the simplex of
training points around a point (the Delaunay triangulation's): of all w >= 0 with sum w = 1 that
give the point, they have the least sum of w_k d_k^2, d_k the distances. With one parameter
they are those of the two neighbours. Outside of the training points they give the nearest point of
their hull.

Rates that are projected on fixed points miss what moving particles do: their noise, which has modes
of its own, and slow drifts. At training points k the defects d_k = Phi^T x_k - a_k are known, of
projected full runs from the model's own. Elsewhere the coordinates of a run become

    a(t) + sum_k w_k d_k(t).

The weights w are those of kriging (Gaussian-process regression) with mean zero and the correlation
exp(-|p - p_k| / l) of defects at a distance in the parameters:

    w = K^-1 (exp(-|p - p_k| / l))_k,    K_jk = exp(-|p_j - p_k| / l).

With a long l they interpolate linearly between neighbours, and outside of the training points give
the nearest defect; with a short one they vanish away from the training points. The length l is the
one with which runs are predicted best from the others, the sum over the runs of |e_k|^2 with

    e_k = (K^-1 d)_k / (K^-1)_kk

(Dubrule 1983). So defects that other runs do not share, such as sound that has lost its phase, are
hardly added; where the others predict little of them there is no correction. At training points the
corrected coordinates are the projected full run's.

All modes have one length. Pressure is a small difference of what modes contribute, and a sum of
states with the same weights for all modes keeps such relations between modes; with a length for
each mode, the pressure in channels was off by up to half as much again.

A model may integrate its first modes alone. The coordinates of the others are zero in its runs, so
that their defects are the training runs' coordinates themselves. Both groups of modes have a length
of their own, and whether they are worth it is asked of them separately.

A run that goes on beyond the trained time has its correction faded out before, and none after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sphrom.arrays import Array, Indices

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
    n_points, size = len(places), float(np.ptp(places, axis=0).max()) or 1.0
    points = (np.vstack((places, place)) - places.mean(axis=0)) / size
    distances = np.linalg.norm(points[:, None] - points[:-1], axis=2)
    # Points that lie in a plane tell no slope across it.
    spread = np.linalg.matrix_rank(places - places[0]) == places.shape[1]
    radial = distances**3 if spread else -distances
    polynomial = np.column_stack((np.ones(n_points + 1), *(points.T if spread else ())))
    zero = np.zeros((polynomial.shape[1],) * 2)
    system = np.block([[radial[:-1], polynomial[:-1]], [polynomial[:-1].T, zero]])
    return np.linalg.solve(system, np.append(radial[-1], polynomial[-1]))[:n_points]


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
    if places.shape[1] == 1:
        order = np.argsort(places[:, 0])
        along = places[order, 0]
        within = np.clip(place[0], along[0], along[-1])
        weights = np.array([np.interp(within, along, row) for row in np.eye(len(places))[:, order]])
        missed = float(abs(place[0] - within))
        return weights, missed if missed > INSIDE * largest else 0.0
    if len(places) == 1:
        return np.ones(1), float(np.linalg.norm(offsets[0] / largest)) * largest
    # Loading it takes longer than most runs; one parameter needs no solver.
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


def interpolation_variance(places: Array, place: Array) -> float:
    """Return the variance of what `interpolation_weights` miss at a place (n_parameters,).

    It is that of a process whose increments have the distance as variance: zero at training
    points (n_points, n_parameters), and between two of them largest in the middle.
    """
    weights, _ = interpolation_weights(places, place)
    reach, between = _distances(places, place[None])[:, 0], _distances(places, places)
    return float(2.0 * weights @ reach - weights @ between @ weights)


CORRELATIONS = np.concatenate(([1e-6], np.linspace(0.02, 0.98, 49), [1.0 - 1e-6]))
"""Correlations of the defects at the two training points farthest apart, that are tried."""
WORTHWHILE = 0.9
"""Share of the defects' squares that stays in runs held out, up to which there is a correction.

With shedding in the open cavity, whose phase depends on the parameter, it is 0.9 to 1, and nothing
is gained.
"""
FADED = 0.1
"""Share of the trained time, its last, over which the correction of longer runs fades out."""


@dataclass(frozen=True)
class Correction:
    """The defects at training points, and how far they reach."""

    places: Array
    """(n_runs, n_parameters), in which distances count alike."""
    defects: Array
    """(n_runs, n_snapshots, n_modes)."""
    lengths: Array
    """(n_modes,) over which defects are correlated; NaN for modes without a correction."""

    def at(self, place: Array) -> Array:
        """Return what is added to coordinates (n_snapshots, n_modes) at a place (n_parameters,)."""
        between = _distances(self.places, self.places)
        reach = _distances(self.places, place[None])[:, 0]
        found, modes = np.zeros(self.defects.shape[1:]), np.isfinite(self.lengths)
        lengths = self.lengths[modes, None]
        alike = np.exp(-between / lengths[..., None]), np.exp(-reach / lengths)[..., None]
        weights = np.linalg.solve(*alike)[..., 0]
        found[:, modes] = np.einsum("mk,ksm->sm", weights, self.defects[..., modes])
        return found

    def held_out(self, place: Array) -> Array:
        """Return the correction (n_snapshots, n_modes) of a training run that others give."""
        others = np.any(self.places != place, axis=1)
        return replace(self, places=self.places[others], defects=self.defects[others]).at(place)


def learn_correction(
    places: Array, defects: Array, groups: Sequence[Indices] = (), worthwhile: float = WORTHWHILE
) -> Correction | None:
    """Find out how far the defects (n_runs, n_snapshots, n_modes) of training runs reach.

    None where they predict too little of each other's, or fewer than two runs are finite. Others
    are left out.

    Parameters
    ----------
    places : (n_runs, n_parameters), in which distances count alike; no two are the same.
    groups : of modes; those of which too little is predicted have no correction. By default all
        modes are one group.
    worthwhile : the share of the defects' squares that may stay in runs held out.
    """
    finite = np.isfinite(defects).all(axis=(1, 2))
    places, defects = places[finite], defects[finite]
    if len(places) < 2:
        return None
    between = _distances(places, places)
    lengths = -between.max() / np.log(CORRELATIONS)
    missed = np.empty((len(lengths), defects.shape[2]))  # squares that the other runs leave
    for k, length in enumerate(lengths):
        inverse = np.linalg.inv(np.exp(-between / length))
        errors = np.einsum("jk,ksm->jsm", inverse / np.diag(inverse)[:, None], defects)
        missed[k] = np.sum(errors**2, axis=(0, 1))
    whole, chosen = np.sum(defects**2, axis=(0, 1)), np.full(defects.shape[2], np.nan)
    for modes in groups or (np.arange(len(whole)),):
        left = missed[:, modes].sum(axis=1)
        if left.min() <= worthwhile * whole[modes].sum():
            chosen[modes] = lengths[left.argmin()]
    return None if np.isnan(chosen).all() else Correction(places, defects, chosen)


def faded(correction: Array, n_snapshots: int) -> Array:
    """Return a correction (..., n_trained, n_modes) over a run of some equally spaced snapshots."""
    n_trained = correction.shape[-2]
    if n_snapshots <= n_trained:
        return correction[..., :n_snapshots, :]
    rest = np.arange(n_trained - 1, -1, -1) / max(1.0, FADED * (n_trained - 1))
    # The square of a sine: neither it nor its slope jumps.
    share = np.sin(0.5 * np.pi * np.minimum(rest, 1.0)) ** 2
    out = np.zeros((*correction.shape[:-2], n_snapshots, correction.shape[-1]))
    out[..., :n_trained, :] = share[:, None] * correction
    return out


def _distances(places: Array, others: Array) -> Array:
    return np.asarray(np.linalg.norm(places[:, None] - others, axis=2))
