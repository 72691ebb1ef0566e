"""Models, points and ranges of the studies of a case: figures, trade, sweep, fit and training."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from sphrom.arrays import Array
from sphrom.case.model_sections import LOCAL, ReducedModelSection
from sphrom.case.models import Case
from sphrom.case.points import REYNOLDS, ParameterPoint, TrainValues
from sphrom.case.study_sections import FULL, N_CANDIDATES, OfRuns, percentage
from sphrom.errors import CaseError
from sphrom.reduction.greedy import MOST_CORNERED, candidate_places, first_corners
from sphrom.text import quoted

Ranges = dict[str, tuple[float, float]]
Row = tuple[tuple[ReducedModelSection | None, ...], tuple[ParameterPoint, ...]]
"""The models of a row of panels, None for the full one, and the points at which all have runs."""

DIGITS = 4
"""Digits of the values of candidates, which are part of file names."""


def rows_of(case: Case, figure: OfRuns) -> list[Row]:
    """Return the models of each row, None for the full one, and the points of its panels."""
    models = {model.name: model for model in case.rom}
    rows = []
    for names in figure.runs:
        row = tuple(None if name == FULL else models[name] for name in names)
        runs = [case.plan.points if model is None else case.plan.rom_points(model) for model in row]
        points = tuple(p for p in case.plan.points if all(p in known for known in runs))
        if figure.reynolds is not None:
            points = tuple(p for p in points if p.reynolds in figure.reynolds)
        rows.append((row, points))
    return rows


def changed(case: Case, **sections: Any) -> Case:
    """Return a case with other sections, or with sections whose keys change; unchecked.

    The value of a section is the section itself, or a dict of the keys that change.
    """
    return case.model_copy(
        update={
            name: getattr(case, name).model_copy(update=value) if type(value) is dict else value
            for name, value in sections.items()
        }
    )


def at_resolution(case: Case, resolution: int) -> Case:
    """Return a case with another resolution."""
    return changed(case, discretization={"resolution": resolution})


def fast_section(case: Case, name: str | None = None) -> ReducedModelSection | None:
    """Return the first reduced model with operators, or that with a name; None if there is none."""
    models = (model for model in case.rom if model.from_operators and name in (None, model.name))
    return next(models, None)


def place_of(case: Case, name: str) -> int:
    """Return the index of the reduced model with a name."""
    return [model.name for model in case.rom].index(name)


def sweep_model(case: Case) -> ReducedModelSection | None:
    """Return the reduced model of a case's sweep, None for the full model."""
    name = case.sweep.model
    named = next((model for model in case.rom if model.name == name), None)
    return fast_section(case) if name is None else named


def sweep_name(case: Case) -> str:
    """Return the name of the files of a case's sweep."""
    model = sweep_model(case)
    return case.sweep.name or (FULL if model is None else model.name)


def sweep_points(case: Case) -> tuple[ParameterPoint, ...]:
    """Return the points of a case's sweep, in order; empty if the case has no values for it."""
    section = case.sweep
    grid = case.sweep.grid
    points: Iterable[dict[str, float]] = section.points
    if section.sample is not None:
        points = section.sample.points
    elif grid:
        points = (dict(zip(grid, row, strict=True)) for row in product(*grid.values()))
    return tuple(map(case.plan.point, points))


def require_basis(case: Case, model: ReducedModelSection, point: ParameterPoint) -> None:
    """Raise CaseError unless a model has a basis at a point, and operators if it needs them."""
    basis = case.plan.basis_for(model, point)
    if model.basis == LOCAL and model.from_operators and basis not in case.plan.reference_bases:
        raise CaseError(
            f"{point.label} has the local basis {basis}, which has no operators, because "
            f"no run of {model.name} uses this basis"
        )


def fit_ranges(case: Case, model: ReducedModelSection) -> Ranges:
    """Return the ranges of the free parameters of a fit, by name; others do not vary."""
    entries = _fit_entries(case, model).items()
    return {name: (entry[0], entry[1]) for name, entry in entries if isinstance(entry, tuple)}


def fit_values(case: Case, model: ReducedModelSection) -> dict[str, float]:
    """Return the values of the fixed parameters of a fit, by name."""
    entries = _fit_entries(case, model).items()
    return {name: float(entry) for name, entry in entries if not isinstance(entry, tuple)}


def _fit_entries(case: Case, model: ReducedModelSection) -> dict[str, float | tuple[float, ...]]:
    """Return the range of each free parameter, and the value of each fixed one."""
    trained = trained_ranges(case, model)
    return {k: e if e[0] < e[1] else e[0] for k, e in trained.items()} | case.fit.parameters


def trained_ranges(case: Case, model: ReducedModelSection) -> Ranges:
    """Return the trained range of each parameter, by name."""
    rows = [point.as_dict() for point in case.plan.bases.get(model.basis, case.plan.train_points)]
    names = case.plan.parameter_names
    return {k: (min(row[k] for row in rows), max(row[k] for row in rows)) for k in names}


def percent(value: str | float, option: str) -> float:
    """Return the number of a percentage such as `1%`. Raises CaseError, with the option's name."""
    try:
        return percentage(value)
    except ValueError as error:
        raise CaseError(f"{option}: {error}; got {quoted(value)}") from error


@dataclass(frozen=True)
class Box:
    """Ranges of free parameters, mapped to the unit box, and values of fixed parameters."""

    ranges: Ranges
    fixed: Mapping[str, float]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the free parameters."""
        return tuple(self.ranges)

    def values(self, place: Array) -> dict[str, float]:
        """Return the values of all parameters at a place (n_free,) in the unit box, by name.

        Reynolds numbers are spaced logarithmically, as viscosities are.
        """
        free = {n: self.value(n, x) for n, x in zip(self.names, place.tolist(), strict=True)}
        return {**self.fixed, **free}

    def value(self, name: str, share: float) -> float:
        """Return the value of a free parameter at its coordinate in the unit box."""
        low, high = self.ranges[name]
        if name == REYNOLDS:
            return low * (high / low) ** share
        return low + (high - low) * share

    def share(self, name: str, value: float) -> float:
        """Return the coordinate in the unit box of a free parameter's value."""
        low, high = self.ranges[name]
        if name == REYNOLDS:
            return math.log(value / low) / math.log(high / low)
        return (value - low) / (high - low)

    def slopes(self, place: Array) -> Array:
        """Return the derivatives (n_free,) of the values with respect to their coordinates."""
        values = self.values(place)
        ends = self.ranges.items()
        return np.array(
            [values[n] * math.log(h / low) if n == REYNOLDS else h - low for n, (low, h) in ends]
        )


class Region:
    """The region of a case's training, a box of parameters.

    Attributes
    ----------
    names : names of the parameters of all points, the Reynolds number first.
    """

    def __init__(self, case: Case) -> None:
        self._case = case
        ranges = case.training.ranges
        reynolds = {REYNOLDS: case.plan.train_points[0].reynolds}
        self._box = Box(ranges, {} if REYNOLDS in ranges else reynolds)
        self.names = tuple(dict.fromkeys((REYNOLDS, *ranges)))

    def point(self, place: Array) -> ParameterPoint:
        """Return the point at a place (n_parameters,) in the unit box, rounded to a few digits."""
        values = self._box.values(place)
        for (name, ends), share in zip(self._box.ranges.items(), place, strict=True):
            inside = min(max(float(f"{values[name]:.{DIGITS}g}"), ends[0]), ends[1])
            values[name] = ends[int(share)] if share in (0.0, 1.0) else inside
        others = tuple((name, values[name]) for name in self.names[1:])
        return ParameterPoint(values[REYNOLDS], others)

    def places(self, points: Sequence[ParameterPoint]) -> Array:
        """Return the coordinates of points (n_points, n_parameters), in [0, 1] in the region."""
        ranges = self._box.ranges
        rows = [[self._box.share(n, p.as_dict()[n]) for n in ranges] for p in points]
        return np.array(rows).reshape(len(points), -1)

    def contains(self, point: ParameterPoint) -> bool:
        """Return whether a point lies in the region."""
        values = point.as_dict()
        fixed = {name: (value, value) for name, value in self._box.fixed.items()}
        ends = {**fixed, **self._box.ranges}
        return values.keys() == ends.keys() and all(
            low <= values[name] <= high for name, (low, high) in ends.items()
        )

    def candidates(self) -> list[ParameterPoint]:
        """Return the points at which errors are estimated, each once."""
        places = candidate_places(N_CANDIDATES, len(self._box.ranges), self._case.training.seed)
        return list(dict.fromkeys(map(self.point, places)))

    def starts(self, existing: Sequence[ParameterPoint]) -> list[ParameterPoint]:
        """Return the first points of training: corners of the region, and existing points.

        There are enough corners that no other point of the region changes the speed of sound, the
        strip of an inflow or the time steps of full runs.
        """
        number = len(self._box.ranges)
        corners = [self.point(place) for place in first_corners(number)]
        points = list(dict.fromkeys((*corners, *existing)))
        if number > MOST_CORNERED:
            return points

        def settings(points: Sequence[ParameterPoint]) -> tuple[object, ...]:
            plan = trained_at(self._case, points).plan
            return plan.steps, plan.sound_speed, plan.strip

        all_corners = [self.point(np.array(place)) for place in product((0.0, 1.0), repeat=number)]
        everywhere = settings([*points, *all_corners])
        for corner in all_corners:
            if settings(points) == everywhere:
                break
            points = list(dict.fromkeys((*points, corner)))
        return points


def trained_at(case: Case, points: Sequence[ParameterPoint]) -> Case:
    """Return a case with other training points, unchecked."""
    return changed(case, parameters={"train": values_at(points)})


def values_at(points: Sequence[ParameterPoint]) -> TrainValues:
    """Return the section of parameters that names points."""
    if points[0].others:
        return TrainValues(points=tuple(point.as_dict() for point in points))
    return TrainValues(reynolds=tuple(point.reynolds for point in points))
