"""The model and the values of a case's sweep, and checks against the rest of the case."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product

import numpy as np

from sphrom.case.draw_checks import check_draws
from sphrom.case.messages import nearest, repeated
from sphrom.case.models import Case
from sphrom.case.plan import WHOLE_STEPS_TOLERANCE, step_plan, viscous_limit_at
from sphrom.case.points import REYNOLDS, ParameterPoint, impossible, outside
from sphrom.case.reduced_model_checks import basis_problem
from sphrom.case.schema import Path
from sphrom.case.sections import LOCAL, ReducedModelSection
from sphrom.case.sweep import MOST_VALUES, SpreadSection, SweepSection
from sphrom.case.yaml_reader import Problem
from sphrom.text import exact

FULL = "full"
"""The name of the full model in a sweep."""
_VALUES: Path = ("sweep", "reynolds")


def sweep_model(case: Case) -> ReducedModelSection | None:
    """Return the reduced model of a case's sweep, None where it is the full one."""
    name = case.sweep.model
    if name is None:
        return next((model for model in case.rom if model.on_points), None)
    return next((model for model in case.rom if model.name == name), None)


def sweep_name(case: Case) -> str:
    """Return the name of the files of a case's sweep."""
    model = sweep_model(case)
    return case.sweep.name or (FULL if model is None else model.name)


def sweep_points(case: Case) -> tuple[ParameterPoint, ...]:
    """Return where a case's sweep runs its model, in order; nowhere where no values are given."""
    section = case.sweep
    if section.sample is not None:
        return case.points_at(tuple(section.sample.entries), section.sample.rows)
    if section.points:
        return tuple(map(case.point, section.points))
    lists = {name: _values(given) for name, given in _grid(section).items()}
    rows = product(*lists.values()) if lists else ()
    return tuple(case.point(dict(zip(lists, row, strict=True))) for row in rows)


def _grid(section: SweepSection) -> dict[str, tuple[float, ...] | SpreadSection]:
    """Return what a grid has by parameter; a sweep may be of Reynolds numbers alone, or others."""
    reynolds = {} if section.reynolds is None else {REYNOLDS: section.reynolds}
    return {**reynolds, **section.parameters}


def _values(given: tuple[float, ...] | SpreadSection) -> list[float]:
    return [float(v) for v in (_spread(given) if isinstance(given, SpreadSection) else given)]


def _spread(section: SpreadSection) -> np.ndarray:
    low, high = section.low, section.high
    if section.step is not None:
        return low + section.step * np.arange(_n_steps(section))
    count = section.count or 1
    if section.spacing == "linear":
        return np.linspace(low, high, count)
    if section.spacing == "logarithmic":
        return np.geomspace(low, high, count)
    # The first values are the same however many are drawn, so that a sweep can be extended.
    draws = np.random.default_rng(section.seed).random(count)
    if section.spacing == "latin-hypercube":
        draws = (np.arange(count) + draws) / count
    return low + (high - low) * draws


def _n_steps(section: SpreadSection) -> int:
    steps = (section.high - section.low) / (section.step or math.inf)
    return 1 + math.floor(steps * (1.0 + WHOLE_STEPS_TOLERANCE))


def check_sweep(case: Case) -> Iterator[Problem]:
    """Check that the model exists in the case, and can run at the values."""
    name = case.sweep.model
    known = (FULL, *(model.name for model in case.rom))
    if name is not None and name not in known:
        reason = f"no model has the name {name}; {nearest(name, known)}"
        yield Problem(("sweep", "model"), reason)
        return
    model = sweep_model(case)
    if case.sweep.sensitivities and (model is None or not model.from_operators):
        reason = "is for models with evaluation: operators, which have equations to differentiate"
        yield Problem(("sweep", "sensitivities"), reason)
    problems = [*_check_form(case.sweep), *check_draws(case.sweep)]
    for name, given in _grid(case.sweep).items():
        path = _VALUES if name == REYNOLDS else ("sweep", "parameters", name)
        problems += _check_spread(given, path)
    yield from problems
    yield from _check_probes(case)
    if not problems:
        yield from _check_points(case)


def _check_form(section: SweepSection) -> Iterator[Problem]:
    """Check that points are given in one way only, and aren't too many."""
    ways = (bool(_grid(section)), bool(section.points), section.sample is not None)
    if sum(ways) > 1:
        keys = "reynolds and parameters, points, or sample"
        yield Problem(("sweep",), f"give values in one way only: {keys}; null leaves one out")
    n_points = math.prod(_count(given) for given in _grid(section).values())
    if n_points > MOST_VALUES and len(_grid(section)) > 1:
        reason = f"makes {n_points} combinations; at most {MOST_VALUES} are allowed"
        yield Problem(("sweep", "parameters"), reason)


def _count(given: tuple[float, ...] | SpreadSection) -> int:
    if not isinstance(given, SpreadSection):
        return len(given)
    return given.count or _n_steps(given)


def _check_spread(given: object, path: Path) -> Iterator[Problem]:
    if not isinstance(given, SpreadSection):
        return
    if given.low > given.high:
        yield Problem(path, f"low, {exact(given.low)}, must not be above high, {exact(given.high)}")
    elif (given.count is None) == (given.step is None):
        yield Problem(path, "must have either count, how many values, or step between them")
    elif given.step is not None and given.spacing != "linear":
        yield Problem((*path, "step"), f"is for spacing: linear; got {given.spacing}")
    elif given.spacing == "logarithmic" and given.low <= 0.0:
        reason = f"must be above zero for spacing: logarithmic; got {given.low:g}"
        yield Problem((*path, "low"), reason)
    elif given.step is not None and _n_steps(given) > MOST_VALUES:
        reason = f"makes {_n_steps(given)} values; at most {MOST_VALUES} are allowed"
        yield Problem((*path, "step"), reason)


def _check_probes(case: Case) -> Iterator[Problem]:
    domain = case.scene.domain
    for place in case.sweep.probes:
        at = np.array([place])
        inside = all(np.array(domain.lower) <= place) and all(place <= np.array(domain.upper))
        if not inside or (domain.has_walls and not domain.wall_distance(at)[0] > 0.0):
            reason = f"({place[0]:g}, {place[1]:g}) m is not in the fluid"
            yield Problem(("sweep", "probes"), reason)


def _check_points(case: Case) -> Iterator[Problem]:
    model, points = sweep_model(case), sweep_points(case)
    for label in repeated(point.label for point in points):
        yield Problem(_VALUES, f"{label} stands more than once")
    for point in points:
        if (reason := impossible(REYNOLDS, point.reynolds)) is not None:
            yield Problem(("sweep",), f"{point.label}: reynolds {reason}")
            return
    if model is None:
        yield from _check_full(case, points)
    elif model.basis == LOCAL:
        for point in points:
            if (reason := basis_problem(case, model, point)) is not None:
                yield Problem(_VALUES, reason)
                return


def _check_full(case: Case, points: tuple[ParameterPoint, ...]) -> Iterator[Problem]:
    """Check that the case's time step, which all its runs have, is small enough for full runs."""
    if not points:
        return
    step = step_plan(case).time_step
    thickest = min(points, key=lambda point: point.reynolds)
    limit = viscous_limit_at(case, case.kinematic_viscosity(thickest))
    if step > limit * (1.0 + WHOLE_STEPS_TOLERANCE):
        yield Problem(
            _VALUES,
            f"{thickest.label} is stable with steps below {limit:.4g} s only, and full runs of "
            f"this case take steps of {step:.4g} s: lower time.step, or list {thickest.label} in "
            "parameters.test",
        )


def slow_sweep(case: Case) -> str | None:
    """Return a warning where a sweep makes full runs because the case has no faster model."""
    if case.sweep.model is not None or sweep_model(case) is not None:
        return None
    return (
        "sweep.model: no model of the case is on the reference points, so that every run of the "
        "sweep is a full one; add {name: fast, evaluation: operators} to rom for runs of "
        "milliseconds, or say model: full"
    )


def beyond_training(case: Case) -> str | None:
    """Return which points of a reduced sweep lie outside of the trained range, in words."""
    model = sweep_model(case)
    if model is None:
        return None
    points, trained = sweep_points(case), case.train_points
    beyond = [point for point in points if outside(point, trained)]
    if not beyond:
        return None
    if len(case.parameter_names) > 1:
        return (
            f"sweep: {len(beyond)} of {len(points)} points, such as {beyond[0].label}, are outside "
            f"of the trained ranges: {model.name} extrapolates there"
        )
    low, high = min(trained).reynolds, max(trained).reynolds
    first, last = min(beyond).label, max(beyond).label
    which = first if first == last else f"from {first} to {last}"
    return (
        f"sweep.reynolds: {len(beyond)} of {len(points)} values ({which}) are outside of the "
        f"trained range, {exact(low)} to {exact(high)}: {model.name} extrapolates there"
    )
