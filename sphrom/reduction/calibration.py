"""Calibration: a small correction of the reduced rates, fitted to the coordinates of training runs.

    da/dt = f(a) + (c + A a) + (nu / nu_mean - 1) (c' + A' a)

compensates for the difference between moving particles and fixed points (`docs/fast-models.md`).
Every other parameter adds such a term, except knots of a history; its factor is the parameter's
difference from the mean of the runs, divided by the runs' largest value. The terms minimise the
squared residual, averaged over a window that moves along each run, with a penalty that pulls them
to zero:

    sum |<da/dt - f(a)> - c - A <a> - ...|^2 + lambda n s^2 (|c|^2 / s^2 + |A|^2 + ...)

where n is the number of averages, s^2 the mean square of the averaged coordinates and nu_mean the
mean viscosity of the runs. The window is a hat whose half-width is the period of the longest sound
wave: snapshots are too far apart to resolve the time derivative of sound, and sound cancels in
averages over a period. If all runs have the same viscosity, c' and A' are zero. If the rates vanish
at rest, the energy |a|^2 over its mean multiplies c and c', so that the flow can come to rest.

All coordinates share one scale s. With a scale for each, the penalty would not limit the coupling
of small coordinates, which the averages hardly determine, and models of cavities became unstable.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from sphrom.arrays import Array
from sphrom.declaration import Record, Tensors, attribute, dataset, part
from sphrom.metrics.series import hat, moving_average
from sphrom.reduction.affine import VISCOSITY, Affine
from sphrom.reduction.reduced_operators import Polynomial

PENALTY = 1e-2
"""lambda. Measured on cavities: a factor of ten either way changes little; a hundred times less is
better at the training points and worse between them."""


@dataclass(frozen=True)
class TrainingRun:
    """A run's coordinates, and the reduced rates at its parameters."""

    rates: Polynomial
    coordinates: Array
    """(n_snapshots, n_modes)."""
    kinematic_viscosity: float
    """nu [m2/s]."""
    amplitude: Array | None = None
    """(n_snapshots,) of the body force or of the driven walls, if it changes in time."""
    factors: Mapping[str, float] = field(default_factory=dict)
    """The values of the other parameters, by name."""


class CorrectedRates(Record):
    """A constant and a linear function of the coordinates, such as rates."""

    constant: Array = dataset("output", "of the outputs", "constant", "c")
    linear: Array = dataset("output mode", "of the outputs", "linear part", "A")

    def tensors(self, energy: float | None) -> Tensors:
        """Return the rates; with `energy`, the constant is multiplied by energy |a|^2."""
        if energy is None:
            return self.constant, self.linear
        quadratic = energy * self.constant[:, None, None] * np.eye(self.linear.shape[1])
        return np.zeros_like(self.constant), self.linear, quadratic


class Slope(CorrectedRates):
    """The term of the correction that is linear in one parameter."""

    mean: float = attribute("of the parameter", "mean of the training runs' values")
    largest: float = attribute(
        "of the parameter", "largest absolute value of the training runs; one if all are zero"
    )


class Calibration(Record):
    """The correction of the rates as a function of the parameters."""

    at_mean: CorrectedRates = part()
    """The rates at the mean viscosity."""
    slope: CorrectedRates = part()
    """Zero if all runs had the same viscosity."""
    mean_viscosity: float = attribute("m2/s", "mean viscosity of the training runs")
    energy: float | None = attribute(
        "1", "factor of |a|^2 that multiplies the constant rates of undriven flows", default=None
    )
    others: Mapping[str, Slope] = part(default_factory=dict)
    """The slopes in the other parameters, by name."""

    def at(
        self, kinematic_viscosity: float, factors: Mapping[str, float] | None = None
    ) -> Polynomial:
        """Return the correction at a viscosity [m2/s] and at values of the other parameters."""
        offsets = {VISCOSITY: kinematic_viscosity / self.mean_viscosity - 1.0}
        for name, other in self.others.items():
            offsets[name] = ((factors or {})[name] - other.mean) / other.largest
        slopes = {VISCOSITY: self.slope, **self.others}
        parts = [((name,), slope.tensors(self.energy)) for name, slope in slopes.items()]
        return Polynomial(Affine([((), self.at_mean.tensors(self.energy)), *parts]).at(offsets))


def calibrate(
    runs: Sequence[TrainingRun], interval: float, window: float, penalty: float = PENALTY
) -> Calibration:
    """Fit the correction to training runs.

    Parameters
    ----------
    interval : time between snapshots [s].
    window : half-width of the averages [s]; short runs use at most their own length.
    penalty : lambda.

    Raises ValueError when a run has fewer than three snapshots.
    """
    return fit(runs, [_averaged(run, interval, window) for run in runs], penalty)


def fit(
    runs: Sequence[TrainingRun], samples: Sequence[tuple[Array, Array]], penalty: float = PENALTY
) -> Calibration:
    """Fit a function of coordinates and parameters to samples of each run, by ridge regression.

    Parameters
    ----------
    samples : coordinates (n_samples, n_modes) and values (n_samples, n_values) there.
    penalty : lambda.
    """
    coordinates, residuals = (np.concatenate(parts) for parts in zip(*samples, strict=True))
    viscosities = np.array([run.kinematic_viscosity for run in runs])
    mean_viscosity = float(viscosities.mean())
    # A flow at rest determines the constant only.
    scale = float(np.sqrt(np.mean(coordinates**2))) or 1.0
    driven = any(tensors and tensors[0].any() for run in runs for tensors in run.rates.powers)
    # Scaled to the size of the largest coordinate, so that the penalty treats both alike.
    energy = 1.0 / (scale**2 * np.sqrt(coordinates.shape[1]))
    first = np.ones(len(coordinates)) if driven else energy * np.sum(coordinates**2, axis=1)
    features = np.insert(coordinates / scale, 0, first, axis=1)
    offsets = [viscosities / mean_viscosity - 1.0]
    sizes = dict[str, tuple[float, float]]()
    for name in runs[0].factors:
        values = np.array([run.factors[name] for run in runs])
        sizes[name] = mean, largest = float(values.mean()), float(np.abs(values).max()) or 1.0
        offsets.append((values - mean) / largest)
    lengths = [len(part) for part, _ in samples]
    parts = [features, *(np.repeat(o, lengths)[:, None] * features for o in offsets)]
    features = np.hstack(parts)
    gram = features.T @ features + penalty * len(features) * np.eye(features.shape[1])
    # If all runs have one value of a parameter, its features are zero, and so is its slope.
    solved = np.split(np.linalg.lstsq(gram, features.T @ residuals)[0], len(parts))
    at_mean, slope, *others = (
        CorrectedRates(constant=terms[0], linear=terms[1:].T / scale) for terms in solved
    )
    slopes = {
        name: Slope(**vars(other), mean=mean, largest=largest)
        for (name, (mean, largest)), other in zip(sizes.items(), others, strict=True)
    }
    return Calibration(
        at_mean=at_mean,
        slope=slope,
        mean_viscosity=mean_viscosity,
        energy=None if driven else energy,
        others=slopes,
    )


def _averaged(run: TrainingRun, interval: float, window: float) -> tuple[Array, Array]:
    """Return window averages (n_averages, n_modes) of the coordinates and of the rate errors."""
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
