"""In what steps models on the reference points are run, and what a run takes.

Automatic steps are exponential ones where rates are polynomials: sound is carried exactly and
doesn't limit them. Rates from points, and steps that a case gives, are Runge-Kutta's (Eq. 2.18).
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.case.plan import MAX_STEPS, StepPlan
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import CaseError
from sphrom.online.reference_model import ReferenceModel
from sphrom.reduction.exponential import ExponentialModel
from sphrom.reduction.polynomial_model import PolynomialModel, Runs, Schedule, steps_within
from sphrom.reduction.step_choice import accurate_steps, first_exponential, step_tolerance

Array = NDArray[np.float64]

RUNGE_KUTTA, EXPONENTIAL = "runge-kutta", "exponential"


@dataclass(frozen=True)
class Stepping:
    """How a model is run."""

    system: PolynomialModel
    n_steps: int
    """Of the whole run."""
    linear: Array | None = None
    """What exponential steps carry; None for Runge-Kutta's."""

    @property
    def integrator(self) -> str:
        """The steps' name, as artifacts have it."""
        return RUNGE_KUTTA if self.linear is None else EXPONENTIAL


def stepping_of(
    model: ReducedModelSection, reduced: ReferenceModel, plan: StepPlan, *, points: bool
) -> Stepping:
    """Return how a model is run: in exponential steps, unless steps are given.

    Rates from points have none, and end steps on snapshots.

    Raises CaseError when stable steps would be too many for any run to end.
    """
    n_intervals = plan.n_snapshots - 1
    if model.time_step == "fom":
        return runge_kutta(reduced, plan.every * n_intervals)
    if model.time_step != "auto":
        return runge_kutta(reduced, round(plan.snapshot_interval / model.time_step) * n_intervals)
    if plan.snapshot_interval * n_intervals > MAX_STEPS * reduced.step_limit:
        raise CaseError(
            f"rom: {model.name} is stable with steps of {reduced.step_limit:.3g} s only, which are "
            f"more than {MAX_STEPS:g} in all; choose fewer modes, a shorter memory_length or a "
            "time_step"
        )
    if points:
        return runge_kutta(reduced, whole_steps(automatic_steps(reduced, plan), plan.n_snapshots))
    return automatic_stepping(reduced, plan)


def runge_kutta(reduced: ReferenceModel, n_steps: int) -> Stepping:
    """Return Runge-Kutta steps (Eq. 2.18)."""
    return Stepping(PolynomialModel([reduced.polynomial]), n_steps)


def automatic_stepping(reduced: ReferenceModel, plan: StepPlan) -> Stepping:
    """Return exponential steps that are fine enough for the basis."""
    if reduced.linear is None:
        return runge_kutta(reduced, automatic_steps(reduced, plan))
    schedule, n_stable = schedule_of(reduced, plan), _n_stable(reduced, plan)
    system = ExponentialModel([reduced.polynomial], reduced.linear)
    n_steps = accurate_steps(
        system,
        reduced.start[None],
        schedule,
        step_tolerance(reduced.basis),
        first_exponential(n_stable, schedule),
        reduced.amplitude,
        n_stable=n_stable,
    )
    return Stepping(system, n_steps, reduced.linear)


def automatic_steps(reduced: ReferenceModel, plan: StepPlan) -> int:
    """Return Runge-Kutta steps of a whole run that are stable, and fine enough for the basis."""
    return accurate_steps(
        PolynomialModel([reduced.polynomial]),
        reduced.start[None],
        schedule_of(reduced, plan),
        step_tolerance(reduced.basis),
        _n_stable(reduced, plan),
        reduced.amplitude,
    )


def _n_stable(reduced: ReferenceModel, plan: StepPlan) -> int:
    return steps_within(plan.snapshot_interval * (plan.n_snapshots - 1), reduced.step_limit)


def whole_steps(n_steps: int, n_snapshots: int) -> int:
    """Return as many steps or a few more, so that steps end on every snapshot."""
    n_intervals = n_snapshots - 1
    return n_intervals * math.ceil(n_steps / max(1, n_intervals))


def timed(
    reduced: ReferenceModel,
    schedule: Schedule,
    system: PolynomialModel,
    n_steps: int,
    repeats: int,
) -> tuple[Runs, float]:
    """Run, and return what it took [s]: the least of some runs once all is compiled.

    Points are run one by one, though a batch would share them out over threads: what a run takes
    is then its own, and runs of milliseconds are over before threads have started. Matrices of
    exponential steps, which are computed once, count as little as reading the operators does.
    """
    runs = system.run_in([n_steps], reduced.start[None], schedule, reduced.amplitude)
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        runs = system.run_in([n_steps], reduced.start[None], schedule, reduced.amplitude)
        seconds.append(time.perf_counter() - started)
    return runs, min(seconds)


def schedule_of(reduced: ReferenceModel, plan: StepPlan) -> Schedule:
    """Return the snapshots of a model's run."""
    return Schedule(plan.snapshot_interval, plan.n_snapshots, plan.start_time, reduced.largest_norm)
