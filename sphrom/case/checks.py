"""What must hold between the keys of a case, and what a user should know about it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from sphrom.case.messages import nearest
from sphrom.case.models import ALL, Case
from sphrom.case.plan import (
    WHOLE_STEPS_TOLERANCE,
    acoustic_limit,
    n_basis_snapshots,
    step_plan,
    step_target,
    substeps,
    viscous_limit,
)
from sphrom.case.points import ParameterPoint
from sphrom.case.yaml_reader import Problem
from sphrom.kernels.wendland import SUPPORT_RATIO

MAX_STEPS = 1e9
"""Steps of one run beyond which a case is a slip of the pen."""
MAX_RUNS = 10_000
ROWS = ("full", "map", "exact")
"""Names of rows of the comparison that no reduced model may have."""
BEST = "best"
"""How the names of other such rows begin."""
ROUNDING = 1e-9
"""Slack for what is equal but for rounding."""


def case_problems(case: Case, *, force: bool = False) -> list[Problem]:
    """Return what makes a case invalid; `force` insists on an unstable time step."""
    problems = [problem for check in _CHECKS for problem in check(case)]
    if not force:
        problems += [
            Problem(("time", "step"), f"{reason}; --force insists on it")
            for reason in _beyond_limits(case)
        ]
    # Snapshots can only be counted once steps and parameters make sense.
    return problems or [problem for check in _SNAPSHOT_CHECKS for problem in check(case)]


def case_warnings(case: Case) -> list[str]:
    """Return what a user should know about a valid case."""
    return [
        *(f"time.step: {reason}" for reason in _beyond_limits(case)),
        *_outside_training(case),
        *_end_not_kept(case),
        *_polynomial_too_low(case),
    ]


def _check_parameters(case: Case) -> Iterator[Problem]:
    for group in ("train", "test"):
        points = case.train_points if group == "train" else case.test_points
        for label in _repeated(point.label for point in points):
            yield Problem(("parameters", group, "reynolds"), f"{label} stands more than once")
    trained = {point.label for point in case.train_points}
    for point in case.test_points:
        if point.label in trained:
            yield Problem(
                ("parameters", "test", "reynolds"), f"{point.label} is trained on; test elsewhere"
            )
    if len(case.points) > MAX_RUNS:
        yield Problem(("parameters",), f"at most {MAX_RUNS} values in all")


def _check_support(case: Case) -> Iterator[Problem]:
    resolution, length = case.discretization.resolution, case.scene.length
    for section, smoothing_length in (
        ("discretization", case.smoothing_length),
        ("reference", case.reference_smoothing_length),
    ):
        radius = SUPPORT_RATIO * smoothing_length
        if radius > 0.5 * length * (1.0 + ROUNDING):
            most = resolution / (2.0 * SUPPORT_RATIO)
            least = math.ceil(2.0 * radius / case.particle_spacing * (1.0 - ROUNDING))
            yield Problem(
                (section, "smoothing_length_ratio"),
                f"a support of radius {radius:g} m is larger than half of the periodic box of "
                f"{length:g} m; use at most {most:g}, or a resolution of at least {least}",
            )


def _check_steps(case: Case) -> Iterator[Problem]:
    steps = case.time.final_time / step_target(case)
    if steps > MAX_STEPS:
        yield Problem(("time",), f"a run of {steps:.3g} steps; at most {MAX_STEPS:g} are allowed")
        return
    if case.time.step != "auto":
        yield from _check_whole_steps(case, steps)
    if case.snapshots.every > max(1.0, steps) * (1.0 + WHOLE_STEPS_TOLERANCE):
        yield Problem(
            ("snapshots", "every"),
            f"must be at most the number of steps, {max(1, int(steps))}; "
            f"got {case.snapshots.every}",
        )


def _check_whole_steps(case: Case, steps: float) -> Iterator[Problem]:
    whole = max(1, round(steps))
    if abs(steps - whole) > WHOLE_STEPS_TOLERANCE * whole:
        step = case.time.final_time / whole
        yield Problem(
            ("time", "step"),
            f"{case.time.final_time:g} s is not a whole number of steps of {case.time.step:g} s; "
            f"the nearest step is {step:.12g}, or end at {whole * float(case.time.step):.12g} s",
        )


def _beyond_limits(case: Case) -> Iterator[str]:
    step = case.time.step
    limits = {"acoustic": acoustic_limit(case), "viscous": viscous_limit(case)}
    formulas = {"acoustic": "1.5 h / c0, Eq. 2.19", "viscous": "0.125 h^2 / nu"}
    for name, limit in limits.items():
        if step != "auto" and step > limit * (1.0 + WHOLE_STEPS_TOLERANCE):
            yield f"{step:g} s is beyond the {name} limit of {limit:.4g} s ({formulas[name]})"


def _check_subsets(case: Case) -> Iterator[Problem]:
    for name in _repeated(name.casefold() for name in (ALL, *case.basis.subsets)):
        yield Problem(("basis", "subsets"), f"the name {name} is taken")
    for name in case.basis.subsets:
        path = ("basis", "subsets", name, "reynolds")
        for label in _repeated(point.label for point in case.bases[name]):
            yield Problem(path, f"{label} stands more than once")
        for point in case.bases[name]:
            if point not in case.train_points:
                near = _near(point, case.train_points)
                yield Problem(path, f"{_exactly(point)} is not trained on; {near}")


def _check_reduced_models(case: Case) -> Iterator[Problem]:
    for name in _repeated(model.name.casefold() for model in case.rom):
        yield Problem(("rom",), f"two reduced models have the name {name}")
    for i, model in enumerate(case.rom):
        path = ("rom", i)
        if model.name.casefold() in ROWS or model.name.casefold().startswith(BEST):
            yield Problem(
                (*path, "name"),
                f"the comparison has rows of its own that are called {', '.join(ROWS)} or begin "
                f"with {BEST}; choose another name than {model.name}",
            )
        if model.basis not in case.bases:
            hint = nearest(model.basis, case.bases)
            yield Problem((*path, "basis"), f"no basis has the name {model.basis}; {hint}")
        if model.projection != "apg":
            for key in ("memory_length", "jacobian_step"):
                if getattr(model, key) != type(model).model_fields[key].default:
                    yield Problem((*path, key), "is only for projection: apg")
        points = case.rom_points(model)
        listed = () if isinstance(model.parameters, str) else points
        for label in _repeated(point.label for point in listed):
            yield Problem((*path, "parameters"), f"{label} stands more than once")
        for point in listed:
            if point not in case.points:
                yield Problem(
                    (*path, "parameters"),
                    f"{_exactly(point)} is in neither parameters.train nor parameters.test; "
                    f"{_near(point, case.points)}",
                )
        if not points:
            yield Problem((*path, "parameters"), f"there are no {model.parameters} values")


def _check_compare(case: Case) -> Iterator[Problem]:
    if case.compare.from_time >= case.time.final_time:
        yield Problem(
            ("compare", "from_time"),
            f"must be before time.final_time, {case.time.final_time:g} s; "
            f"got {case.compare.from_time:g}",
        )


def _check_modes(case: Case) -> Iterator[Problem]:
    if (case.basis.n_modes or 0) > n_basis_snapshots(case, ALL):
        yield Problem(("basis", "n_modes"), _beyond_snapshots(case, ALL, case.n_modes))
    for i, model in enumerate(case.rom):
        path = ("rom", i, "n_modes")
        if model.n_modes > n_basis_snapshots(case, model.basis):
            yield Problem(path, _beyond_snapshots(case, model.basis, model.n_modes))
        elif model.n_modes > case.n_modes:
            yield Problem(
                path, f"must be at most basis.n_modes, {case.n_modes}; got {model.n_modes}"
            )


def _beyond_snapshots(case: Case, basis: str, n_modes: int) -> str:
    n_runs = len(case.bases[basis])
    runs = f"{n_runs} run{'s' if n_runs > 1 else ''} of {step_plan(case).n_snapshots}"
    return (
        f"must be at most the number of snapshots of basis {basis}, "
        f"{n_basis_snapshots(case, basis)} ({runs}); got {n_modes}"
    )


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
    trained = [point.reynolds for point in case.train_points]
    low, high = min(trained), max(trained)
    for point in case.test_points:
        if not low <= point.reynolds <= high:
            yield (
                f"parameters.test: {point.label} is outside of the trained range, "
                f"{low:g} to {high:g}: a reduced model extrapolates there"
            )


def _end_not_kept(case: Case) -> Iterator[str]:
    plan = step_plan(case)
    if plan.n_steps % plan.every:
        last = (plan.n_snapshots - 1) * plan.snapshot_interval
        yield f"snapshots.every: the last snapshot is at {last:g} s, before time.final_time"


def _polynomial_too_low(case: Case) -> Iterator[str]:
    order, degree = case.psi.order, case.psi.polynomial_degree
    least = (order - 1) // 2 if order % 2 else order // 2
    if degree < least:
        yield (
            f"psi.polynomial_degree: splines of order {order} are sure to exist from degree "
            f"{least} on; got {degree}"
        )


def _near(point: ParameterPoint, known: Iterable[ParameterPoint]) -> str:
    nearest_point = min(known, key=lambda other: abs(other.reynolds - point.reynolds))
    return f"the nearest is {_exactly(nearest_point)}"


def _exactly(point: ParameterPoint) -> str:
    """Return a point's label with every digit that its values have."""
    values = ((name, value, f"{value:g}") for name, value in point.as_dict().items())
    return ", ".join(
        f"{name}={short if float(short) == value else repr(value)}" for name, value, short in values
    )


def _repeated(names: Iterable[str]) -> list[str]:
    return [name for name, count in Counter(names).items() if count > 1]


_Check = Callable[[Case], Iterable[Problem]]
_CHECKS: tuple[_Check, ...] = (
    _check_parameters,
    _check_support,
    _check_steps,
    _check_subsets,
    _check_reduced_models,
    _check_compare,
)
_SNAPSHOT_CHECKS: tuple[_Check, ...] = (_check_modes, _check_reduced_steps)
