"""Checks of the studies of a case: comparison, trade, sweep and training.

They yield a key, such as `rom.0.basis`, and its problem; `sphrom.case.checks` calls them.
"""

from __future__ import annotations

from collections.abc import Iterator

from sphrom.case import studies
from sphrom.case.discretization_checks import check_geometry
from sphrom.case.model_checks import check_repeated
from sphrom.case.models import Case
from sphrom.case.plan_times import WHOLE_STEPS_TOLERANCE
from sphrom.case.points import REYNOLDS
from sphrom.case.study_sections import ErrorFigure, OfModes, OfRuns
from sphrom.errors import CaseError
from sphrom.text import exact, repeated

Found = Iterator[tuple[str, str]]


def check_compare(case: Case) -> Found:
    section = case.compare
    domain = case.scene.domain
    end = case.time.final_time
    if section.from_time >= end:
        reason = f"must be before time.final_time, {exact(end)} s; got {exact(section.from_time)}"
        yield "compare.from_time", reason
    if section.exact and case.plan.flow(case.plan.points[0]).exact is None:
        yield "compare.exact", f"a scene of kind {case.scene.kind} has no exact solution"
    left = domain.lower[0]
    right = domain.upper[0]
    line = case.plan.probe_line
    if not left < line < right:
        reason = f"must be within the scene, between {left:g} and {right:g} m; got {line:g}"
        yield "compare.line", reason
    elif not domain.sections(line):
        yield "compare.line", f"there is no fluid at x = {line:g} m; give another x"
    strip = case.plan.strip
    if strip is not None and strip.axis == 0 and strip.start < line < strip.end:
        reason = f"x = {line:g} m is in the strip of the inflow; set it downstream of it"
        yield "compare.line", reason
    for name in repeated(figure.name.casefold() for figure in section.figures):
        yield "compare.figures", f"two figures have the name {name}"
    for i, figure in enumerate(section.figures):
        problems = _figure_problems(case, figure)
        yield from ((f"compare.figures.{i}.{key}", reason) for key, reason in problems)


def _figure_problems(case: Case, figure: OfModes | OfRuns) -> Found:
    start = case.time.spin_up
    end = case.time.final_time
    if isinstance(figure, OfModes):
        if getattr(figure, "field", "") == "z-velocity" and case.scene.domain.n_dim == 2:
            yield "field", "must be density, x-velocity or y-velocity; the scene has no z"
        return
    for names, (_, points) in zip(figure.runs, studies.rows_of(case, figure), strict=True):
        missing = set(figure.reynolds or ()) - {point.reynolds for point in points}
        if missing or not points:
            at = f"at {exact(min(missing))} " if missing else ""
            yield "runs", f"{' and '.join(names)}: not run {at}beside a full run"
    if not isinstance(figure, ErrorFigure) and not start <= figure.time <= end:
        within = f"{exact(start)} s to {exact(end)} s"
        yield "time", f"must be within the recorded time, {within}; got {exact(figure.time)}"


def check_trade(case: Case) -> Found:
    section = case.trade
    plan = case.plan
    if (size := max(section.n_modes or (0,))) > plan.n_modes:
        reason = f"must be at most basis.n_modes, {plan.n_modes}; got {size}"
        yield "trade.n_modes", reason
    for resolution in section.resolutions or ():
        for _, reason in check_geometry(studies.at_resolution(case, resolution)):
            yield "trade.resolutions", f"{resolution}: {reason}"


def check_sweep(case: Case) -> Found:
    model = studies.sweep_model(case)
    points = studies.sweep_points(case)
    steps = case.plan.steps
    if case.sweep.sensitivities and (model is None or not model.from_operators):
        reason = (
            "needs a model with evaluation: operators, because its equations can be differentiated"
        )
        yield "sweep.sensitivities", reason
    yield from check_repeated("sweep", points)
    if model is None and points:
        thickest = min(points, key=lambda point: point.reynolds)
        limit = case.plan.step_limits(thickest).viscous
        if steps.time_step > limit * (1.0 + WHOLE_STEPS_TOLERANCE):
            reason = f"is stable only with steps below {limit:.4g} s, and full runs of this case"
            remedy = "lower time.step, or list it in parameters.test"
            took = f"take steps of {steps.time_step:.4g} s"
            yield "sweep.reynolds", f"{thickest.label} {reason} {took}: {remedy}"
    elif model is not None:
        try:
            for point in points:
                studies.require_basis(case, model, point)
        except CaseError as error:
            yield "sweep", str(error)


def check_training(case: Case) -> Found:
    section = case.training
    plan = case.plan
    model = studies.fast_section(case, section.model)
    if not section.ranges:
        return
    for name in plan.parameter_names:
        several = len({point.as_dict()[name] for point in plan.train_points}) > 1
        if name not in section.ranges and (several or name != REYNOLDS):
            way = "varies in parameters; give its range, too, or one value"
            if not several:
                way = "is in the points of parameters; give its range, or take it out of them"
            yield "training", f"{name} {way}"
    if (least := len(studies.Region(case).starts(())) + 1) > section.budget:
        reason = f"training starts from {least - 1} full runs, and tests its model at one more"
        yield "training.budget", f"must be at least {least}: {reason}; got {section.budget}"
    if model is None:
        yield "training", "needs a model with evaluation: operators, and rom has none"
    elif not plan.ends_with_case(model):
        reason = "has runs that end at another time than full runs; leave out until"
        yield "training", f"{model.name} {reason}"
    elif case.operators.error_estimate is False:
        reason = "training needs error estimates; leave it out, or set true"
        yield "operators.error_estimate", reason
