"""The model and the ranges of a case's fit, and checks against the rest of the case."""

from __future__ import annotations

from collections.abc import Iterator

from sphrom.case.fit import LEAST_PERCENT, MOST_PERCENT
from sphrom.case.messages import nearest, show
from sphrom.case.models import Case
from sphrom.case.points import impossible
from sphrom.case.schema import Path
from sphrom.case.sections import ReducedModelSection
from sphrom.case.yaml_reader import Problem
from sphrom.errors import CaseError
from sphrom.text import exact

Ranges = dict[str, tuple[float, float]]


def fit_model(case: Case) -> ReducedModelSection | None:
    """Return the reduced model of a case's fit, None where there is none."""
    name = case.fit.model
    models = (model for model in case.rom if model.from_operators)
    return next((model for model in models if name in (None, model.name)), None)


def fit_ranges(case: Case, model: ReducedModelSection) -> Ranges:
    """Return the ranges of the parameters that are looked for, by name."""
    return {
        name: (float(given[0]), float(given[1])) if isinstance(given, tuple) else trained
        for name, trained in trained_ranges(case, model).items()
        if isinstance(given := case.fit.parameters.get(name), tuple | None)
    }


def fit_values(case: Case) -> dict[str, float]:
    """Return the values of the parameters that are known, by name."""
    given = case.fit.parameters.items()
    return {name: float(value) for name, value in given if not isinstance(value, tuple)}


def trained_ranges(case: Case, model: ReducedModelSection) -> Ranges:
    """Return the least and the greatest trained value of each parameter, by name."""
    points = case.bases.get(model.basis) or case.train_points
    rows = [point.as_dict() for point in points]
    return {
        name: (min(row[name] for row in rows), max(row[name] for row in rows))
        for name in case.parameter_names
    }


def percent(given: str | float, option: str) -> float:
    """Return a percentage such as `1%`. Raises CaseError, naming the option, for anything else."""
    try:
        value = float(str(given).strip().removesuffix("%"))
    except ValueError:
        value = 0.0
    if not LEAST_PERCENT <= value <= MOST_PERCENT:
        raise CaseError(
            f"{option}: must be a percentage above zero, such as 1%, from {LEAST_PERCENT:g} to "
            f"{MOST_PERCENT:g}; got {show(given)}"
        )
    return value


def check_fit(case: Case) -> Iterator[Problem]:
    """Check that the model exists in the case, and that there are parameters to look for."""
    name, path = case.fit.model, ("fit", "parameters")
    known = [model.name for model in case.rom if model.from_operators]
    if name is not None and name not in known:
        reason = f"no model with evaluation: operators has the name {name}; {nearest(name, known)}"
        yield Problem(("fit", "model"), reason)
    for parameter, given in case.fit.parameters.items():
        if parameter not in case.parameter_names:
            hint = nearest(parameter, case.parameter_names)
            yield Problem((*path, parameter), f"does not vary in the case; {hint}")
        else:
            yield from _check_range(parameter, given, (*path, parameter))


def _check_range(name: str, given: float | tuple[float, ...], path: Path) -> Iterator[Problem]:
    values = given if isinstance(given, tuple) else (given,)
    if (reason := impossible(name, min(values))) is not None:
        yield Problem(path, reason)
    elif len(values) == 2 and values[0] >= values[1]:
        reason = f"must be [low, high], low below high; got {exact(values[0])}, {exact(values[1])}"
        yield Problem(path, reason)
