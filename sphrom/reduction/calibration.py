"""Calibration: a small correction of reduced rates, learnt from the coordinates of training runs.

Operators on fixed points differ a little from those on moving particles. The difference hardly
changes in time, so that its effect adds up: in the mean flow, and more so in the pressure, to which
the modes' divergence contributes a small difference of large terms. A constant and a linear part of
the rates compensate for it, each affine in the kinematic viscosity nu as the rates themselves are:

    da/dt = f(a) + (c + A a) + (nu / nu_mean - 1) (c' + A' a)

and likewise in every other parameter, whose share in the sum is its difference from the mean over
the runs' largest value.

They minimise the sum of squares of the residual, averaged over a window that moves along each run,
with a penalty that pulls them to zero:

    sum |<da/dt - f(a)> - c - A <a> - ...|^2 + lambda n s^2 (|c|^2 / s^2 + |A|^2 + ...)

where n is the number of averages, s^2 the mean square of the averaged coordinates and nu_mean the
mean of the runs' viscosities. The window is a hat with half-width of the longest sound wave's
period: snapshots are too far apart to differentiate sound in time, and averages of the rates need
no more than that sound cancels in them. One calibration serves all parameters, also between the
trained ones. If all runs have the same viscosity, c' and A' are zero.

With a constant, a flow that nothing drives would never come to rest. Where rates vanish at rest c
and c' are therefore multiplied by the energy |a|^2 over its mean: it is about one in training, and
what is left out of convection and pressure changes with the square of the flow indeed.

All coordinates share one scale s. If each coordinate had its own, the penalty would no longer hold
back the coupling of small coordinates, which the averages hardly show: cavities became unstable.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sphrom.arrays import Array
from sphrom.metrics.series import hat, moving_average
from sphrom.reduction.reduced_rates import Polynomial

PENALTY = 1e-2
"""lambda. Measured on cavities: ten times as much or a tenth changes little; a hundred times less
is better at the trained values and worse between them."""


@dataclass(frozen=True)
class TrainingRun:
    """A run's coordinates, and the reduced rates at its parameters."""

    rates: Polynomial
    coordinates: Array
    """(n_snapshots, n_modes)."""
    kinematic_viscosity: float
    """nu [m2/s]."""
    amplitude: Array | None = None
    """(n_snapshots,) of the body force or of driven walls, if it changes."""
    factors: Mapping[str, float] = field(default_factory=dict)
    """The values of what varies beside the viscosity."""


@dataclass(frozen=True)
class Slope:
    """The part of corrections that grows with a parameter."""

    slope: Polynomial
    mean: float
    """Of the runs' values."""
    largest: float
    """Of the runs' values, either sign; one where all are zero."""


@dataclass(frozen=True)
class Calibration:
    """Corrections by viscosity."""

    mean: Polynomial
    """c and A, at the mean viscosity."""
    slope: Polynomial
    """c' and A'; zero if all runs had the same viscosity."""
    mean_viscosity: float
    """nu_mean [m2/s]."""
    others: Mapping[str, Slope] = field(default_factory=dict)
    """By what varies beside the viscosity."""

    def at(
        self, kinematic_viscosity: float, factors: Mapping[str, float] | None = None
    ) -> Polynomial:
        """Return the correction of the rates at a viscosity [m2/s] and values of what varies."""
        found = self.mean.plus(self.slope, kinematic_viscosity / self.mean_viscosity - 1.0)
        for name, other in self.others.items():
            offset = ((factors or {})[name] - other.mean) / other.largest
            found = found.plus(other.slope, offset)
        return found


def calibrate(
    runs: Sequence[TrainingRun], interval: float, window: float, penalty: float = PENALTY
) -> Calibration:
    """Fit the corrections to training runs.

    Parameters
    ----------
    interval : between snapshots [s].
    window : half the width of the averages [s]; short runs have as much of it as they are long.
    penalty : lambda.

    Raises ValueError when a run has fewer than three snapshots.
    """
    averages = [_averaged(run, interval, window) for run in runs]
    coordinates, residuals = (np.concatenate(parts) for parts in zip(*averages, strict=True))
    viscosities = np.array([run.kinematic_viscosity for run in runs])
    mean_viscosity = float(viscosities.mean())
    # A flow at rest determines the constant alone.
    scale = float(np.sqrt(np.mean(coordinates**2))) or 1.0
    driven = any(tensors and tensors[0].any() for run in runs for tensors in run.rates.powers)
    # As large as the largest coordinate, and so held back as much.
    energy = 1.0 / (scale**2 * np.sqrt(coordinates.shape[1]))
    first = np.ones(len(coordinates)) if driven else energy * np.sum(coordinates**2, axis=1)
    features = np.insert(coordinates / scale, 0, first, axis=1)
    offsets, sizes = [viscosities / mean_viscosity - 1.0], dict[str, tuple[float, float]]()
    for name in runs[0].factors:
        values = np.array([run.factors[name] for run in runs])
        sizes[name] = mean, largest = float(values.mean()), float(np.abs(values).max()) or 1.0
        offsets.append((values - mean) / largest)
    lengths = [len(part) for part, _ in averages]
    parts = [features, *(np.repeat(o, lengths)[:, None] * features for o in offsets)]
    features = np.hstack(parts)
    gram = features.T @ features + penalty * len(features) * np.eye(features.shape[1])
    # Runs at one value of a parameter leave its features, and that part of the solution, zero.
    solved = np.split(np.linalg.lstsq(gram, features.T @ residuals)[0], len(parts))
    at_mean, slope, *others = (
        _correction(p[0], p[1:].T / scale, None if driven else energy) for p in solved
    )
    slopes = {
        name: Slope(other, *size) for (name, size), other in zip(sizes.items(), others, strict=True)
    }
    return Calibration(at_mean, slope, mean_viscosity, slopes)


def _correction(first: Array, linear: Array, energy: float | None) -> Polynomial:
    """Return rates of a constant and a linear part; with a factor, of |a|^2 in place of one."""
    if energy is None:
        return Polynomial(((first, linear),))
    quadratic = energy * first[:, None, None] * np.eye(len(first))
    return Polynomial(((np.zeros_like(first), linear, quadratic),))


def _averaged(run: TrainingRun, interval: float, window: float) -> tuple[Array, Array]:
    """Return averages (n_averages, n_modes) of coordinates, and of the errors of their rates."""
    states = run.coordinates
    if len(states) < 3:
        reason = "a run of fewer than three snapshots has no rates to calibrate with"
        raise ValueError(f"{reason}; see snapshots.every")
    inner = states[1:-1]
    rates = (states[2:] - states[:-2]) / (2.0 * interval)
    driven = np.zeros(len(states)) if run.amplitude is None else run.amplitude
    residuals = rates - [run.rates(a, f) for a, f in zip(inner, driven[1:-1], strict=True)]
    n_half = max(1, min(round(window / interval), (len(inner) + 1) // 2))
    weights = hat(n_half)
    return moving_average(inner, weights), moving_average(residuals, weights)
