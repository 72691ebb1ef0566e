"""Checks of the rules between sections of a case; each section checks its own keys.

The loader calls `case_problems`. A check yields a key, such as `rom.0.basis`, and its problem.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator

from sphrom.case.discretization_checks import check_geometry, check_limits, check_size, check_steps
from sphrom.case.measure_sections import MEASURES, FrequencyMeasure
from sphrom.case.model_checks import (
    check_bases,
    check_fixed_points,
    check_models,
    check_modes,
    check_reduced_times,
    check_repeated,
    check_splines,
    check_surface,
    check_training_runs,
)
from sphrom.case.model_sections import ALL, LOCAL
from sphrom.case.models import Case
from sphrom.case.points import REYNOLDS
from sphrom.case.space_checks import check_space
from sphrom.case.study_checks import check_compare, check_sweep, check_trade, check_training
from sphrom.case.study_sections import FULL, FieldFigure, OfModes
from sphrom.case.yaml_reader import Problem
from sphrom.text import exact, nearest

Found = Iterator[tuple[str, str]]


def case_problems(
    case: Case, *, force: bool = False, replaces_training: bool = False
) -> list[Problem]:
    """Return the problems of a case; `force` accepts an unstable time step.

    Test points may be training points if other training points replace these.
    """
    limits = () if force else (check_limits,)
    points = (_check_points,) if replaces_training else (_check_points, _check_test_points)
    # Later checks need valid names and sizes, and then valid steps and points.
    first = (check_size, _check_names, _check_histories)
    for checks in (first, points, (*_CHECKS, *limits), _SNAPSHOT_CHECKS):
        if problems := [problem for check in checks for problem in check(case)]:
            return [Problem(_path(key), reason) for key, reason in problems]
    return []


def _path(key: str) -> tuple[str | int, ...]:
    return tuple(int(part) if part.isdecimal() else part for part in key.split("."))


def _check_names(case: Case) -> Found:
    """Check that all names that sections refer to exist in the case."""
    for key, kind, names, known in _references(case):
        for name in names:
            if name is not None and name not in known:
                yield key, f"no {kind} has the name {name}; {nearest(name, known)}"
    yield from _check_reynolds(case)
    for name, reason in case.scene.parameter_problems(case.plan.parameter_names):
        yield f"parameters.{name}", f"can't vary: {reason}"


def _check_reynolds(case: Case) -> Found:
    """Check that all points name the Reynolds number if training runs have several."""
    named: dict[str, Iterable[Collection[str]]] = {"parameters.test": case.parameters.test.named}
    if REYNOLDS not in case.plan.own_values:
        named |= {"parameters.train": case.parameters.train.named, "sweep": case.sweep.named}
        for i, model in enumerate(case.rom):
            # Numbers in a list are Reynolds numbers.
            named[f"rom.{i}.parameters"] = [v for v in model.parameters if isinstance(v, dict)]
    elif REYNOLDS not in case.training.ranges:
        return
    for key, points in named.items():
        if any(REYNOLDS not in names for names in points):
            yield f"{key}.{REYNOLDS}", "is missing, and training runs have several values; give one"


def _references(case: Case) -> Iterator[tuple[str, str, Collection[str | None], Collection[str]]]:
    """Yield a key, the kind of its names, these names, and the existing names."""
    models = [model.name for model in case.rom]
    fast = [model.name for model in case.rom if model.from_operators]
    bases, parameters, varied = (ALL, *case.basis.subsets), "parameter", "parameter that varies"
    own = dict.fromkeys((REYNOLDS, *case.plan.own_values))
    varying = case.plan.parameter_names
    yield "parameters.train", parameters, case.parameters.train.names, own
    yield "parameters.test", parameters, case.parameters.test.names, own
    for name, subset in case.basis.subsets.items():
        yield f"basis.subsets.{name}.box", varied, subset.box or (), varying
    for i, model in enumerate(case.rom):
        yield f"rom.{i}.basis", "basis", [model.basis], (*bases, LOCAL)
        for values in () if isinstance(model.parameters, str) else model.parameters:
            if isinstance(values, dict):
                yield f"rom.{i}.parameters", varied, values, varying
    for i, figure in enumerate(case.compare.figures):
        if isinstance(figure, OfModes):
            yield f"compare.figures.{i}.basis", "basis", [figure.basis], bases
        else:
            known = [*models, FULL] if isinstance(figure, FieldFigure) else models
            names = list(dict.fromkeys(name for row in figure.runs for name in row))
            yield f"compare.figures.{i}.runs", "run", names, known
    for name, measured in case.scene.measure.items():
        if isinstance(measured, FrequencyMeasure):
            of = measured.frequency.of
            yield f"scene.measure.{name}.frequency.of", "history", [of], case.scene.columns
    yield "trade.measure", "quantity of scene.measure", [case.trade.measure], case.scene.measure
    yield "sweep.model", "model", [case.sweep.model], [FULL, *models]
    yield "sweep", varied, case.sweep.names, varying
    yield "fit.model", "model with evaluation: operators", [case.fit.model], fast
    yield "fit.parameters", varied, case.fit.parameters, varying
    yield "training.model", "model with evaluation: operators", [case.training.model], fast
    yield "training", "key or parameter", case.training.ranges, own


def _check_points(case: Case) -> Found:
    """Check that full runs differ in their values, and that each is possible."""
    train = case.plan.train_points
    test = case.plan.test_points
    for key, points in (("parameters.train", train), ("parameters.test", test)):
        yield from check_repeated(key, points)
        for others in dict.fromkeys(point.others for point in points):
            try:
                case.plan.scene.check_at(dict(others))
            except ValueError as error:
                values = ", ".join(f"{name}={exact(value)}" for name, value in others)
                where, _, reason = str(error).partition(": ")
                yield (key, f"{values}: {error}") if values else (f"scene.{where}", reason)
                break


def _check_test_points(case: Case) -> Found:
    for point in filter(set(case.plan.train_points).__contains__, case.plan.test_points):
        yield "parameters.test", f"{point.label} is a training value; test other values"


def _check_histories(case: Case) -> Found:
    for name, reason in case.scene.unknown_times(case.time.final_time):
        yield f"scene.{name}", reason


def _check_scene(case: Case) -> Found:
    for name, reason in case.plan.problems_until(case.time.final_time):
        yield f"scene.{name}", reason
    for name, measured in case.scene.measure.items():
        if (problem := measured.time_problem(case) or measured.problem(case)) is not None:
            yield f"scene.measure.{name}.{MEASURES.kind_of(measured)}", problem


_CHECKS: tuple[Callable[[Case], Found], ...] = (
    check_space,
    check_geometry,
    _check_scene,
    check_splines,
    check_steps,
    check_bases,
    check_models,
    check_fixed_points,
    check_surface,
    check_compare,
)
_SNAPSHOT_CHECKS: tuple[Callable[[Case], Found], ...] = (
    check_training_runs,
    check_modes,
    check_reduced_times,
    check_trade,
    check_sweep,
    check_training,
)
