"""What follows from a case before anything runs: time steps, their limits, and snapshots."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction

from sphrom.case.models import Case
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import CaseError
from sphrom.sph import fluid
from sphrom.sph.time_loop import TimeSteps

MAX_STEPS = 1e9
"""Steps of one run beyond which a case is a slip of the pen."""
WHOLE_STEPS_TOLERANCE = 1e-6
"""How far, relatively, a duration may be from a whole number of steps."""
LARGEST_DENOMINATOR = 1000
"""Of the spin-up over the recorded time, so that one automatic step fits both."""
MOST_ESTIMATED_MODES = 30
"""Of a basis whose errors are estimated unasked: the work grows with their fourth power."""


def acoustic_limit(case: Case) -> float:
    """Return the largest acoustically stable time step [s] (Eq. 2.19)."""
    damping = case.discretization.acoustic_damping
    return fluid.acoustic_limit(case.smoothing_length, case.sound_speed, damping)


def viscous_limit(case: Case) -> float:
    """Return the largest time step [s] that viscosity allows at every point of the case."""
    thickest = min(case.points, key=lambda point: point.reynolds)
    return viscous_limit_at(case, case.kinematic_viscosity(thickest))


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


def step_plan(case: Case) -> TimeSteps:
    """Return the steps of every full run: the same at all points, so that snapshots coincide.

    An automatic step is shortened, so that the first snapshot falls on the end of the spin-up, and
    the last on the final time.
    """
    every, step = case.snapshots.every, case.time.step
    if step != "auto":
        n_spin_up_steps = round(case.time.spin_up / step)
        n_steps = max(1, round(recorded_time(case) / step))
        return TimeSteps(step, n_steps, every, n_spin_up_steps * step)
    ratio = spin_up_ratio(case)
    unit = math.lcm(every, ratio.denominator)
    steps = recorded_time(case) / step_target(case)
    n_steps = unit * math.ceil(steps * (1.0 - WHOLE_STEPS_TOLERANCE) / unit)
    step = recorded_time(case) / n_steps
    return TimeSteps(step, n_steps, every, int(ratio * n_steps) * step)


def model_plan(case: Case, model: ReducedModelSection) -> TimeSteps:
    """Return the steps of full runs that are as long as a reduced model's.

    Raises CaseError where its final time is none that `lengthened` allows.
    """
    plan = step_plan(case)
    return plan if model.until is None else lengthened(plan, model.until)


def ends_with_case(case: Case, model: ReducedModelSection) -> bool:
    """Return whether a model's runs end when full runs do, so that they can be compared."""
    return model_plan(case, model) == step_plan(case)


def lengthened(plan: TimeSteps, final_time: float) -> TimeSteps:
    """Return steps whose last snapshot is at another time [s], earlier or later.

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
