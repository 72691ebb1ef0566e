"""Checks of the parameters of a case: their names, their values, and that operators are affine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from sphrom.case.messages import nearest, repeated
from sphrom.case.models import Case
from sphrom.case.parameters import MAX_RUNS, GivenPoints
from sphrom.case.points import REYNOLDS, ParameterPoint, impossible
from sphrom.case.schema import Path
from sphrom.case.yaml_reader import Problem
from sphrom.text import exact


def check_names(case: Case) -> Iterator[Problem]:
    """Check that what varies is there and can vary, before anything asks for the points.

    Other sections may name the parameters of `parameters.train` and `test` only.
    """
    known = case.own_values
    for group in ("train", "test"):
        given: GivenPoints = getattr(case.parameters, group)
        path: Path = ("parameters", group)
        for name in given.names:
            if name not in known:
                yield Problem((*path, name), _unknown(case, name))
        yield from _check_form(given, path)
        if given.n_points > MAX_RUNS:
            yield Problem(("parameters",), f"at most {MAX_RUNS} values in all")
    if not _has_reynolds(case):
        yield Problem(
            ("parameters", "test", REYNOLDS),
            "is missing, and parameters.train has several: name one or more",
        )
    for name, reason in case.scene.parameter_problems(case.parameter_names):
        yield Problem(("parameters", name), f"can't vary: {reason}")
    for path, values in _elsewhere(case):
        for name in values:
            if name not in case.parameter_names:
                reason = f"{name} varies in neither parameters.train nor parameters.test"
                yield Problem(path, f"{reason}; {', '.join(case.parameter_names)} do")


def _unknown(case: Case, name: str) -> str:
    known = case.own_values
    return f"the case has no such parameter; {nearest(name, known)}"


def _check_form(given: GivenPoints, path: Path) -> Iterator[Problem]:
    """Check that points are given in one way only."""
    sample = given.sample
    if given.points and sample is not None:
        yield Problem((*path, "sample"), "is in place of points; give one of the two")
    if (given.points or sample) and len(given.lists) > 1:
        other = next(name for name in given.lists if name != REYNOLDS)
        yield Problem((*path, other), "is a list of a grid; leave out points and sample, or it")
    for name, (low, high) in (sample.ranges if sample else {}).items():
        if not low < high:
            reason = f"must go from the lower to the higher value; got {exact(low)}, {exact(high)}"
            yield Problem((*path, "sample", name), reason)
    if sample is not None and not sample.ranges:
        reason = "names no parameter: give one, such as reynolds: [50, 200]"
        yield Problem((*path, "sample"), reason)


def _has_reynolds(case: Case) -> bool:
    """Whether points that name no Reynolds number may have that of the case, as it has one."""
    train, test = case.parameters.train, case.parameters.test
    named = (train, test) if test.lists.keys() != {REYNOLDS} or test.points or test.sample else ()
    return len(train.reynolds) == 1 or all(
        REYNOLDS in point for given in named for point in (*given.points, *_names_of(given))
    )


def _names_of(given: GivenPoints) -> Sequence[Mapping[str, object]]:
    """Return the parameters of a sample or a grid, as one point."""
    if given.sample is not None:
        return [given.sample.ranges]
    if given.points:
        return []
    return [{name: values for name, values in given.lists.items() if values}]


def _elsewhere(case: Case) -> Iterator[tuple[Path, Mapping[str, object]]]:
    """Yield the values by name that other sections list."""
    for i, model in enumerate(case.rom):
        if not isinstance(model.parameters, str):
            yield from ((("rom", i, "parameters"), v) for v in _named(model.parameters))
    if not isinstance(case.trade.parameters, str):
        yield from ((("trade", "parameters"), v) for v in _named(case.trade.parameters))
    for name, subset in case.basis.subsets.items():
        yield ("basis", "subsets", name, "box"), subset.box or {}
    key = "parameters" if case.sweep.sample is None else "sample"
    yield ("sweep", key), dict.fromkeys(case.sweep.names)


def _named(listed: Sequence[object]) -> Iterator[Mapping[str, object]]:
    yield from (values for values in listed if isinstance(values, Mapping))


def check_points(case: Case) -> Iterator[Problem]:
    """Check that full runs are of different values, and that each can be made."""
    for group in ("train", "test"):
        points = case.train_points if group == "train" else case.test_points
        for label in repeated(point.label for point in points):
            yield Problem(_path(case, group), f"{label} stands more than once")
        yield from _check_values(case, points, ("parameters", group))
    trained = {point.label for point in case.train_points}
    for point in case.test_points:
        if point.label in trained:
            yield Problem(_path(case, "test"), f"{point.label} is trained on; test elsewhere")
    if len(case.points) > MAX_RUNS:
        yield Problem(("parameters",), f"at most {MAX_RUNS} values in all")


def _path(case: Case, group: str) -> Path:
    """Return the key that a group's values stand in."""
    given: GivenPoints = getattr(case.parameters, group)
    return ("parameters", group, REYNOLDS) if given.is_list else ("parameters", group)


def _check_values(case: Case, points: Sequence[ParameterPoint], path: Path) -> Iterator[Problem]:
    for point in points:
        if (reason := impossible(REYNOLDS, point.reynolds)) is not None:
            yield Problem(path, f"{point.label}: reynolds {reason}")
    for others in dict.fromkeys(point.others for point in points):
        try:
            case.scene.check_at(dict(others))
        except ValueError as error:
            label = ", ".join(f"{name}={exact(value)}" for name, value in others)
            yield Problem(path, f"{label}: {error}")
            return
