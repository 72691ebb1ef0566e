"""What must hold between the keys of a case, and what a user should know about it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from sphrom.case.discretization_checks import (
    MAX_STEPS,
    beyond_limits,
    check_geometry,
    check_steps,
    check_support,
)
from sphrom.case.figure_checks import check_figures
from sphrom.case.fit_checks import check_fit
from sphrom.case.measure_checks import check_measures
from sphrom.case.messages import repeated
from sphrom.case.models import Case
from sphrom.case.parameter_checks import check_names, check_points
from sphrom.case.plan import (
    WHOLE_STEPS_TOLERANCE,
    has_error_estimate,
    model_plan,
    n_basis_snapshots,
    step_plan,
    substeps,
)
from sphrom.case.points import REYNOLDS, ParameterPoint, near, outside
from sphrom.case.reduced_model_checks import check_fixed_points, check_reduced_models
from sphrom.case.schema import Path
from sphrom.case.sections import ALL, AUTO, LOCAL, ReducedModelSection
from sphrom.case.sweep_checks import check_sweep
from sphrom.case.trade_checks import check_trade
from sphrom.case.training_checks import check_training
from sphrom.case.yaml_reader import Problem
from sphrom.errors import CaseError
from sphrom.text import exact

SNAPSHOTS_PER_MODE = 2
"""Fewer snapshots are few for so many modes."""


def case_problems(case: Case, *, force: bool = False) -> list[Problem]:
    """Return what makes a case invalid; `force` insists on an unstable time step."""
    if problems := list(check_names(case)):
        return problems
    problems = [problem for check in _CHECKS for problem in check(case)]
    if not force:
        problems += [
            Problem(("time", "step"), f"{reason}; --force insists on it")
            for reason in beyond_limits(case)
        ]
    # Snapshots can only be counted once steps and parameters make sense.
    return problems or [problem for check in _SNAPSHOT_CHECKS for problem in check(case)]


def case_warnings(case: Case) -> list[str]:
    """Return what a user should know about a valid case."""
    return [
        *(f"scene.{key}: {reason}" for key, reason in case.scene.warnings()),
        *(f"time.step: {reason}" for reason in beyond_limits(case)),
        *_outside_training(case),
        *_beyond_training(case),
        *_without_spin_up(case),
        *_sound_not_skew(case),
        *_end_not_kept(case),
        *_polynomial_too_low(case),
    ]


def _check_subsets(case: Case) -> Iterator[Problem]:
    for name in repeated(name.casefold() for name in (ALL, LOCAL, *case.basis.subsets)):
        yield Problem(("basis", "subsets"), f"the name {name} is taken")
    bases, train_points = case.bases, case.train_points  # each is put together when asked for
    for name, subset in case.basis.subsets.items():
        where: Path = ("basis", "subsets", name)
        for low, high in subset.bounds.values():
            if low > high:
                yield Problem(
                    (*where, "interval" if subset.box is None else "box"),
                    f"must go from the lower to the higher value; got {exact(low)}, {exact(high)}",
                )
        if (subset.reynolds is None) == (subset.box is None):
            yield Problem(where, "give either reynolds, the values that it learns from, or a box")
            continue
        if subset.box is not None and subset.interval is not None:
            yield Problem((*where, "interval"), "is for reynolds; a box has its own ranges")
        if not bases[name]:
            yield Problem(where, "none of the training values is in it")
        for label in repeated(exact(value) for value in subset.reynolds or ()):
            yield Problem((*where, "reynolds"), f"reynolds={label} stands more than once")
        trained = {point.reynolds for point in train_points}
        for value in subset.reynolds or ():
            if value not in trained:
                nearest_one = near(ParameterPoint(value), map(ParameterPoint, sorted(trained)))
                reason = f"reynolds={exact(value)} is not trained on; {nearest_one}"
                yield Problem((*where, "reynolds"), reason)


def _check_scene(case: Case) -> Iterator[Problem]:
    for name, reason in case.scene.problems(case.time.final_time):
        yield Problem(("scene", name), reason)


def _check_splines(case: Case) -> Iterator[Problem]:
    """Refuse B-splines where points are no lattice that fills a box."""
    if not case.lattice_splines:
        return
    scene, points = case.scene.kind, case.reference.points
    if not case.scene.domain.fills_box:
        yield Problem(
            ("psi", "kind"),
            f"B-splines are for fluid that fills a box, and the {scene}'s does not; set "
            "psi.kind: polyharmonic",
        )
    elif not case.reference_lattice:
        yield Problem(
            ("psi", "kind"),
            f"B-splines are for points of a lattice, and with reference.points: {points} these "
            "are not; set reference.points: lattice",
        )
    here = ", and auto means b-spline here" if case.psi.kind == "auto" else ""
    for key in ("order", "cell_width_ratio"):
        if getattr(case.psi, key) != type(case.psi).model_fields[key].default:
            yield Problem(("psi", key), f"is only for kind: polyharmonic{here}")


def _check_compare(case: Case) -> Iterator[Problem]:
    if case.compare.from_time >= case.time.final_time:
        yield Problem(
            ("compare", "from_time"),
            f"must be before time.final_time, {exact(case.time.final_time)} s; "
            f"got {exact(case.compare.from_time)}",
        )
    if case.compare.exact and not case.has_exact_solution:
        yield Problem(
            ("compare", "exact"), f"a scene of kind {case.scene.kind} has no exact solution"
        )
    left, right = case.scene.domain.lower[0], case.scene.domain.upper[0]
    if not left < case.probe_line < right:
        yield Problem(
            ("compare", "line"),
            f"must be within the scene, between {left:g} and {right:g} m; got {case.probe_line:g}",
        )


def _check_modes(case: Case) -> Iterator[Problem]:
    if (case.basis.n_modes or 0) > n_basis_snapshots(case, ALL):
        yield Problem(("basis", "n_modes"), _beyond_snapshots(case, ALL, case.n_modes))
    listed = case.rom if "rom" in case.model_fields_set else ()  # another one is made to fit
    for i, model in enumerate(listed):
        path = ("rom", i, "n_modes")
        bases = {case.basis_for(model, point): None for point in case.rom_points(model)}
        smallest = min(bases, key=lambda name: n_basis_snapshots(case, name))
        if model.n_modes == AUTO:
            yield from _check_chosen(case, model, bases, path)
        elif model.size > n_basis_snapshots(case, smallest):
            yield Problem(path, _beyond_snapshots(case, smallest, model.size))
        elif model.size > case.n_modes:
            yield Problem(
                path, f"must be at most basis.n_modes, {case.n_modes}; got {model.n_modes}"
            )


def _check_chosen(
    case: Case, model: ReducedModelSection, bases: Iterable[str], path: Path
) -> Iterator[Problem]:
    """Refuse to choose the number of modes of models that nothing is known of in training."""
    if not (model.from_operators and model.is_calibrated):
        yield Problem(
            path, "auto is for models with evaluation: operators that are calibrated; give a number"
        )
    elif not all(has_error_estimate(case, basis) for basis in bases):
        yield Problem(
            path,
            "auto needs the errors of training runs: set operators.error_estimate: true, or a "
            "smaller basis.n_modes",
        )


def _beyond_snapshots(case: Case, basis: str, n_modes: int) -> str:
    n_runs = len(case.bases[basis])
    runs = f"{n_runs} run{'s' if n_runs > 1 else ''} of {step_plan(case).n_snapshots}"
    return (
        f"must be at most the number of snapshots of basis {basis}, "
        f"{n_basis_snapshots(case, basis)} ({runs}); got {n_modes}"
    )


def _check_final_times(case: Case) -> Iterator[Problem]:
    for i, model in enumerate(case.rom):
        try:
            model_plan(case, model)
        except CaseError as error:
            yield Problem(("rom", i, "until"), str(error).removeprefix("final_time: "))


def _check_reduced_steps(case: Case) -> Iterator[Problem]:
    interval = step_plan(case).snapshot_interval
    for i, model in enumerate(case.rom):
        number = substeps(case, model.time_step)
        whole = max(1, round(number))
        if number > MAX_STEPS or abs(number - whole) > WHOLE_STEPS_TOLERANCE * whole:
            yield Problem(
                ("rom", i, "time_step"),
                f"the {interval:g} s between snapshots is not a whole number of steps of "
                f"{model.time_step:g} s; the nearest step is {interval / whole:.12g}",
            )


def _outside_training(case: Case) -> Iterator[str]:
    for point in case.test_points:
        if (warning := extrapolation(case, point)) is not None:
            yield f"parameters.test: {warning}"
    for i, model in enumerate(case.rom):
        for point in _unseen(case, model):
            if (warning := extrapolation(case, point)) is not None:
                yield f"rom.{i}.parameters: {warning}"


def _beyond_training(case: Case) -> Iterator[str]:
    trained = step_plan(case).end_time
    for i, model in enumerate(case.rom):
        if model_plan(case, model).end_time > trained:
            yield f"rom.{i}.until: {beyond_training(trained)}"


def beyond_training(trained_until: float) -> str:
    """Return a warning for a run that goes on after the trained time [s]."""
    return f"after {trained_until:g} s the run is beyond the trained time"


def extrapolation(case: Case, point: ParameterPoint) -> str | None:
    """Return a warning where a point is outside of the trained range, else None."""
    beyond = outside(point, case.train_points)
    if not beyond:
        return None
    ranges = " and ".join(
        each if name == REYNOLDS and not point.others else f"{each} of {name}"
        for name, each in beyond.items()
    )
    return (
        f"{point.label} is outside of the trained range, {ranges}: a reduced model extrapolates "
        "there"
    )


def _unseen(case: Case, model: ReducedModelSection) -> list[ParameterPoint]:
    """Return the points of a model at which there is no full run."""
    return [point for point in case.rom_points(model) if point not in case.points]


def _without_spin_up(case: Case) -> Iterator[str]:
    for i, model in enumerate(case.rom):
        for point in _unseen(case, model):
            start = case.start_point(point)
            if start != point:
                yield (
                    f"rom.{i}.parameters: {point.label} has no spin-up: its run starts from the "
                    f"end of that at {start.label}, the nearest trained"
                )


def _sound_not_skew(case: Case) -> Iterator[str]:
    if case.reference_bases and case.basis.inner_product == "raw":
        yield (
            "basis.inner_product: in the raw product operators on the reference points let sound "
            "grow; in the acoustic one they can't"
        )


def _end_not_kept(case: Case) -> Iterator[str]:
    plan = step_plan(case)
    if plan.n_steps % plan.every:
        last = f"the last snapshot is at {plan.end_time:g} s"
        yield f"snapshots.every: {last}, before time.final_time"


def few_snapshots(case: Case) -> Iterator[str]:
    """Warn where a basis keeps most of what its snapshots hold: the last modes are their noise."""
    needed = max((model.size for model in case.rom if model.n_modes != AUTO), default=0)
    used = {case.basis_for(m, point): None for m in case.rom for point in case.rom_points(m)}
    for name in used:
        number = n_basis_snapshots(case, name)
        if number < SNAPSHOTS_PER_MODE * needed:
            yield (
                f"snapshots.every: {needed} modes from {number} snapshots (basis {name}): the last "
                f"modes fit what is particular to these snapshots; keep {SNAPSHOTS_PER_MODE} a "
                "mode or more, with a lower snapshots.every, or ask for fewer modes"
            )


def _polynomial_too_low(case: Case) -> Iterator[str]:
    if case.lattice_splines:
        return
    order, degree = case.psi.order, case.psi.polynomial_degree
    least = (order - 1) // 2 if order % 2 else order // 2
    if degree < least:
        yield (
            f"psi.polynomial_degree: splines of order {order} are sure to exist from degree "
            f"{least} on; got {degree}"
        )


_Check = Callable[[Case], Iterable[Problem]]
_CHECKS: tuple[_Check, ...] = (
    check_points,
    check_geometry,
    _check_scene,
    check_measures,
    _check_splines,
    check_support,
    check_steps,
    _check_subsets,
    check_reduced_models,
    check_fixed_points,
    _check_compare,
    check_figures,
)
_SNAPSHOT_CHECKS: tuple[_Check, ...] = (
    _check_modes,
    _check_final_times,
    _check_reduced_steps,
    check_trade,
    check_sweep,
    check_fit,
    check_training,
)
