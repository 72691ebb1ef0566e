"""What follows from a case before anything runs: time steps, their limits, and snapshots."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction

from sphrom.case.models import Case
from sphrom.errors import CaseError
from sphrom.sph import fluid

MAX_STEPS = 1e9
"""Steps of one run beyond which a case is a slip of the pen."""
WHOLE_STEPS_TOLERANCE = 1e-6
"""How far, relatively, a duration may be from a whole number of steps."""
LARGEST_DENOMINATOR = 1000
"""Of the spin-up over the recorded time, so that one automatic step fits both."""
MOST_ESTIMATED_MODES = 30
"""Of a basis whose errors are estimated unasked: the work grows with their fourth power."""


@dataclass(frozen=True)
class StepPlan:
    """The full model's steps: the same in all runs of a case, so that snapshots coincide."""

    time_step: float
    """dt [s]."""
    n_steps: int
    """Recorded steps: those after the spin-up."""
    every: int
    """Steps from one snapshot to the next."""
    n_spin_up_steps: int = 0
    """Steps before anything is recorded."""

    @property
    def start_time(self) -> float:
        """Time of the first snapshot, the end of the spin-up [s]."""
        return self.n_spin_up_steps * self.time_step

    @property
    def end_time(self) -> float:
        """Time of the last snapshot [s]."""
        return self.start_time + (self.n_snapshots - 1) * self.snapshot_interval

    @property
    def n_snapshots(self) -> int:
        """Snapshots of one run, the first recorded instant among them."""
        return self.n_steps // self.every + 1

    @property
    def snapshot_interval(self) -> float:
        """Time from one snapshot to the next [s]."""
        return self.every * self.time_step


def acoustic_limit(case: Case) -> float:
    """Return the largest acoustically stable time step [s] (Eq. 2.19)."""
    damping = case.discretization.acoustic_damping
    return fluid.acoustic_limit(case.smoothing_length, case.sound_speed, damping)


def viscous_limit(case: Case) -> float:
    """Return the largest time step [s] that viscosity allows at every point of the case."""
    return viscous_limit_at(case, max(case.kinematic_viscosity(point) for point in case.points))


def viscous_limit_at(case: Case, kinematic_viscosity: float) -> float:
    """Return the largest time step [s] that a viscosity [m2/s] allows."""
    spacing = case.particle_spacing if case.scene.domain.has_walls else None
    return fluid.viscous_limit(case.smoothing_length, kinematic_viscosity, spacing)


def force_limit(case: Case) -> float:
    """Return the largest time step [s] that the body force allows, infinite where there is none."""
    return fluid.force_limit(case.smoothing_length, case.largest_body_force)


def recorded_time(case: Case) -> float:
    """Return how long a run is recorded [s]."""
    return case.time.final_time - case.time.spin_up


def step_target(case: Case) -> float:
    """Return the time step [s] that the case asks for, before it is made to fit the durations.

    The automatic one takes the same share of all limits.
    """
    if case.time.step != "auto":
        return case.time.step
    share = case.time.courant_number / fluid.COURANT_LIMIT
    return share * min(acoustic_limit(case), viscous_limit(case), force_limit(case))


def spin_up_ratio(case: Case) -> Fraction:
    """Return the spin-up over the recorded time, or the nearest ratio that steps can have."""
    ratio = Fraction(case.time.spin_up / recorded_time(case))
    return ratio.limit_denominator(LARGEST_DENOMINATOR)


def step_plan(case: Case) -> StepPlan:
    """Return the steps of every full run.

    An automatic step is shortened, so that the first snapshot falls on the end of the spin-up, and
    the last on the final time.
    """
    every, step = case.snapshots.every, case.time.step
    if step != "auto":
        n_spin_up_steps = round(case.time.spin_up / step)
        n_steps = max(1, round(recorded_time(case) / step))
        return StepPlan(step, n_steps, every, n_spin_up_steps)
    ratio = spin_up_ratio(case)
    unit = math.lcm(every, ratio.denominator)
    steps = recorded_time(case) / step_target(case)
    n_steps = unit * math.ceil(steps * (1.0 - WHOLE_STEPS_TOLERANCE) / unit)
    return StepPlan(recorded_time(case) / n_steps, n_steps, every, int(ratio * n_steps))


def lengthened(plan: StepPlan, final_time: float) -> StepPlan:
    """Return a plan whose last snapshot is at another time [s], earlier or later.

    Raises CaseError where that is no whole number of snapshot intervals after the first snapshot.
    """
    intervals = (final_time - plan.start_time) / plan.snapshot_interval
    whole = round(intervals) if 0.5 <= intervals <= MAX_STEPS / plan.every else 0
    if not whole or abs(intervals - whole) > WHOLE_STEPS_TOLERANCE * whole:
        nearest = plan.start_time + max(1, whole) * plan.snapshot_interval
        raise CaseError(
            f"final_time: must be a whole number of snapshot intervals of "
            f"{plan.snapshot_interval:.12g} s after {plan.start_time:g} s, and at most "
            f"{MAX_STEPS:g} steps; the nearest is {nearest:.12g}; got {final_time:g}"
        )
    return replace(plan, n_steps=whole * plan.every)


def substeps(case: Case, time_step: float | str) -> float:
    """Return how many steps [s] of a reduced model fit between two snapshots.

    As many as of the full model where the step is not a number.
    """
    plan = step_plan(case)
    if isinstance(time_step, str):
        return float(plan.every)
    return plan.snapshot_interval / time_step


def basis_size(case: Case, name: str) -> int:
    """Return the number of modes to keep of a basis: those asked for, or as its snapshots allow."""
    return min(case.n_modes, n_basis_snapshots(case, name))


def has_error_estimate(case: Case, name: str) -> bool:
    """Return whether errors of a basis's models on the reference points are estimated."""
    wanted = case.operators.error_estimate
    if wanted == "auto":
        n_parts = 2 if case.basis.fields == "separate" else 1
        return n_parts * basis_size(case, name) <= MOST_ESTIMATED_MODES
    return wanted


def n_basis_snapshots(case: Case, name: str) -> int:
    """Return the number of snapshots that a basis learns from."""
    return len(case.bases[name]) * step_plan(case).n_snapshots
