"""How models on the reference points are integrated: by which method, and in how many steps.

Automatic steps of polynomial rates are exponential: they carry sound exactly, so that sound doesn't
limit them. Other steps are those of Runge and Kutta (Eq. 2.18).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from sphrom.reduction.exponential import ExponentialModel
from sphrom.reduction.polynomial_model import PolynomialModel, Runs, steps_within
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.reduction.step_choice import accurate_steps, first_exponential, step_tolerance


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

    def run(self) -> Runs:
        """Integrate the rates."""
        model = self.model
        return self.system.run_in(
            [self.n_steps], model.start[None], model.output_times, model.amplitude
        )


@dataclass(frozen=True)
class Integrator:
    """The steps of a model: of all modes, of the leading ones, or of both.

    Both are taken where leading modes are integrated, and a run is longer than training runs are.
    """

    model: ReferenceModel
    whole: Steps | None
    leading: Steps | None = None

    @property
    def _slowest(self) -> Steps:
        steps = self.whole or self.leading
        assert steps is not None
        return steps

    @property
    def name(self) -> str:
        """The method, as artifacts name it."""
        return self._slowest.system.integrator

    @property
    def time_step(self) -> float:
        """The length of its steps [s]; those of all modes where it takes both."""
        return self._slowest.time_step

    @property
    def n_steps(self) -> int:
        """The number of steps of the whole run; of all modes where it takes both."""
        return self._slowest.n_steps

    def with_steps(self, factor: float) -> Integrator:
        """Return the same with steps that are a factor as long."""
        whole, leading = (
            None if steps is None else steps.scaled(factor) for steps in (self.whole, self.leading)
        )
        return replace(self, whole=whole, leading=leading)

    def run(self) -> Runs:
        """Run the model, and add what training runs add to its coordinates."""
        whole = None if self.whole is None else self.whole.run()
        leading = None if self.leading is None else self.leading.run()
        coordinates, correction = self.model.completed(
            None if leading is None else leading.coordinates,
            None if whole is None else whole.coordinates,
            self.model.correction,
        )
        runs = whole or leading
        assert runs is not None
        if correction is not None:
            correction = np.broadcast_to(correction, coordinates.shape)
        diverged_at = runs.diverged_at
        if leading is not None:
            diverged_at = np.fmin(leading.diverged_at, diverged_at)
        return replace(
            runs, coordinates=coordinates, correction=correction, diverged_at=diverged_at
        )

    def timed(self, repeats: int) -> tuple[Runs, float]:
        """Run it, and return the least time [s] of some runs once everything is compiled.

        Points are run one by one, though a batch would share them out over threads: the time is
        then that of one run, and runs of milliseconds are over before threads have started. The
        matrices of exponential steps are computed once, and their time doesn't count.
        """
        runs, seconds = self.run(), []
        for _ in range(repeats):
            started = time.perf_counter()
            runs = self.run()
            seconds.append(time.perf_counter() - started)
        return runs, min(seconds)


def choose(model: ReferenceModel, steps: Callable[[ReferenceModel], Steps]) -> Integrator:
    """Return the integrator of a model, whose parts take the steps that a function chooses."""
    if model.leading is None:
        return Integrator(model, steps(model))
    n_snapshots = model.output_times.n_snapshots
    times = replace(model.output_times, n_snapshots=model.in_training(n_snapshots))
    whole = None
    if times.n_snapshots < n_snapshots:
        whole = steps(replace(model, leading=None, correction=None))
    return Integrator(model, whole, steps(replace(model.leading, output_times=times)))


def runge_kutta(model: ReferenceModel, n_steps: int) -> Steps:
    """Return Runge-Kutta steps (Eq. 2.18) of all modes."""
    return Steps(model, PolynomialModel([model.polynomial]), n_steps)


def automatic(model: ReferenceModel) -> Integrator:
    """Return exponential steps that are fine enough for the basis."""
    return choose(model, automatic_whole)


def automatic_whole(model: ReferenceModel) -> Steps:
    """Return such steps of all modes."""
    if model.linear is None:
        return runge_kutta(model, automatic_steps(model))
    system, n_stable = ExponentialModel([model.polynomial], model.linear), _n_stable(model)
    n_steps = accurate_steps(
        system,
        model.start[None],
        model.output_times,
        step_tolerance(model.basis),
        first_exponential(n_stable, model.output_times),
        model.amplitude,
        n_stable=n_stable,
    )
    return Steps(model, system, n_steps)


def automatic_steps(model: ReferenceModel) -> int:
    """Return Runge-Kutta steps of a whole run that are stable, and fine enough for the basis."""
    return accurate_steps(
        PolynomialModel([model.polynomial]),
        model.start[None],
        model.output_times,
        step_tolerance(model.basis),
        _n_stable(model),
        model.amplitude,
    )


def _n_stable(model: ReferenceModel) -> int:
    return steps_within(model.output_times.duration, model.step_limit)
