"""A closure that settles reduced models on the limit cycles of training runs, and between them.

Modes of a wake in its periodic state know little of what damps them: integrated for long, a model
finds a cycle of its own, with another amplitude and frequency. What training runs tell is theirs,

    C(phi) = A_0 + Re sum_k A_k exp(i k phi),    dphi/dt = omega,

fitted to each run's coordinates. Just beyond its onset an oscillation follows the equation of
Stuart and Landau (Landau 1944; Stuart 1960): squared amplitude and frequency are linear in the
Reynolds number, and a harmonic k grows with the power k of the amplitude r = |A_1|. So omega, r^2
and A_k / r^k are interpolated in 1/nu and in what else varies, with all runs at one phase of A_1.

There the rates f get a constant and a linear part, fitted to the cycle that is wanted,

    c + A C = omega dC/dphi - f(C),

which leaves the cycle a solution, while f decides how states come to it. Directions in which the
cycle doesn't move are damped: little, and modes that training runs hardly show lead away from the
cycle; much, and the mean flow can't follow the oscillation, which limits its amplitude. Of some
dampings the one is taken with which disturbances of the trained cycles decay fastest, by Floquet's
multipliers. Forces get such parts for what recorded ones differ by. Below the onset all decays.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sphrom.arrays import Array
from sphrom.metrics.series import dominant_frequency
from sphrom.reduction.correction import spline_weights
from sphrom.reduction.reduced_measures import PointForce
from sphrom.reduction.reduced_operators import ReducedOperators
from sphrom.reduction.reduced_rates import Polynomial
from sphrom.sph.fluid import NONE, Factors

Harmonics = NDArray[np.complex128]
"""A_k (1 + N_HARMONICS, n_values)."""

N_HARMONICS = 4
ORDERS = np.arange(1 + N_HARMONICS)
N_PHASES = 64
"""Phases of a cycle at which rates are fitted."""
PHASES = 2.0 * np.pi * np.arange(N_PHASES) / N_PHASES
PERIODIC = 0.9
"""Share of a run's fluctuations that its harmonics have to explain."""
RIDGE = 1e-4
"""Of fits, over the mean square of a direction in which the cycle moves."""
DAMPINGS = (0.0, 0.0625, 0.125, 0.25, 0.5, 1.0)
"""Rates over omega that are tried."""


@dataclass(frozen=True)
class LimitCycle:
    """A periodic state in the coordinates."""

    frequency: float
    """omega [rad/s]."""
    harmonics: Harmonics
    """Of the coordinates."""

    @property
    def states(self) -> Array:
        """(N_PHASES, n_modes) at equal steps of the phase."""
        return around(self.harmonics)

    @property
    def rates(self) -> Array:
        """(N_PHASES, n_modes) how they change [1/s]."""
        return around(1j * self.frequency * ORDERS[:, None] * self.harmonics)


def around(harmonics: Harmonics) -> Array:
    """Return values (N_PHASES, n_values) at equal steps of the phase."""
    return np.asarray((np.exp(1j * np.outer(PHASES, ORDERS)) @ harmonics).real)


def harmonics_of(time: Array, values: Array, frequency: float) -> Harmonics:
    """Return the harmonics of values (n_times, n_values) at a frequency [rad/s]."""
    turns = frequency * np.outer(time, ORDERS)
    waves = np.hstack((np.cos(turns), np.sin(turns[:, 1:])))
    found = np.linalg.lstsq(waves, values)[0].astype(np.complex128)
    found[1 : len(ORDERS)] -= 1j * found[len(ORDERS) :]
    return found[: len(ORDERS)]


def fitted_cycle(time: Array, states: Array) -> LimitCycle:
    """Return the cycle of a run's coordinates (n_snapshots, n_modes).

    Raises ValueError where it is not periodic, or too short.
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
            f"{100.0 * explained:.0f} % of how it changes"
        )
    return LimitCycle(frequency, harmonics_of(time, states, frequency))


@dataclass(frozen=True)
class CycleClosure:
    """The closure of a model by the cycles of its training runs, at any parameters.

    Of training runs it has viscosities [m2/s], values of what drives the flow, and the amplitude.
    """

    operators: ReducedOperators
    viscosities: Array
    factors: Sequence[Mapping[str, float]]
    cycles: Sequence[LimitCycle]
    amplitude: float

    @cached_property
    def _turns(self) -> Harmonics:
        """(n_runs, 1 + N_HARMONICS, 1) what brings the runs to one phase."""
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
        """Return r^2 over the largest of training runs; negative below the onset."""
        return float(weights @ self._radii**2) / float(self._radii.max()) ** 2

    def _between(
        self, weights: Array, harmonics: Sequence[Harmonics], fitted: bool = True
    ) -> Harmonics:
        """Return harmonics between those of training runs, of a radius not below theirs."""
        radius = self._radii.max() * math.sqrt(max(self._square(weights), 0.0))
        radius = max(radius, self._radii.min()) if fitted else radius
        scales = (radius / self._radii[:, None]) ** ORDERS
        return np.asarray(np.tensordot(weights, scales[..., None] * self._turns * harmonics, 1))

    def cycle_at(
        self, viscosity: float, factors: Factors = NONE, fitted: bool = False
    ) -> LimitCycle:
        """Return the cycle somewhere; one that is `fitted` is no smaller than trained ones."""
        weights = self._weights(viscosity, factors)
        frequency = float(weights @ [cycle.frequency for cycle in self.cycles])
        harmonics = self._between(weights, [cycle.harmonics for cycle in self.cycles], fitted)
        return LimitCycle(frequency, harmonics)

    def at(self, viscosity: float, factors: Factors = NONE) -> Polynomial:
        """Return what is added to the rates at a viscosity [m2/s] and values of what varies."""
        return self._damped(viscosity, factors, self._damping)

    def _damped(self, viscosity: float, factors: Factors, damping: float) -> Polynomial:
        rates, pushed = self.operators.at(viscosity, factors), np.full(N_PHASES, self.amplitude)
        cycle, own = (self.cycle_at(viscosity, factors, fitted) for fitted in (True, False))
        of_cycle, missing = (c.rates - rates.along(c.states, pushed) for c in (cycle, own))
        linear, mean = _slope(cycle.states, of_cycle), cycle.harmonics[0].real
        moving = _projector(cycle.harmonics[1:])
        linear -= damping * cycle.frequency * (np.eye(len(linear)) - moving)
        below = min(self._square(self._weights(viscosity, factors)), 0.0)
        linear += below * cycle.frequency / (2.0 * math.pi) * moving
        return Polynomial(((missing.mean(axis=0) - linear @ mean, linear),))

    @cached_property
    def _damping(self) -> float:
        return DAMPINGS[int(np.argmin([self.slowest(each) for each in DAMPINGS]))]

    def slowest(self, damping: float | None = None) -> float:
        """Return Floquet's largest multiplier of trained cycles, but for those along them."""
        found, used = [], self._damping if damping is None else damping
        for point in zip(self.viscosities, self.factors, strict=True):
            cycle, growth = self.cycle_at(*point), np.eye(self.operators.n_modes)
            rates = self.operators.at(*point).plus(self._damped(*point, used))
            jacobians = rates.jacobians(cycle.states, self.amplitude)
            half = math.pi / (cycle.frequency * N_PHASES) * jacobians
            for step in np.linalg.solve(np.eye(len(growth)) - half, np.eye(len(growth)) + half):
                growth = step @ growth
            multipliers = np.linalg.eigvals(growth)
            others = np.delete(multipliers, int(np.abs(multipliers - 1.0).argmin()))
            found.append(float(np.abs(others).max(initial=0.0)))
        return max(found)

    def force_at(
        self,
        force: PointForce,
        trained: Sequence[PointForce],
        loads: Sequence[Harmonics],
        viscosity: float,
        factors: Factors,
    ) -> PointForce:
        """Return a force with what the loads of training runs differ by from the model's own.

        These are forces at the runs' parameters, and harmonics (1 + N_HARMONICS, 6) [N/m, N].
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
    """Return the matrix (n_values, n_modes) that is least of those that fit values to states."""
    moved = states - states.mean(axis=0)
    gram = moved.T @ moved
    gram += RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    return np.linalg.solve(gram, moved.T @ (values - values.mean(axis=0))).T


def _projector(harmonics: Harmonics) -> Array:
    """Return the projector (n_modes, n_modes) onto the directions of some harmonics."""
    directions = np.linalg.svd(np.vstack((harmonics.real, harmonics.imag)), full_matrices=False)
    kept = directions[2][directions[1] ** 2 > RIDGE * directions[1][0] ** 2]
    return np.asarray(kept.T @ kept)
