"""Reduced models on the reference points at given parameters, and the steps that integrate them.

A model is its rates as a polynomial, and the start of its runs. Automatic steps of polynomial rates
are exponential: they carry sound exactly, so that sound doesn't limit them. Other steps are those
of Runge and Kutta (Eq. 2.18).

Stability is not accuracy. Sound limits the steps of Runge and Kutta's scheme, and at 0.9 of the
limit it halves the amplitude of the fastest sound in every step: pressure is then off by as much as
the model itself, or twice that. Exponential steps have no limit, but an error from the change of
the flow within a step. Runs are therefore repeated with twice the steps, until coordinates change
by little beside the truncation error of the basis, which its singular values give and which is
about the error of models.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sphrom.arrays import Array
from sphrom.machine import seconds_of
from sphrom.reduction.correction import faded
from sphrom.reduction.exponential_steps import ExponentialModel, LinearPart
from sphrom.reduction.polynomial_model import (
    Amplitude,
    OutputTimes,
    PolynomialModel,
    Run,
    step_limit,
    steps_within,
)
from sphrom.reduction.reduced_measures import PointForce, ReducedMeasure
from sphrom.reduction.reduced_rates import Polynomial
from sphrom.reduction.trial_basis import JOINT, TrialBasis


@dataclass(frozen=True)
class ReferenceModel:
    """A reduced model on the reference points, ready to run."""

    polynomial: Polynomial
    basis: TrialBasis
    start: Array
    """(n_modes,) the coordinates at the start."""
    output_times: OutputTimes
    """The snapshots of a run, and when it counts as divergent."""
    mean_density_fluctuation: float = 0.0
    """[kg/m3], carried apart."""
    amplitude: Amplitude | None = None
    """Of the body force or of driven walls, where it changes."""
    closure: Polynomial | None = None
    """What of the polynomial a closure or a calibration has added to the projected rates."""
    memory_length: float | None = None
    """tau of Eq. 3.22 [s], of a model with the closure."""
    states: Array | None = None
    """(n_states, n_modes) training states: around them, and the start, steps have to be stable."""
    linear: LinearPart | None = None
    """That of exponential steps, such as the Jacobian at the mean of the training states. None:
    automatic steps are Runge-Kutta's."""
    first_step: float | None = None
    """Length [s] of the automatic steps that are tried first, where training runs tell it."""
    correction: Array | None = None
    """(n_trained_snapshots, n_modes) added to the coordinates of runs, where the model has one."""
    leading: ReferenceModel | None = None
    """The model of the first modes that alone is integrated as long as training runs are; the
    correction is the whole of the others' coordinates. None where all modes are integrated."""
    forces: Mapping[str, PointForce] = field(default_factory=dict)
    """By the names of the measurements, the forces on walls."""
    measures: Mapping[str, ReducedMeasure] = field(default_factory=dict)
    """By the names of the measurements, flow rates and fields at places."""

    @cached_property
    def strongest(self) -> float:
        """The largest amplitude of a run, either sign."""
        if self.amplitude is None:
            return 0.0
        return float(np.abs(self.amplitude(self.output_times.time)).max())

    @cached_property
    def step_limit(self) -> float:
        """The largest stable Runge-Kutta step [s]; infinite without training states."""
        if self.states is None:
            return math.inf
        return step_limit(self.polynomial, np.vstack((self.start, self.states)), self.strongest)

    @property
    def n_stable(self) -> int:
        """Number of stable Runge-Kutta steps of a run."""
        return steps_within(self.output_times.duration, self.step_limit)

    def around(self, states: Array) -> ReferenceModel:
        """Return the model with the step limit and linear part of states (n_states, n_modes)."""
        linear = LinearPart(self.polynomial.jacobian(states.mean(axis=0), self.strongest))
        return replace(self, states=states, linear=linear)

    @property
    def n_integrated(self) -> int:
        """Number of modes that are integrated, as long as training runs are."""
        return len(self.start) if self.leading is None else len(self.leading.start)

    def with_steps_of(self, other: ReferenceModel) -> ReferenceModel:
        """Return the model with the linear parts that exponential steps of another one have."""
        leading = self.leading
        if leading is not None and other.leading is not None:
            leading = replace(leading, linear=other.leading.linear)
        return replace(self, linear=other.linear, leading=leading)

    def spread(self, leading: Array) -> Array:
        """Return coordinates (..., n_modes) of which the leading ones alone are not zero."""
        out = np.zeros((*leading.shape[:-1], self.basis.n_modes))
        out[..., : leading.shape[-1]] = leading
        return out

    def completed(
        self, leading: Array | None, whole: Array | None, correction: Array | None
    ) -> tuple[Array, Array | None]:
        """Return coordinates (..., n_snapshots, n_modes), and what of them is the correction.

        Linear in all of them: derivatives by a parameter follow from their own.

        Parameters
        ----------
        leading : those integrated in the leading modes, as long as training runs are.
        whole : those integrated in all modes; None where the leading modes are enough.
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
error of pressure in all three scenes (M = 5 to 20), and less of velocity's, as sound has as much
energy in one as in the other while velocity's error is the larger."""
LEAST_ERROR = 1e-5
"""Of coordinates, relative to their norm, that is asked for: a basis may leave out nothing."""
ORDER = 4
"""Of Eq. 2.18, and of exponential steps."""
MARGIN = 1.05
"""Factor over the number of steps that the order predicts."""
MOST = 1.4
"""Largest factor between two trials: errors of large steps fall faster than the order predicts."""
FINEST = 16
"""Largest refinement of stable steps: finer ones don't help."""
LONGER = 6
"""Exponential steps that are tried first, over stable ones: they turn out 1 to 6 times as long."""


def step_tolerance(basis: TrialBasis) -> float:
    """Return the largest error of coordinates by steps, in root mean squares over their norm."""
    squares = basis.singular_values[JOINT] ** 2
    share = math.sqrt(float(squares[basis.n_modes :].sum()) / float(squares.sum()))
    return max(LEAST_ERROR, STEP_SHARE * share)


@dataclass(frozen=True)
class Steps:
    """Steps of all modes of a model, from its start to its last snapshot."""

    model: ReferenceModel
    system: PolynomialModel
    n_steps: int
    """Of the whole run."""

    @property
    def time_step(self) -> float:
        """Their length [s]."""
        return self.system.time_step(self.n_steps, self.model.output_times)

    def scaled(self, factor: float) -> Steps:
        """Return steps that are a factor as long."""
        return replace(self, n_steps=max(1, round(self.n_steps / factor)))

    def run(self) -> Run:
        """Integrate the rates."""
        model = self.model
        return self.system.run(self.n_steps, model.start, model.output_times, model.amplitude)


def accurate(first: Steps, tolerance: float) -> Steps:
    """Return steps that are accurate, about the least that are enough; for a run that diverges at
    any step the first, and `FINEST` times as many at most.

    Parameters
    ----------
    first : the least number that is tried.
    tolerance : see `step_tolerance`.
    """

    def taken(n_steps: int) -> int:
        return first.system.steps_taken(n_steps, first.model.output_times)

    def excess(n_steps: int) -> float:
        """Return the error over the tolerance; zero if the divergence is not the steps' fault.

        From as many steps as are stable it is the model's.
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
    n_steps, too_few = taken(first.n_steps), 0
    while n_steps < most:
        found = excess(n_steps)
        called_for = taken(math.ceil(n_steps * min(MARGIN * found ** (1.0 / ORDER), MOST)))
        if found <= 1.0:
            # Far from small steps the order calls for more than it takes.
            fewer = taken(max(called_for, too_few + 1, first.n_steps))
            enough = fewer < n_steps and 0.0 < excess(fewer) <= 1.0
            return replace(first, n_steps=fewer if enough else n_steps)
        n_steps, too_few = called_for, n_steps
    return replace(first, n_steps=most)


@dataclass(frozen=True)
class Integrator:
    """The steps of a model: of all modes, of the leading ones, or of both.

    Both are taken where leading modes are integrated, and a run is longer than training runs are.
    """

    model: ReferenceModel
    whole: Steps | None
    leading: Steps | None = None

    @property
    def steps(self) -> Steps:
        """Those of all modes where it takes both."""
        steps = self.whole or self.leading
        assert steps is not None
        return steps

    def with_steps(self, factor: float) -> Integrator:
        """Return the same with steps that are a factor as long."""
        whole, leading = (steps and steps.scaled(factor) for steps in (self.whole, self.leading))
        return replace(self, whole=whole, leading=leading)

    def run(self) -> Run:
        """Run the model, and add what training runs add to its coordinates."""
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

    def timed(self, repeats: int) -> tuple[Run, float]:
        """Run it, and return the least processor time [s] of some runs, once all is compiled.

        The matrices of exponential steps are computed once, and their time doesn't count.
        """
        return self.run(), min(seconds_of(self.run) for _ in range(repeats))


def choose(model: ReferenceModel, steps: Callable[[ReferenceModel], Steps]) -> Integrator:
    """Return the integrator of a model, whose parts take the steps that a function chooses."""
    if model.leading is None:
        return Integrator(model, steps(model))
    n_snapshots = model.output_times.n_snapshots
    # Not after the training runs' last.
    n_trained = n_snapshots if model.correction is None else len(model.correction)
    times = replace(model.output_times, n_snapshots=min(n_snapshots, n_trained))
    whole = None
    if n_trained < n_snapshots:
        whole = steps(replace(model, leading=None, correction=None))
    return Integrator(model, whole, steps(replace(model.leading, output_times=times)))


def runge_kutta(model: ReferenceModel, n_steps: int) -> Steps:
    """Return Runge-Kutta steps (Eq. 2.18) of all modes."""
    return Steps(model, PolynomialModel(model.polynomial), n_steps)


def automatic_whole(model: ReferenceModel) -> Steps:
    """Return steps of all modes that are fine enough for the basis: exponential ones if it can.

    The first that are tried are from snapshot to snapshot at least: that is enough where it is
    something other than sound that is stiff.
    """
    if model.linear is None:
        return accurate(runge_kutta(model, model.n_stable), step_tolerance(model.basis))
    times, step = model.output_times, model.first_step
    n_first = 0 if step is None else math.ceil(round(times.duration / step, 6))
    n_first = n_first or min(math.ceil(model.n_stable / LONGER), times.n_snapshots - 1)
    first = Steps(model, ExponentialModel(model.polynomial, model.linear), max(1, n_first))
    found = accurate(first, step_tolerance(model.basis))
    if step is None or model.states is None or found.n_steps < FINEST * first.n_steps:
        return found
    # The nearest training run is far away.
    return automatic_whole(replace(model.around(model.states), first_step=None))


def automatic(model: ReferenceModel) -> Integrator:
    """Return steps that are fine enough for the basis."""
    return choose(model, automatic_whole)
