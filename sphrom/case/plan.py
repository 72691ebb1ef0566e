"""What follows from a case before anything runs: time steps, their limits, and snapshots."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sphrom.case.models import Case
from sphrom.sph import fluid

WHOLE_STEPS_TOLERANCE = 1e-6
"""How far, relatively, a duration may be from a whole number of steps."""


@dataclass(frozen=True)
class StepPlan:
    """The full model's steps: the same in all runs of a case, so that snapshots coincide."""

    time_step: float
    """dt [s]."""
    n_steps: int
    every: int
    """Steps from one snapshot to the next."""

    @property
    def n_snapshots(self) -> int:
        """Snapshots of one run, the initial one among them."""
        return self.n_steps // self.every + 1

    @property
    def snapshot_interval(self) -> float:
        """Time from one snapshot to the next [s]."""
        return self.every * self.time_step


def acoustic_limit(case: Case) -> float:
    """Return the largest acoustically stable time step [s] (Eq. 2.19)."""
    return fluid.acoustic_limit(case.smoothing_length, case.sound_speed)


def viscous_limit(case: Case) -> float:
    """Return the largest time step [s] that viscosity allows at every point of the case."""
    viscosity = max(case.kinematic_viscosity(point) for point in case.points)
    return fluid.viscous_limit(case.smoothing_length, viscosity)


def step_target(case: Case) -> float:
    """Return the time step [s] that the case asks for, before it is made to fit the final time.

    The automatic one takes the same share of both limits.
    """
    if case.time.step != "auto":
        return case.time.step
    share = case.time.courant_number / fluid.COURANT_LIMIT
    return share * min(acoustic_limit(case), viscous_limit(case))


def step_plan(case: Case) -> StepPlan:
    """Return the steps of every full run.

    An automatic step is shortened, so that the last snapshot falls on the final time.
    """
    every = case.snapshots.every
    steps = case.time.final_time / step_target(case)
    if case.time.step != "auto":
        return StepPlan(case.time.step, max(1, round(steps)), every)
    n_steps = every * math.ceil(steps * (1.0 - WHOLE_STEPS_TOLERANCE) / every)
    return StepPlan(case.time.final_time / n_steps, n_steps, every)


def substeps(case: Case, time_step: float | str) -> float:
    """Return how many steps [s] of a reduced model fit between two snapshots."""
    plan = step_plan(case)
    return float(plan.every) if time_step == "fom" else plan.snapshot_interval / float(time_step)


def basis_size(case: Case, name: str) -> int:
    """Return the number of modes to keep of a basis: those asked for, or as its snapshots allow."""
    return min(case.n_modes, n_basis_snapshots(case, name))


def n_basis_snapshots(case: Case, name: str) -> int:
    """Return the number of snapshots that a basis learns from."""
    return len(case.bases[name]) * step_plan(case).n_snapshots
