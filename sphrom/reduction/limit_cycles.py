"""The closure by limit cycles: models settle on the cycles of their training runs.

In the periodic state of a wake, the modes hardly represent its damping. Over a long time a model
settles on a cycle of its own, with another amplitude and frequency. Training runs give the cycle

    C(phi) = A_0 + Re sum_k A_k exp(i k phi),    dphi/dt = omega,

by a fit to their coordinates. Just beyond its onset, an oscillation follows the equation
of Stuart and Landau (Landau 1944; Stuart 1960), dA/dt = (sigma + i omega) A - l |A|^2 A, with the
amplitude r^2 = sigma / l, and harmonic k grows with the power k of r = |A_1|. The equations of
motion are affine in nu, and so are sigma and omega near the onset. The Landau coefficient l hardly
changes where advection restores the mean flow (`docs/wake.md`). Therefore omega, r^2 and A_k / r^k
are interpolated in nu and the other parameters, with A_1 of all runs in phase; beyond the runs, the
line that fits all of them is continued from the nearest one. The onset is the zero of r^2.
Estimates of it without one of the runs, and with an l that changes with nu, tell how certain it is.

Below the onset, the closure is that of the onset, and disturbances are damped. The steady state
follows from the projected rates, which know how a flow depends on nu. The mean of the cycles
contains their effect on the mean flow, so it is not the steady state there.

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
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.declaration import Record, attribute, dataset
from sphrom.metrics.series import SHEDDING, STEADY, UNDECIDED
from sphrom.reduction.correction import spline_weights
from sphrom.reduction.cycle_fits import (
    N_PHASES,
    ORDERS,
    PHASES,
    Harmonics,
    LimitCycle,
    around,
    harmonics_of,
)
from sphrom.reduction.reduced_measures import PointForce
from sphrom.reduction.reduced_operators import Polynomial, ReducedOperators
from sphrom.sph.fluid import NONE, Factors

RIDGE = 1e-4
"""Penalty of fits, relative to the mean square of a direction in which the cycle moves."""
TRENDS = (-0.25, 0.25)
"""Powers of the viscosity with which the Landau coefficient may change."""
FARTHEST = 100.0
"""Largest viscosity at which the onset is looked for, relative to that of the training runs."""
ROUNDING = 1e-9
"""Largest error of comparable parameters that weights reproduce."""
N_HALVINGS = 50
"""Halvings of the interval that contains the onset; the last one is at rounding."""
DAMPINGS = (0.0, 0.0625, 0.125, 0.25, 0.5, 1.0)
"""Candidate damping rates over omega."""


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
    def of_runs(
        cls,
        viscosities: Array,
        factors: Sequence[Factors],
        cycles: Sequence[LimitCycle],
        amplitude: float,
    ) -> TrainedCycles:
        """Return the record of cycles at viscosities [m2/s] and values of the other parameters."""
        harmonics = np.stack([cycle.harmonics for cycle in cycles])
        return cls(
            viscosities=viscosities,
            values={name: np.array([f[name] for f in factors]) for name in factors[0]},
            frequencies=np.array([cycle.frequency for cycle in cycles]),
            real=harmonics.real.copy(),
            imaginary=harmonics.imag.copy(),
            amplitude=amplitude,
        )

    @cached_property
    def cycles(self) -> list[LimitCycle]:
        """The cycle of each run."""
        return list(map(LimitCycle, self.frequencies.tolist(), self.real + 1j * self.imaginary))

    @cached_property
    def points(self) -> list[tuple[float, Factors]]:
        """Viscosity and values of the other parameters of each run."""
        return [
            (viscosity, {name: float(values[run]) for name, values in self.values.items()})
            for run, viscosity in enumerate(self.viscosities.tolist())
        ]


@dataclass(frozen=True)
class CycleClosure:
    """The closure of a model, at any parameters, by the cycles of its training runs."""

    operators: ReducedOperators
    trained: TrainedCycles

    @cached_property
    def _harmonics(self) -> Harmonics:
        """(n_runs, 1 + N_HARMONICS, n_modes)."""
        return np.array([cycle.harmonics for cycle in self.trained.cycles])

    @cached_property
    def _turns(self) -> Harmonics:
        """(n_runs, 1 + N_HARMONICS, 1) rotations that bring all runs into phase."""
        first = self._harmonics[:, 1]
        phases = [np.angle(np.vdot(first[0], oscillation)) for oscillation in first]
        return np.exp(-1j * np.multiply.outer(phases, ORDERS))[..., None]

    @cached_property
    def _radii(self) -> Array:
        return np.linalg.norm(self._harmonics[:, 1], axis=1)

    @cached_property
    def _estimates(self) -> list[tuple[Indices, Array]]:
        """The runs and the values by which r^2 is estimated, or its sign; first the model's own.

        The others are without one of the runs, or with a trend of the Landau coefficient.
        """
        squares = (self._radii / self._radii.max()) ** 2
        runs = np.arange(len(squares))
        kept = [runs, *(np.delete(runs, k) for k in runs if len(runs) > 2)]
        trends = [self.trained.viscosities**power for power in TRENDS]
        return [
            *((some, squares[some]) for some in kept),
            *((runs, squares * trend / trend.max()) for trend in trends),
        ]

    def _places(
        self, viscosity: float, factors: Factors, runs: Indices | None = None, power: float = 1.0
    ) -> tuple[Array, Array]:
        """Return comparable parameters of all training runs, or of some, and of a point.

        The viscosity enters by a power.
        """
        highest = self.trained.viscosities.max()
        sizes = {name: np.abs(x).max() or 1.0 for name, x in self.trained.values.items()}

        def scaled(nu: float, values: Factors) -> list[float]:
            return [(nu / highest) ** power, *(values[n] / size for n, size in sizes.items())]

        trained = np.array([scaled(nu, values) for nu, values in self.trained.points])
        return trained if runs is None else trained[runs], np.array(scaled(viscosity, factors))

    def _weights(
        self,
        viscosity: float,
        factors: Factors,
        runs: Indices | None = None,
        power: float = 1.0,
    ) -> Array:
        """Return the weights of all training runs, or of some, in the value at a point.

        Beyond their viscosities, the value at the nearest one is continued with the slope of the
        line that fits all runs. The slope at the end of a spline depends on differences of two
        neighbours.
        """
        used, place = self._places(viscosity, factors, runs, power)
        beyond = place[0] - np.clip(place[0], used[:, 0].min(), used[:, 0].max())
        place[0] -= beyond
        slopes = np.linalg.pinv(used - used.mean(axis=0))[0]
        return np.asarray(spline_weights(used, place) + beyond * slopes)

    def distance(self, viscosity: float, factors: Factors, runs: Indices | None = None) -> float:
        """Return the error of interpolating from all training runs, or some, up to a factor.

        It is the standard deviation at a point of an integrated Wiener process that is known at the
        runs, whose best estimate is the natural cubic spline (Kimeldorf and Wahba 1970). It is zero
        if the runs don't determine a linear function.
        """
        used, place = self._places(viscosity, factors, runs)
        weights = self._weights(viscosity, factors, runs)
        if not np.allclose(weights @ used, place, rtol=0.0, atol=ROUNDING):
            return 0.0
        cubes = np.linalg.norm(used[:, None] - np.vstack((used, place)), axis=2) ** 3
        return math.sqrt(max(0.0, weights @ (cubes[:, :-1] @ weights - 2.0 * cubes[:, -1])))

    def laws(self, viscosity: float, factors: Factors) -> tuple[Array, Array]:
        """Return the weights (n_runs,) of figures that are linear in nu, and of those in 1/nu."""
        weights = self._weights(viscosity, factors)
        return weights, self._weights(viscosity, factors, power=-1.0)

    def _square(self, viscosity: float, factors: Factors, estimate: int = 0) -> float:
        """Return r^2 over the largest of the training runs; negative below the onset."""
        runs, squares = self._estimates[estimate]
        return float(self._weights(viscosity, factors, runs) @ squares)

    def regime(self, viscosity: float, factors: Factors = NONE) -> str:
        """Return the regime of the flow at a point, one of REGIMES."""
        beyond = [self._square(viscosity, factors, k) > 0.0 for k in range(len(self._estimates))]
        if np.ptp(self.trained.viscosities) == 0.0 and viscosity != self.trained.viscosities[0]:
            return UNDECIDED  # one viscosity determines no onset
        return SHEDDING if all(beyond) else UNDECIDED if any(beyond) else STEADY

    def onsets(self, factors: Factors = NONE) -> list[float]:
        """Return the viscosity of the onset [m2/s] by each estimate, the model's own first."""
        return [self._onset(factors, k) for k in range(len(self._estimates))]

    def _onset(self, factors: Factors, estimate: int = 0) -> float:
        """Return the viscosity of the onset by one estimate; infinite without an onset."""
        low = float(self.trained.viscosities.min())
        high = FARTHEST * low
        if self._square(high, factors, estimate) > 0.0:
            return math.inf
        for _ in range(N_HALVINGS):
            middle = 0.5 * (low + high)
            if self._square(middle, factors, estimate) > 0.0:
                low = middle
            else:
                high = middle
        return high

    def _radius(self, viscosity: float, factors: Factors, fitted: bool) -> float:
        """Return r, zero below the onset; if `fitted`, not below that of the training runs."""
        radius = self._radii.max() * math.sqrt(max(self._square(viscosity, factors), 0.0))
        return float(max(radius, self._radii.min()) if fitted else radius)

    def _between(self, weights: Array, radius: float, harmonics: Harmonics) -> Harmonics:
        """Return interpolated harmonics of cycles with a radius."""
        scales = (radius / self._radii[:, None]) ** ORDERS
        return np.asarray(np.tensordot(weights, scales[..., None] * self._turns * harmonics, 1))

    def _held(self, viscosity: float, factors: Factors) -> float:
        """Return a viscosity, or below the onset that of the onset, whose closure holds there."""
        if self._square(viscosity, factors) > 0.0:
            return viscosity
        return min(viscosity, self._onset(factors))

    def cycle_at(
        self, viscosity: float, factors: Factors = NONE, fitted: bool = False
    ) -> LimitCycle:
        """Return the cycle at a point; if `fitted`, not smaller than the smallest trained one."""
        weights = self._weights(viscosity, factors)
        radius = self._radius(viscosity, factors, fitted)
        frequency = float(weights @ self.trained.frequencies)
        return LimitCycle(frequency, self._between(weights, radius, self._harmonics))

    def at(self, viscosity: float, factors: Factors = NONE) -> Polynomial:
        """Return the added rates at a viscosity [m2/s] and values of the other parameters."""
        return self._damped(viscosity, factors, self._damping)

    def _damped(self, viscosity: float, factors: Factors, damping: float) -> Polynomial:
        below = float(np.clip(self._square(viscosity, factors), -1.0, 0.0))
        viscosity = self._held(viscosity, factors)
        rates = self.operators.at(viscosity, factors)
        pushed = np.full(N_PHASES, self.trained.amplitude)
        cycle, unfitted = (self.cycle_at(viscosity, factors, fitted) for fitted in (True, False))
        of_cycle, missing = (c.rates - rates.along(c.states, pushed) for c in (cycle, unfitted))
        linear = _slope(cycle.states, of_cycle)
        mean = cycle.harmonics[0].real
        moving = _projector(cycle.harmonics[1:])
        linear -= damping * cycle.frequency * (np.eye(len(linear)) - moving)
        linear += below * cycle.frequency / (2.0 * math.pi) * moving
        return Polynomial(((missing.mean(axis=0) - linear @ mean, linear),))

    @cached_property
    def _damping(self) -> float:
        return DAMPINGS[int(np.argmin([self.slowest(damping) for damping in DAMPINGS]))]

    def slowest(self, damping: float | None = None) -> float:
        """Return the largest Floquet multiplier of trained cycles across their direction."""
        largest = []
        used = self._damping if damping is None else damping
        for viscosity, factors in self.trained.points:
            cycle = self.cycle_at(viscosity, factors)
            growth = np.eye(self.operators.n_modes)
            damped = self._damped(viscosity, factors, used)
            rates = self.operators.at(viscosity, factors).plus(damped)
            jacobians = rates.jacobians(cycle.states, self.trained.amplitude)
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
        (1 + N_HARMONICS, 6) [N/m, N] of the recorded ones. Beyond the viscosities of the runs the
        differences are those of the nearest one, because they are not linear over so long a way.
        """

        def modelled(at: PointForce, cycle: LimitCycle) -> Array:
            pushed = np.full(N_PHASES, self.trained.amplitude)
            return at.polynomial.along(cycle.states, pushed) + cycle.rates @ at.momentum.T

        defects = np.array(
            [
                recorded - harmonics_of(PHASES, modelled(at, cycle), 1.0)
                for recorded, at, cycle in zip(loads, trained, self.trained.cycles, strict=True)
            ]
        )
        viscosity = self._held(viscosity, factors)
        cycle = self.cycle_at(viscosity, factors, fitted=True)
        radius = self._radius(viscosity, factors, fitted=True)
        known = self.trained.viscosities
        within = float(np.clip(viscosity, known.min(), known.max()))
        weights = self._weights(within, factors)
        missing = around(self._between(weights, radius, defects))
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
