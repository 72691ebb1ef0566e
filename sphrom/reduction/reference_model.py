"""Reduced models on the reference points at given parameters, and their time integration.

A model consists of its rates as a polynomial and the start of its runs. Automatic steps are
exponential: they integrate sound exactly. Other steps are Runge-Kutta steps (Eq. 2.18).

Stability is not accuracy. Sound limits Runge-Kutta steps, and at 0.9 of the limit every step halves
the amplitude of the fastest sound; the resulting pressure error is once or twice that of the model
itself. Exponential steps have no limit, but an error from the change of the flow within a step.
Runs are therefore repeated with twice as many steps until the coordinates change little compared
with the truncation error of the basis, which follows from the singular values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sphrom.arrays import Array
from sphrom.machine import seconds_of
from sphrom.metrics.measures import Quantities
from sphrom.reduction import polynomial_model
from sphrom.reduction.correction import faded
from sphrom.reduction.exponential_steps import ExponentialModel, LinearPart
from sphrom.reduction.own_pressure import PointPressure
from sphrom.reduction.reduced_measures import PointForce, ReducedMeasure, TimedLoads
from sphrom.reduction.reduced_operators import Polynomial
from sphrom.reduction.trial_basis import JOINT, TrialBasis


@dataclass(frozen=True)
class ReferenceModel:
    """A reduced model on the reference points, ready to run."""

    polynomial: Polynomial
    basis: TrialBasis
    start: Array
    """(n_modes,) the coordinates at the start."""
    output_times: polynomial_model.OutputTimes
    """The snapshot times of a run, and the norm beyond which it counts as diverged."""
    mean_density_fluctuation: float = 0.0
    """The separate mean [kg/m3]."""
    amplitude: polynomial_model.Amplitude | None = None
    """The amplitude of the body force or of driven walls, if it changes with time."""
    closure: Polynomial | None = None
    """The part of the polynomial that a closure or calibration added to the projected rates."""
    memory_length: float | None = None
    """tau of Eq. 3.22 [s], for a model with the closure."""
    states: Array | None = None
    """(n_states, n_modes) training states; steps must be stable around them and the start."""
    linear: LinearPart | None = None
    """Linear part of exponential steps, a Jacobian at training states; None for Runge-Kutta
    steps."""
    longest_step: float = math.inf
    """The longest step that resolves the amplitude [s]."""
    first_step: float | None = None
    """First trial length [s] of automatic steps, if training runs determined it."""
    correction: Array | None = None
    """(n_trained_snapshots, n_modes) added to the coordinates of runs, if the model has one."""
    leading: ReferenceModel | None = None
    """The model of the first modes. Within the trained time only these are integrated, and the
    correction gives the other coordinates. None if all modes are integrated."""
    forces: Mapping[str, PointForce] = field(default_factory=dict)
    """Forces on walls, by name of the measurement."""
    measures: Mapping[str, ReducedMeasure] = field(default_factory=dict)
    """Flow rates and fields at places, by name of the measurement."""
    pressure: PointPressure | None = None
    """The coordinates of pressure modes; None if the pressure is that of the modes."""

    @cached_property
    def strongest(self) -> float:
        """The largest absolute amplitude of a run."""
        return float(np.abs(self.amplitudes(self.output_times.time)).max())

    @cached_property
    def step_limit(self) -> float:
        """The largest stable Runge-Kutta step [s]; infinite without training states."""
        if self.states is None:
            return math.inf
        return polynomial_model.step_limit(
            self.polynomial, np.vstack((self.start, self.states)), self.strongest
        )

    @property
    def n_resolving(self) -> int:
        """The number of steps that resolve the amplitude, at least one.

        A comparison of two runs with too few steps shows no error: both see a slower oscillation.
        """
        return max(1, math.ceil(round(self.output_times.duration / self.longest_step, 6)))

    @property
    def n_stable(self) -> int:
        """Number of stable Runge-Kutta steps of a run."""
        return polynomial_model.steps_within(self.output_times.duration, self.step_limit)

    def around(self, states: Array) -> ReferenceModel:
        """Return the model with the step limit and linear part of states (n_states, n_modes)."""
        linear = LinearPart(self.polynomial.jacobian(states.mean(axis=0), self.strongest))
        return replace(self, states=states, linear=linear)

    @property
    def n_integrated(self) -> int:
        """Number of modes that are integrated within the trained time."""
        return len(self.start) if self.leading is None else len(self.leading.start)

    def with_steps_of(self, other: ReferenceModel) -> ReferenceModel:
        """Return the model with the linear parts of another model's exponential steps."""
        leading = self.leading
        if leading is not None and other.leading is not None:
            leading = replace(leading, linear=other.leading.linear)
        return replace(self, linear=other.linear, leading=leading)

    def amplitudes(self, time: Array) -> Array:
        """Return the amplitude (n_times,) at times [s]."""
        return np.zeros(len(time)) if self.amplitude is None else self.amplitude(time)

    def with_pressure(self, time: Array, coordinates: Array) -> Array:
        """Return coordinates (..., n_states, n_modes), then those of separate pressure modes.

        `time` is (n_states,) [s]. A model of many runs has a first axis of runs.
        """
        if (pressure := self.pressure) is None:
            return coordinates
        own = pressure.polynomial.along(coordinates, self.amplitudes(time))
        if (correction := pressure.correction) is not None:
            times = self.output_times
            share = np.ones((*correction.shape[:-1], 1))
            known = faded(np.concatenate((correction, share), axis=-1), times.n_snapshots)
            added = TimedLoads(times.time, known).at(time)
            # Without the addition from training runs, separate modes may be worse than none.
            own = added[..., -1:] * own + added[..., :-1]
        return np.concatenate((coordinates, own), axis=-1)

    def measured(self, states: Array, mean: Array | float) -> dict[str, Quantities]:
        """Return measurements in the fluid by name, for states from `with_pressure`.

        `mean` is the separate density fluctuation [kg/m3], (n_states,) or one for all.
        """
        return {name: measure.at(states, mean) for name, measure in self.measures.items()}

    def spread(self, leading: Array) -> Array:
        """Return coordinates (..., n_modes) with the leading ones, and zero for the others."""
        out = np.zeros((*leading.shape[:-1], self.basis.n_modes))
        out[..., : leading.shape[-1]] = leading
        return out

    def completed(
        self, leading: Array | None, whole: Array | None, correction: Array | None
    ) -> tuple[Array, Array | None]:
        """Return coordinates (..., n_snapshots, n_modes), and the correction that they contain.

        The result is linear in the arguments, so it applies to derivatives too.

        Parameters
        ----------
        leading : coordinates integrated in the leading modes, within the trained time.
        whole : coordinates integrated in all modes; None if the leading modes suffice.
        correction : (n_trained_snapshots, n_modes).
        """
        if correction is not None and leading is not None:
            spread = self.spread(leading)
            if whole is None:
                added = correction[..., : spread.shape[-2], :]
                return spread + added, added
            n_trained = correction.shape[-2]
            correction = spread + correction - whole[..., :n_trained, :]
        assert whole is not None
        if correction is None:
            return whole, None
        added = faded(correction, whole.shape[-2])
        return whole + added, added


STEP_SHARE = 0.05
"""Largest error of steps over the truncation error of the basis. It is a tenth or less of the
pressure error in all three scenes (M = 5 to 20), and less of the velocity error, which is larger
while sound has as much energy in one as in the other."""
LEAST_ERROR = 1e-5
"""Smallest tolerance of coordinates over their norm: a basis may have no truncation error."""
ORDER = 4
"""Order of Eq. 2.18 and of exponential steps."""
MARGIN = 1.05
"""Factor on the number of steps that the order predicts."""
MOST = 1.4
"""Largest factor between two trials: errors of large steps fall faster than the order predicts."""
FINEST = 16
"""Largest refinement of stable steps; finer ones do not help."""
LONGER = 6
"""First trial of exponential steps over stable ones; they turn out 1 to 6 times as long."""


def step_tolerance(basis: TrialBasis) -> float:
    """Return the largest time-step error of coordinates (root mean square over their norm)."""
    squares = basis.singular_values[JOINT] ** 2
    share = math.sqrt(float(squares[basis.n_modes :].sum()) / float(squares.sum()))
    return max(LEAST_ERROR, STEP_SHARE * share)


@dataclass(frozen=True)
class Steps:
    """Time steps of a model in all modes, from its start to its last snapshot."""

    model: ReferenceModel
    system: polynomial_model.PolynomialModel
    n_steps: int
    """Number of steps of the whole run."""

    @property
    def time_step(self) -> float:
        """The time step [s]."""
        return self.system.time_step(self.n_steps, self.model.output_times)

    def scaled(self, factor: float) -> Steps:
        """Return steps that are `factor` times as long."""
        return replace(self, n_steps=max(1, round(self.n_steps / factor)))

    def run(self) -> polynomial_model.Run:
        """Integrate the rates."""
        model = self.model
        return self.system.run(self.n_steps, model.start, model.output_times, model.amplitude)


def accurate(first: Steps, tolerance: float) -> Steps:
    """Return about the fewest steps that are accurate, at most `FINEST` times the first.

    A run that diverges with any step keeps the first number.

    Parameters
    ----------
    first : the smallest number that is tried.
    tolerance : see `step_tolerance`.
    """

    def taken(n_steps: int) -> int:
        return first.system.steps_taken(n_steps, first.model.output_times)

    def excess(n_steps: int) -> float:
        """Return the error over the tolerance; zero if the model itself diverges.

        A divergence is the model's if there are at least as many steps as are stable.
        """
        coarse, fine = (replace(first, n_steps=n).run().coordinates for n in (n_steps, 2 * n_steps))
        if not np.isfinite(fine).all():
            return 0.0 if n_steps >= first.model.n_stable else math.inf
        if not np.isfinite(coarse).all():
            return math.inf
        size = float(np.linalg.norm(fine))
        change = float(np.linalg.norm(fine - coarse)) / size if size > 0.0 else 0.0
        return change / tolerance

    most = taken(FINEST * first.n_steps)
    n_steps = taken(first.n_steps)
    too_few = 0
    while n_steps < most:
        ratio = excess(n_steps)
        called_for = taken(math.ceil(n_steps * min(MARGIN * ratio ** (1.0 / ORDER), MOST)))
        if ratio <= 1.0:
            # For large steps the order predicts more steps than are needed.
            fewer = taken(max(called_for, too_few + 1, first.n_steps))
            enough = fewer < n_steps and 0.0 < excess(fewer) <= 1.0
            return replace(first, n_steps=fewer if enough else n_steps)
        n_steps, too_few = called_for, n_steps
    return replace(first, n_steps=most)


@dataclass(frozen=True)
class Integrator:
    """The time steps of a model: of all modes, of the leading ones, or of both.

    Both are used if leading modes are integrated and the run is longer than the training runs.
    """

    model: ReferenceModel
    whole: Steps | None
    leading: Steps | None = None

    @property
    def steps(self) -> Steps:
        """The steps of all modes if there are any, else those of the leading ones."""
        steps = self.whole or self.leading
        assert steps is not None
        return steps

    def with_steps(self, factor: float) -> Integrator:
        """Return an integrator with steps that are `factor` times as long."""
        whole, leading = (steps and steps.scaled(factor) for steps in (self.whole, self.leading))
        return replace(self, whole=whole, leading=leading)

    def run(self) -> polynomial_model.Run:
        """Run the model and add its correction."""
        whole = None if self.whole is None else self.whole.run()
        leading = None if self.leading is None else self.leading.run()
        run = whole or leading
        assert run is not None
        coordinates, correction = self.model.completed(
            None if leading is None else leading.coordinates,
            None if whole is None else whole.coordinates,
            self.model.correction,
        )
        diverged_at = run.diverged_at
        if leading is not None:
            diverged_at = float(np.fmin(leading.diverged_at, diverged_at))
        return replace(run, coordinates=coordinates, correction=correction, diverged_at=diverged_at)

    def timed(self, repeats: int) -> tuple[polynomial_model.Run, float]:
        """Return a run and the least processor time [s] of some repetitions, after compilation.

        The matrices of exponential steps are computed once and not timed.
        """
        return self.run(), min(seconds_of(self.run) for _ in range(repeats))


def choose(model: ReferenceModel, steps: Callable[[ReferenceModel], Steps]) -> Integrator:
    """Return the integrator of a model; `steps` chooses the steps of its parts."""
    if model.leading is None:
        return Integrator(model, steps(model))
    n_snapshots = model.output_times.n_snapshots
    # The leading modes alone are integrated up to the end of the training runs.
    n_trained = n_snapshots if model.correction is None else len(model.correction)
    times = replace(model.output_times, n_snapshots=min(n_snapshots, n_trained))
    whole = None
    if n_trained < n_snapshots:
        whole = steps(replace(model, leading=None, correction=None))
    return Integrator(model, whole, steps(replace(model.leading, output_times=times)))


def runge_kutta(model: ReferenceModel, n_steps: int) -> Steps:
    """Return Runge-Kutta steps (Eq. 2.18) of all modes."""
    return Steps(model, polynomial_model.PolynomialModel(model.polynomial), n_steps)


def automatic_whole(model: ReferenceModel) -> Steps:
    """Return steps of all modes that are accurate enough for the basis, exponential if possible.

    The first trial has at most one step per snapshot: enough unless sound makes rates stiff.
    """
    if model.linear is None:
        n_first = max(model.n_stable, model.n_resolving)
        return accurate(runge_kutta(model, n_first), step_tolerance(model.basis))
    times = model.output_times
    step = model.first_step
    n_first = 0 if step is None else math.ceil(round(times.duration / step, 6))
    n_first = n_first or min(math.ceil(model.n_stable / LONGER), times.n_snapshots - 1)
    n_first = max(n_first, model.n_resolving)
    first = Steps(model, ExponentialModel(model.polynomial, model.linear), n_first)
    steps = accurate(first, step_tolerance(model.basis))
    if step is None or model.states is None or steps.n_steps < FINEST * first.n_steps:
        return steps
    # The nearest training run is too far away.
    return automatic_whole(replace(model.around(model.states), first_step=None))


def automatic(model: ReferenceModel) -> Integrator:
    """Return an integrator with steps that are accurate enough for the basis."""
    return choose(model, automatic_whole)
