"""What a case costs and how near it is to its limits, told before anything runs."""

from __future__ import annotations

import math

from sphrom.case.hints import few_snapshots, slow_sweep, sweep_beyond_training
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import sweep_model, sweep_points
from sphrom.console import Reporter
from sphrom.kernels import SUPPORT_RATIO
from sphrom.setup.context import StageContext
from sphrom.setup.cost import full_seconds, needs, require_room, size_in_words
from sphrom.text import counted, duration


def run(context: StageContext) -> None:
    """Print what a case costs, and its margins (`sphrom case check`).

    Raises ResourceError when it would not fit this machine.
    """
    case = context.case
    for point in case.plan.points:
        describe_run(case, point, context.report)
    _describe_shape(case, context.report)
    for warning in few_snapshots(case):
        context.report.warn(warning)
    describe_cost(case, context.report)
    _describe_sweep(case, context.report)
    require_room(case, context.out)


def describe_run(case: Case, point: ParameterPoint, report: Reporter) -> None:
    """Print the numbers of one full run."""
    plan, fluid = case.plan, case.plan.fluid(point)
    ghosts = f" and {plan.n_ghosts} ghosts" if plan.n_ghosts else ""
    steps = counted(plan.steps.n_steps, "step")
    if plan.steps.n_spin_up_steps:
        steps = f"{counted(plan.steps.n_spin_up_steps, 'step')} to spin up and {steps} to record,"
    report.info(
        f"{point.label}: {plan.n_particles} particles{ghosts}, "
        f"{plan.discretization.n_neighbours:.0f} neighbours each, c0 = {fluid.sound_speed:g} m/s, "
        f"nu = {fluid.kinematic_viscosity:.4g} m2/s; {steps} of {plan.steps.time_step:.4g} s, "
        f"{_margins(case, point)}; {counted(plan.steps.n_snapshots, 'snapshot')}"
    )


def _margins(case: Case, point: ParameterPoint) -> str:
    """Return how near the time step is to its limits, in words."""
    plan, limits = case.plan, case.plan.step_limits(point)
    step = plan.steps.time_step
    told = [
        f"{_percent(step / limits.acoustic)} of the acoustic limit",
        f"{_percent(step / limits.viscous)} of the viscous one",
    ]
    if math.isfinite(limits.body_force):
        told.append(f"{_percent(step / limits.body_force)} of the body force's")
    return ", ".join(told[:-1]) + f" and {told[-1]}"


def _percent(share: float) -> str:
    return "less than 1%" if share < 0.01 else f"{share:.0%}"


def _describe_shape(case: Case, report: Reporter) -> None:
    """Print the area of the fluid, and how many supports its narrowest places are wide."""
    domain, support = case.scene.domain, SUPPORT_RATIO * case.plan.smoothing_length
    widths = {
        "narrowest gap" if domain.has_walls else "shortest period": domain.narrowest_gap,
        "thinnest solid": domain.thinnest_solid,
    }
    told = [
        f"{name} {width:.3g} m, {width / support:.3g} times the support's radius"
        for name, width in widths.items()
        if math.isfinite(width)
    ]
    report.info("; ".join((f"the fluid's area is {domain.area:.4g} m2", *told)))


def describe_cost(case: Case, report: Reporter) -> None:
    """Print how many runs there are, the memory and disk of all stages, and the time of fom."""
    stages, n_runs = needs(case), len(case.plan.points)
    largest = max(stages, key=lambda name: stages[name].ram)
    reduced = sum(len(case.plan.rom_points(model)) for model in case.rom)
    report.info(
        f"{counted(n_runs, 'full run')} and {counted(reduced, 'reduced run')}: about "
        f"{size_in_words(stages[largest].ram)} of memory, which {largest} needs most of, "
        f"{size_in_words(sum(need.disk for need in stages.values()))} on disk; the full "
        f"run{'s' * (n_runs > 1)} about {duration(full_seconds(case, n_runs))} on one core"
    )


def _describe_sweep(case: Case, report: Reporter) -> None:
    """Print what `sphrom sweep` would run, if the case says so."""
    if points := sweep_points(case):
        model = sweep_model(case)
        what = "the full model" if model is None else model.name
        if (advice := slow_sweep(case)) is not None:
            report.info(advice)
        report.info(
            f"a sweep of {what}: {counted(len(points), 'run')}, from {min(points).label} to "
            f"{max(points).label}"
        )
        if (warning := sweep_beyond_training(case)) is not None:
            report.warn(warning)
