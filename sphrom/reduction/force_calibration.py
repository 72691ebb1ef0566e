"""Calibration of forces on walls with the forces that training runs recorded.

The force that particles feel differs from that of the same fields at fixed points: particles beside
a wall move closer to it and lose their order, and their pressures follow how they are arranged,
which a map smooths. It is a tenth of a cylinder's drag at 5 spacings per radius. And a reduced run
lies apart from the states that its basis would represent best. Both are alike in all runs of one
flow. With y = (1, wall speed, amplitude of the body force, coordinates), a small correction makes
up for them, affine in the kinematic viscosity as that of the rates is
(`sphrom.reduction.calibration`):

    F_full - F = C y + (nu / nu_mean - 1) C' y

Each component of the pressure's and of the viscous force is fitted by ridge regression, each term
over its root mean square. The projected force is the prior: it stays as it is where it is better in
snapshots that the fit has not seen. Those are the runs whose viscosity lies between others', each
left out in turn; where there is none, every fourth snapshot of all runs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.reduction.forces import ForceCorrection, ReducedForce, correction_terms
from sphrom.sph.fluid import Factors

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PENALTIES = (1e-2, math.inf)
"""Penalties over the mean squares of the terms; the last leaves the force as it is.

Of 1e-5 to 1e-1, 1e-2 is the best or near it for 8 to 20 modes of a cylinder's flow between the
trained viscosities; 1e-3 and less is better where trained, and worse between.
"""
N_PARTS = 4
"""Parts of runs that are left out in turn where no viscosity lies between others."""


@dataclass(frozen=True)
class ForceRecord:
    """The force on a wall that a training run recorded, and the reduced states of the same times.

    Arrays are (n_snapshots,) where they don't say otherwise.
    """

    loads: Array
    """(n_snapshots, 2, 3) the pressure's and the viscous force and torque [N/m, N]."""
    coordinates: Array
    """(n_snapshots, n_modes)."""
    mean_density_fluctuation: Array
    """What is carried apart [kg/m3]."""
    kinematic_viscosity: float
    """[m2/s]."""
    wall_speed: Array
    """Over the given one."""
    amplitude: Array
    """Of the body force."""
    factors: Factors = field(default_factory=dict)
    """The values of the parameters that drive the flow."""


def calibrate_force(force: ReducedForce, runs: Sequence[ForceRecord]) -> ReducedForce:
    """Return a force with the correction that its training runs ask for.

    It is without one if no run has more than one snapshot.
    """
    if max((len(run.loads) for run in runs), default=0) < 2:
        return force
    samples = _Samples(force, runs)
    squares = np.zeros((len(PENALTIES), samples.errors.shape[1]))
    for left_out in samples.folds():
        fitted = samples.fit(~left_out)
        wrong = samples.errors[left_out] - samples.features(left_out) @ fitted
        squares += np.sum(wrong**2, axis=1)
    best = np.argmin(squares, axis=0)
    everything = np.ones(len(samples.errors), dtype=bool)
    fitted = np.take_along_axis(samples.fit(everything), best[None, None, :], axis=0)[0]
    return force.corrected(samples.correction(fitted))


class _Samples:
    """The snapshots of all runs: terms, and the errors of a force (n_samples, 6)."""

    def __init__(self, force: ReducedForce, runs: Sequence[ForceRecord]) -> None:
        parts = [
            (correction_terms(run.coordinates, run.wall_speed, run.amplitude), _errors(force, run))
            for run in runs
        ]
        terms, errors = (np.concatenate(part) for part in zip(*parts, strict=True))
        self.errors: Array = errors
        size = np.sqrt(np.mean(terms**2, axis=0))
        self._scale = np.where(size > 0.0, size, 1.0)
        self._terms = terms / self._scale
        self._viscosity = np.array([run.kinematic_viscosity for run in runs])
        self._mean_viscosity = float(self._viscosity.mean())
        self._run = np.repeat(np.arange(len(runs)), [len(run.loads) for run in runs])

    def folds(self) -> Iterator[Mask]:
        """Yield which samples (n_samples,) to leave out."""
        low, high = self._viscosity.min(), self._viscosity.max()
        between = np.flatnonzero((low < self._viscosity) & (self._viscosity < high))
        if between.size:
            yield from (self._run == run for run in between)
        else:
            place = np.arange(len(self._run))
            yield from (place % N_PARTS == part for part in range(N_PARTS))

    def features(self, kept: Mask) -> Array:
        """Return the terms, and their products with the viscosity's offset, of some samples."""
        offset = self._viscosity[self._run[kept]] / self._mean_viscosity - 1.0
        return np.hstack((self._terms[kept], offset[:, None] * self._terms[kept]))

    def fit(self, kept: Mask) -> Array:
        """Return coefficients (n_penalties, n_features, 6), fitted to some samples."""
        features = self.features(kept)
        left, size, right = np.linalg.svd(features, full_matrices=False)
        shrunk = size / (size**2 + len(features) * np.array(PENALTIES)[:, None])
        sides = left.T @ self.errors[kept]
        return np.asarray(right.T @ (shrunk[..., None] * sides))

    def correction(self, coefficients: Array) -> ForceCorrection:
        """Return the correction that coefficients (n_features, 6) mean."""
        mean, slope = (
            (half / self._scale[:, None]).T.reshape(2, 3, -1) for half in np.split(coefficients, 2)
        )
        return ForceCorrection(mean, slope, self._mean_viscosity)


def _errors(force: ReducedForce, run: ForceRecord) -> Array:
    """Return recorded loads less those of a force (n_snapshots, 6)."""
    found = force.with_drives(run.factors).at(
        run.coordinates,
        run.mean_density_fluctuation,
        run.kinematic_viscosity,
        run.wall_speed,
        run.amplitude,
    )
    return (run.loads - found).reshape(len(found), -1)
