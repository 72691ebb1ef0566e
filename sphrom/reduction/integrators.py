"""How models on the reference points are integrated: by which method, and in how many steps.

Automatic steps of polynomial rates are exponential: they carry sound exactly, so that sound doesn't
limit them. Other steps are those of Runge and Kutta (Eq. 2.18).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

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


@dataclass(frozen=True)
class PolynomialIntegrator:
    """Steps of a model whose rates are a polynomial."""

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

    def with_steps(self, factor: float) -> PolynomialIntegrator:
        """Return the same with steps that are a factor as long."""
        return replace(self, n_steps=max(1, round(self.n_steps / factor)))

    def run(self) -> Runs:
        """Run the model."""
        model = self.model
        return model.corrected(
            self.system.run_in(
                [self.n_steps], model.start[None], model.output_times, model.amplitude
            )
        )

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


def runge_kutta(model: ReferenceModel, n_steps: int) -> PolynomialIntegrator:
    """Return Runge-Kutta steps (Eq. 2.18)."""
    return PolynomialIntegrator(model, PolynomialModel([model.polynomial]), n_steps)


def automatic(model: ReferenceModel) -> PolynomialIntegrator:
    """Return exponential steps that are fine enough for the basis."""
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
    return PolynomialIntegrator(model, system, n_steps)


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
