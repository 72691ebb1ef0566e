"""Calibration: a small correction of the reduced rates, fitted to the coordinates of training runs.

    da/dt = f(a) + (c + A a) + (nu / nu_mean - 1) (c' + A' a)

compensates for the difference between moving particles and fixed points (`docs/fast-models.md`).
Every other parameter adds such a term; its factor is the parameter's difference from the mean of
the runs, divided by the runs' largest value. The terms minimise the squared residual, averaged over
a window that moves along each run, with a penalty that pulls them to zero:

    sum |<da/dt - f(a)> - c - A <a> - ...|^2 + lambda n s^2 (|c|^2 / s^2 + |A|^2 + ...)

where n is the number of averages, s^2 the mean square of the averaged coordinates and nu_mean the
mean viscosity of the runs. The window is a hat whose half-width is the period of the longest sound
wave: snapshots are too far apart to resolve the time derivative of sound, and sound cancels in
averages over a period. If all runs have the same viscosity, c' and A' are zero. If the rates vanish
at rest, the energy |a|^2 over its mean multiplies c and c', so that the flow can come to rest.

All coordinates share one scale s. With a scale for each, the penalty would not limit the coupling
of small coordinates, which the averages hardly determine, and models of cavities became unstable.

Another closure makes models settle on the limit cycles of training runs. In the periodic state
of a wake, the modes hardly represent its damping. Over a long time a model settles on a cycle of
its own, with another amplitude and frequency. Training runs give the cycle

    C(phi) = A_0 + Re sum_k A_k exp(i k phi),    dphi/dt = omega,

by a fit to their coordinates. Just beyond its onset, an oscillation follows the equation
of Stuart and Landau (Landau 1944; Stuart 1960): squared amplitude and frequency are linear in the
Reynolds number, and harmonic k grows with the power k of the amplitude r = |A_1|. Therefore omega,
r^2 and A_k / r^k are interpolated in 1/nu and the other parameters, with A_1 of all runs in phase.

The rates f at a point get a constant and a linear term, fitted to the interpolated cycle,

    c + A C = omega dC/dphi - f(C),

so that the cycle is a solution, while f determines how states approach it. Directions in which the
cycle does not move are damped. With too little damping, modes that training runs hardly determine
lead away from the cycle; with too much, the mean flow cannot follow the oscillation and limit its
amplitude. The chosen damping makes disturbances of the trained cycles decay fastest (by Floquet
multipliers). Forces get such terms too, fitted to the recorded ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.declaration import Record, Tensors, attribute, dataset, part
from sphrom.metrics.series import dominant_frequency, hat, moving_average
from sphrom.reduction.affine import VISCOSITY, Affine
from sphrom.reduction.correction import spline_weights
from sphrom.reduction.reduced_measures import PointForce
from sphrom.reduction.reduced_operators import Polynomial, ReducedOperators
from sphrom.sph.fluid import NONE, Factors

PENALTY = 1e-2
"""lambda. Measured on cavities: a factor of ten either way changes little; a hundred times less is
better at the training points and worse between them."""
Harmonics = NDArray[np.complex128]
"""A_k (1 + N_HARMONICS, n_values)."""

N_HARMONICS = 4
ORDERS = np.arange(1 + N_HARMONICS)
N_PHASES = 64
"""Number of phases of a cycle at which rates are fitted."""
PHASES = 2.0 * np.pi * np.arange(N_PHASES) / N_PHASES
PERIODIC = 0.9
"""Least share of a run's fluctuations that the harmonics have to explain."""
RIDGE = 1e-4
"""Penalty of fits, over the mean square of a direction in which the cycle moves."""
DAMPINGS = (0.0, 0.0625, 0.125, 0.25, 0.5, 1.0)
"""Candidate damping rates over omega."""


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
    """A constant and a linear rate."""

    constant: Array = dataset("mode", "of the modes, /s", "constant rate", "c")
    linear: Array = dataset("mode mode", "of the modes, /s", "linear rate", "A")

    def tensors(self, energy: float | None) -> Tensors:
        """Return the rates; with `energy`, the constant is multiplied by energy |a|^2."""
        if energy is None:
            return self.constant, self.linear
        quadratic = energy * self.constant[:, None, None] * np.eye(len(self.constant))
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
    """At the mean viscosity."""
    slope: CorrectedRates = part()
    """Zero if all runs had the same viscosity."""
    mean_viscosity: float = attribute("m2/s", "mean viscosity of the training runs")
    energy: float | None = attribute(
        "1", "factor of |a|^2 on the constant rates of flows without driving", default=None
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
    averages = [_averaged(run, interval, window) for run in runs]
    coordinates, residuals = (np.concatenate(parts) for parts in zip(*averages, strict=True))
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
    lengths = [len(part) for part, _ in averages]
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


@dataclass(frozen=True)
class LimitCycle:
    """A periodic state in generalized coordinates."""

    frequency: float
    """omega [rad/s]."""
    harmonics: Harmonics
    """Of the coordinates."""

    @property
    def states(self) -> Array:
        """(N_PHASES, n_modes), at equally spaced phases."""
        return around(self.harmonics)

    @property
    def rates(self) -> Array:
        """(N_PHASES, n_modes), the time derivatives of the states [1/s]."""
        return around(1j * self.frequency * ORDERS[:, None] * self.harmonics)


def around(harmonics: Harmonics) -> Array:
    """Return values (N_PHASES, n_values) at equally spaced phases."""
    return np.asarray((np.exp(1j * np.outer(PHASES, ORDERS)) @ harmonics).real)


def harmonics_of(time: Array, values: Array, frequency: float) -> Harmonics:
    """Return the harmonics of values (n_times, n_values) at a frequency [rad/s]."""
    turns = frequency * np.outer(time, ORDERS)
    waves = np.hstack((np.cos(turns), np.sin(turns[:, 1:])))
    fitted = np.linalg.lstsq(waves, values)[0].astype(np.complex128)
    fitted[1 : len(ORDERS)] -= 1j * fitted[len(ORDERS) :]
    return fitted[: len(ORDERS)]


def fitted_cycle(time: Array, states: Array) -> LimitCycle:
    """Return the cycle of a run's coordinates (n_snapshots, n_modes).

    Raises ValueError if the run is too short or not periodic.
    """
    from scipy.optimize import minimize_scalar  # few models need it

    moved = states - states.mean(axis=0)
    leading = moved @ np.linalg.svd(moved, full_matrices=False)[2][0]
    first = 2.0 * math.pi * dominant_frequency(time, leading)

    def missed(frequency: float) -> float:
        harmonics = harmonics_of(time, states, frequency)
        waves = np.exp(1j * frequency * np.outer(time, ORDERS))
        return float(np.sum((states - (waves @ harmonics).real) ** 2))

    step = 0.1 * math.pi / float(time[-1] - time[0])
    frequency = float(minimize_scalar(missed, bracket=(first - step, first + step)).x)
    explained = 1.0 - missed(frequency) / float(np.sum(moved**2))
    if not explained > PERIODIC:
        raise ValueError(
            f"is not periodic: harmonics of {frequency / (2.0 * math.pi):.4g} Hz explain "
            f"{100.0 * explained:.0f} % of its fluctuations"
        )
    return LimitCycle(frequency, harmonics_of(time, states, frequency))


class TrainedCycles(Record):
    """The limit cycles of training runs, with the parameters of these runs."""

    viscosities: Array = dataset("run", "m2/s", "viscosity of each run", "nu")
    values: Mapping[str, Array] = dataset(
        "run", "of the parameter", "value of another parameter in each run", default_factory=dict
    )
    frequencies: Array = dataset("run", "rad/s", "angular frequency of each cycle", "omega")
    real: Array = dataset(
        "run harmonic mode", "of the modes", "real parts of the coordinates' harmonics", "A_k"
    )
    imaginary: Array = dataset(
        "run harmonic mode", "of the modes", "imaginary parts of the coordinates' harmonics", "A_k"
    )
    amplitude: float = attribute("1", "amplitude of the driving, which does not change")

    @classmethod
    def of_closure(cls, closure: CycleClosure) -> TrainedCycles:
        """Return the record of a closure."""
        harmonics = np.stack([cycle.harmonics for cycle in closure.cycles])
        names = closure.factors[0]
        return cls(
            viscosities=closure.viscosities,
            values={n: np.array([factors[n] for factors in closure.factors]) for n in names},
            frequencies=np.array([cycle.frequency for cycle in closure.cycles]),
            real=harmonics.real.copy(),
            imaginary=harmonics.imag.copy(),
            amplitude=closure.amplitude,
        )

    def closure(self, operators: ReducedOperators) -> CycleClosure:
        """Return the closure of a model with these operators."""
        harmonics = self.real + 1j * self.imaginary
        cycles = map(LimitCycle, self.frequencies.tolist(), harmonics)
        rows = np.array(list(self.values.values())).T.reshape(len(self.viscosities), -1).tolist()
        factors = [dict(zip(self.values, row, strict=True)) for row in rows]
        return CycleClosure(operators, self.viscosities, factors, list(cycles), self.amplitude)


@dataclass(frozen=True)
class CycleClosure:
    """The closure of a model, at any parameters, by the cycles of its training runs.

    `viscosities` [m2/s], `factors` and `amplitude` are those of the training runs.
    """

    operators: ReducedOperators
    viscosities: Array
    factors: Sequence[Mapping[str, float]]
    cycles: Sequence[LimitCycle]
    amplitude: float

    @cached_property
    def _turns(self) -> Harmonics:
        """(n_runs, 1 + N_HARMONICS, 1) rotations that bring all runs into phase."""
        first = [cycle.harmonics[1] for cycle in self.cycles]
        phases = [np.angle(np.vdot(first[0], each)) for each in first]
        return np.exp(-1j * np.multiply.outer(phases, ORDERS))[..., None]

    @cached_property
    def _radii(self) -> Array:
        return np.array([np.linalg.norm(cycle.harmonics[1]) for cycle in self.cycles])

    def _weights(self, viscosity: float, factors: Factors) -> Array:
        def place(nu: float, values: Factors) -> list[float]:
            return [self.viscosities.min() / nu, *(values[name] / s for name, s in sizes.items())]

        sizes = {n: max(abs(f[n]) for f in self.factors) or 1.0 for n in self.factors[0]}
        places = [place(nu, each) for nu, each in zip(self.viscosities, self.factors, strict=True)]
        return spline_weights(np.array(places), np.array(place(viscosity, factors)))

    def _square(self, weights: Array) -> float:
        """Return r^2 over the largest of the training runs; negative below the onset."""
        return float(weights @ self._radii**2) / float(self._radii.max()) ** 2

    def _between(
        self, weights: Array, harmonics: Sequence[Harmonics], fitted: bool = True
    ) -> Harmonics:
        """Return interpolated harmonics; `fitted`: of a radius not below the training runs'."""
        radius = self._radii.max() * math.sqrt(max(self._square(weights), 0.0))
        radius = max(radius, self._radii.min()) if fitted else radius
        scales = (radius / self._radii[:, None]) ** ORDERS
        return np.asarray(np.tensordot(weights, scales[..., None] * self._turns * harmonics, 1))

    def cycle_at(
        self, viscosity: float, factors: Factors = NONE, fitted: bool = False
    ) -> LimitCycle:
        """Return the cycle at a point; if `fitted`, not smaller than the smallest trained one."""
        weights = self._weights(viscosity, factors)
        frequency = float(weights @ [cycle.frequency for cycle in self.cycles])
        harmonics = self._between(weights, [cycle.harmonics for cycle in self.cycles], fitted)
        return LimitCycle(frequency, harmonics)

    def at(self, viscosity: float, factors: Factors = NONE) -> Polynomial:
        """Return the added rates at a viscosity [m2/s] and values of the other parameters."""
        return self._damped(viscosity, factors, self._damping)

    def _damped(self, viscosity: float, factors: Factors, damping: float) -> Polynomial:
        rates = self.operators.at(viscosity, factors)
        pushed = np.full(N_PHASES, self.amplitude)
        cycle, own = (self.cycle_at(viscosity, factors, fitted) for fitted in (True, False))
        of_cycle, missing = (c.rates - rates.along(c.states, pushed) for c in (cycle, own))
        linear = _slope(cycle.states, of_cycle)
        mean = cycle.harmonics[0].real
        moving = _projector(cycle.harmonics[1:])
        linear -= damping * cycle.frequency * (np.eye(len(linear)) - moving)
        below = min(self._square(self._weights(viscosity, factors)), 0.0)
        linear += below * cycle.frequency / (2.0 * math.pi) * moving
        return Polynomial(((missing.mean(axis=0) - linear @ mean, linear),))

    @cached_property
    def _damping(self) -> float:
        return DAMPINGS[int(np.argmin([self.slowest(each) for each in DAMPINGS]))]

    def slowest(self, damping: float | None = None) -> float:
        """Return the largest Floquet multiplier of trained cycles across their direction."""
        largest, used = [], self._damping if damping is None else damping
        for point in zip(self.viscosities, self.factors, strict=True):
            cycle = self.cycle_at(*point)
            growth = np.eye(self.operators.n_modes)
            rates = self.operators.at(*point).plus(self._damped(*point, used))
            jacobians = rates.jacobians(cycle.states, self.amplitude)
            half = math.pi / (cycle.frequency * N_PHASES) * jacobians
            for step in np.linalg.solve(np.eye(len(growth)) - half, np.eye(len(growth)) + half):
                growth = step @ growth
            multipliers = np.linalg.eigvals(growth)
            others = np.delete(multipliers, int(np.abs(multipliers - 1.0).argmin()))
            largest.append(float(np.abs(others).max(initial=0.0)))
        return max(largest)

    def force_at(
        self,
        force: PointForce,
        trained: Sequence[PointForce],
        loads: Sequence[Harmonics],
        viscosity: float,
        factors: Factors,
    ) -> PointForce:
        """Return a force corrected by the differences between recorded loads and the model's.

        `trained` are the forces at the runs' parameters, and `loads` the harmonics
        (1 + N_HARMONICS, 6) [N/m, N] of the recorded ones.
        """

        def own(at: PointForce, cycle: LimitCycle) -> Array:
            pushed = np.full(N_PHASES, self.amplitude)
            return at.polynomial.along(cycle.states, pushed) + cycle.rates @ at.momentum.T

        defects = [
            each - harmonics_of(PHASES, own(at, cycle), 1.0)
            for each, at, cycle in zip(loads, trained, self.cycles, strict=True)
        ]
        cycle = self.cycle_at(viscosity, factors, fitted=True)
        missing = around(self._between(self._weights(viscosity, factors), defects))
        linear = _slope(cycle.states, missing)
        constant = missing.mean(axis=0) - linear @ cycle.harmonics[0].real
        return replace(force, polynomial=force.polynomial.plus(Polynomial(((constant, linear),))))


def _slope(states: Array, values: Array) -> Array:
    """Return the smallest matrix (n_values, n_modes) that fits values to states."""
    moved = states - states.mean(axis=0)
    gram = moved.T @ moved
    gram += RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    return np.linalg.solve(gram, moved.T @ (values - values.mean(axis=0))).T


def _projector(harmonics: Harmonics) -> Array:
    """Return the projector (n_modes, n_modes) onto the directions of some harmonics."""
    directions = np.linalg.svd(np.vstack((harmonics.real, harmonics.imag)), full_matrices=False)
    kept = directions[2][directions[1] ** 2 > RIDGE * directions[1][0] ** 2]
    return np.asarray(kept.T @ kept)
