"""What must hold between the keys of a case, and what a user should know about it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator

from sphrom.case.discretization_checks import (
    MAX_STEPS,
    beyond_limits,
    check_geometry,
    check_steps,
    check_support,
)
from sphrom.case.messages import nearest
from sphrom.case.models import Case, local_problem
from sphrom.case.plan import WHOLE_STEPS_TOLERANCE, n_basis_snapshots, step_plan, substeps
from sphrom.case.points import ParameterPoint
from sphrom.case.schema import Path
from sphrom.case.sections import ALL, LOCAL, ReducedModelSection
from sphrom.case.yaml_reader import Problem

MAX_RUNS = 10_000
ROWS = ("full", "map", "exact")
"""Names of rows of the comparison that no reduced model may have."""
BEST = "best"
"""How the names of other such rows begin."""


def case_problems(case: Case, *, force: bool = False) -> list[Problem]:
    """Return what makes a case invalid; `force` insists on an unstable time step."""
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
        *(f"time.step: {reason}" for reason in beyond_limits(case)),
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


def _check_subsets(case: Case) -> Iterator[Problem]:
    for name in _repeated(name.casefold() for name in (ALL, LOCAL, *case.basis.subsets)):
        yield Problem(("basis", "subsets"), f"the name {name} is taken")
    for name, (low, high) in case.intervals.items():
        if low > high:
            yield Problem(
                ("basis", "subsets", name, "interval"),
                f"must go from the lower to the higher value; got {low:g}, {high:g}",
            )
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
        yield from _check_basis(case, model, (*path, "basis"))
        yield from _check_keys(model, path)
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


_ONLY_FOR = {
    "memory_length": {"projection": "apg"},
    "jacobian_step": {"projection": "apg", "frame": "particles"},
    "advection": {"frame": "particles"},
    "output": {"frame": "reference"},
}
"""What a reduced model has to be for a key to mean something."""


def _check_keys(model: ReducedModelSection, path: Path) -> Iterator[Problem]:
    """Refuse keys that mean nothing for a kind of reduced model."""
    for key, needed in _ONLY_FOR.items():
        for other, value in needed.items():
            given = getattr(model, key) != type(model).model_fields[key].default
            if given and getattr(model, other) != value:
                yield Problem((*path, key), f"is only for {other}: {value}")


def _check_basis(case: Case, model: ReducedModelSection, path: Path) -> Iterator[Problem]:
    if model.basis == LOCAL:
        for point in case.rom_points(model):
            found = case.local_bases(point)
            if len(found) != 1:
                yield Problem(path, local_problem(point, found))
                return
    elif model.basis not in case.bases:
        hint = nearest(model.basis, (*case.bases, LOCAL))
        yield Problem(path, f"no basis has the name {model.basis}; {hint}")


def _check_compare(case: Case) -> Iterator[Problem]:
    if case.compare.from_time >= case.time.final_time:
        yield Problem(
            ("compare", "from_time"),
            f"must be before time.final_time, {case.time.final_time:g} s; "
            f"got {case.compare.from_time:g}",
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
    for i, model in enumerate(case.rom):
        path = ("rom", i, "n_modes")
        bases = {case.basis_for(model, point): None for point in case.rom_points(model)}
        smallest = min(bases, key=lambda name: n_basis_snapshots(case, name))
        if model.n_modes > n_basis_snapshots(case, smallest):
            yield Problem(path, _beyond_snapshots(case, smallest, model.n_modes))
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
        last = f"the last snapshot is at {plan.end_time:g} s"
        yield f"snapshots.every: {last}, before time.final_time"


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
    check_geometry,
    check_support,
    check_steps,
    _check_subsets,
    _check_reduced_models,
    _check_compare,
)
_SNAPSHOT_CHECKS: tuple[_Check, ...] = (_check_modes, _check_reduced_steps)
