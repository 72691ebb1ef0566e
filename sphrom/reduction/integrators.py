"""How models on the reference points are integrated: by which method, and in how many steps.

Automatic steps of polynomial rates are exponential: they carry sound exactly, so that sound doesn't
limit them. Other steps are those of Runge and Kutta (Eq. 2.18).
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from sphrom.reduction.exponential import ExponentialModel
from sphrom.reduction.polynomial_model import PolynomialModel, Runs, steps_within
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.reduction.step_choice import accurate_steps, first_exponential, step_tolerance

Advance = Callable[[int], None]


class Integrator(Protocol):
    """A way to run a model: anything that gives its coordinates at all snapshots."""

    @property
    def name(self) -> str:
        """As artifacts name the method."""

    @property
    def time_step(self) -> float:
        """The length of its steps [s]."""

    def run(self) -> Runs:
        """Run the model."""

    def timed(self, repeats: int, advance: Advance) -> tuple[Runs, float]:
        """Run it, and return the time that a run takes [s].

        Parameters
        ----------
        repeats : of runs that take less than a moment.
        advance : called with the snapshots done since the last call, where a run takes long.
        """


class PolynomialIntegrator(Integrator, ABC):
    """Steps of a model whose rates are a polynomial."""

    @property
    @abstractmethod
    def taken(self) -> int:
        """The number of steps of the whole run."""

    @abstractmethod
    def with_steps(self, factor: float) -> PolynomialIntegrator:
        """Return the same with steps that are a factor as long."""

    def timed(self, repeats: int, advance: Advance) -> tuple[Runs, float]:
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


@dataclass(frozen=True)
class WholeIntegrator(PolynomialIntegrator):
    """Steps of all modes of a model."""

    model: ReferenceModel
    system: PolynomialModel
    n_steps: int
    """Of the whole run."""

    @property
    def name(self) -> str:
        """As artifacts name the method."""
        return self.system.integrator

    @property
    def time_step(self) -> float:
        """The length of its steps [s]."""
        return self.system.time_step(self.n_steps, self.model.output_times)

    @property
    def taken(self) -> int:
        """The number of steps of the whole run."""
        return self.n_steps

    def with_steps(self, factor: float) -> WholeIntegrator:
        """Return the same with steps that are a factor as long."""
        return replace(self, n_steps=max(1, round(self.n_steps / factor)))

    def run(self) -> Runs:
        """Run the model."""
        model = self.model
        return _completed(
            model,
            None,
            self.system.run_in(
                [self.n_steps], model.start[None], model.output_times, model.amplitude
            ),
        )


@dataclass(frozen=True)
class LeadingIntegrator(PolynomialIntegrator):
    """Steps of a model's leading modes; of all modes too where a run is longer than training."""

    model: ReferenceModel
    leading: WholeIntegrator
    whole: WholeIntegrator | None

    @property
    def name(self) -> str:
        """As artifacts name the method."""
        return self._slowest.name

    @property
    def time_step(self) -> float:
        """The length of its steps [s]; those of all modes where it takes both."""
        return self._slowest.time_step

    @property
    def _slowest(self) -> WholeIntegrator:
        return self.whole or self.leading

    @property
    def taken(self) -> int:
        """The number of steps of the whole run; of all modes where it takes both."""
        return self._slowest.n_steps

    def with_steps(self, factor: float) -> LeadingIntegrator:
        """Return the same with steps that are a factor as long."""
        whole = None if self.whole is None else self.whole.with_steps(factor)
        return replace(self, leading=self.leading.with_steps(factor), whole=whole)

    def run(self) -> Runs:
        """Run the model."""
        whole = None if self.whole is None else self.whole.run()
        return _completed(self.model, self.leading.run(), whole)


def _completed(model: ReferenceModel, leading: Runs | None, whole: Runs | None) -> Runs:
    """Return runs of leading modes or of all, or both, with what training runs add."""
    coordinates, correction = model.completed(
        None if leading is None else leading.coordinates,
        None if whole is None else whole.coordinates,
        model.correction,
    )
    runs = whole or leading
    assert runs is not None
    if correction is not None:
        correction = np.broadcast_to(correction, coordinates.shape)
    diverged_at = runs.diverged_at
    if leading is not None:
        diverged_at = np.fmin(leading.diverged_at, diverged_at)
    return replace(runs, coordinates=coordinates, correction=correction, diverged_at=diverged_at)


def choose(
    model: ReferenceModel, steps: Callable[[ReferenceModel], WholeIntegrator]
) -> PolynomialIntegrator:
    """Return the integrator of a model, whose parts take the steps that a function chooses."""
    if model.leading is None:
        return steps(model)
    n_snapshots = model.output_times.n_snapshots
    times = replace(model.output_times, n_snapshots=model.in_training(n_snapshots))
    whole = None
    if times.n_snapshots < n_snapshots:
        whole = steps(replace(model, leading=None, correction=None))
    return LeadingIntegrator(model, steps(replace(model.leading, output_times=times)), whole)


def runge_kutta(model: ReferenceModel, n_steps: int) -> WholeIntegrator:
    """Return Runge-Kutta steps (Eq. 2.18) of all modes."""
    return WholeIntegrator(model, PolynomialModel([model.polynomial]), n_steps)


def automatic(model: ReferenceModel) -> PolynomialIntegrator:
    """Return exponential steps that are fine enough for the basis."""
    return choose(model, automatic_whole)


def automatic_whole(model: ReferenceModel) -> WholeIntegrator:
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
    return WholeIntegrator(model, system, n_steps)


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


def whole_steps(n_steps: int, n_snapshots: int) -> int:
    """Return as many steps or a few more, so that steps end on every snapshot."""
    n_intervals = n_snapshots - 1
    return n_intervals * math.ceil(n_steps / max(1, n_intervals))
