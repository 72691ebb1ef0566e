"""What the studies of a case ask for: models, points and ranges of its figures and its sections
trade, sweep, fit and training."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from sphrom.case.messages import show
from sphrom.case.models import Case
from sphrom.case.points import REYNOLDS, ParameterPoint, TrainValues
from sphrom.case.sections import ReducedModelSection
from sphrom.case.study_sections import FULL, LEAST_PERCENT, MOST_PERCENT, N_CANDIDATES, OfRuns
from sphrom.case.sweep import SpreadSection
from sphrom.errors import CaseError
from sphrom.reduction.greedy import MOST_CORNERED, candidate_places, first_corners

Array = NDArray[np.float64]
Ranges = dict[str, tuple[float, float]]
Row = tuple[tuple[ReducedModelSection | None, ...], tuple[ParameterPoint, ...]]
"""The models of a row of panels, None for the full one, and the points at which all are run."""

DIGITS = 4
"""Of the values of candidates: they name files."""


def rows_of(case: Case, figure: OfRuns) -> list[Row]:
    """Return the models of each row, None for the full one, and the points of its panels."""
    models = {model.name: model for model in case.rom}
    rows = []
    for names in figure.runs:
        row = tuple(None if name == FULL else models[name] for name in names)
        made = [case.plan.points if model is None else case.plan.rom_points(model) for model in row]
        points = tuple(p for p in case.plan.points if all(p in some for some in made))
        if figure.reynolds is not None:
            points = tuple(p for p in points if p.reynolds in figure.reynolds)
        rows.append((row, points))
    return rows


def at_resolution(case: Case, resolution: int) -> Case:
    """Return a case with another resolution."""
    section = case.discretization.model_copy(update={"resolution": resolution})
    return case.model_copy(update={"discretization": section})


def sweep_model(case: Case) -> ReducedModelSection | None:
    """Return the reduced model of a case's sweep, None where it is the full one."""
    name = case.sweep.model
    if name is None:
        return next((model for model in case.rom if model.from_operators), None)
    return next((model for model in case.rom if model.name == name), None)


def sweep_name(case: Case) -> str:
    """Return the name of the files of a case's sweep."""
    model = sweep_model(case)
    return case.sweep.name or (FULL if model is None else model.name)


def sweep_points(case: Case) -> tuple[ParameterPoint, ...]:
    """Return where a case's sweep runs its model, in order; nowhere where no values are given."""
    section = case.sweep
    if section.sample is not None:
        names, rows = tuple(section.sample.entries), iter(section.sample.rows)
    else:
        lists = {
            name: given.values.tolist() if isinstance(given, SpreadSection) else given
            for name, given in section.grid.items()
        }
        names, rows = tuple(lists), product(*lists.values()) if lists else iter(())
    points = section.points or (dict(zip(names, row, strict=True)) for row in rows)
    return tuple(map(case.plan.point, points))


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
    points = case.plan.bases.get(model.basis) or case.plan.train_points
    rows = [point.as_dict() for point in points]
    return {
        name: (min(row[name] for row in rows), max(row[name] for row in rows))
        for name in case.plan.parameter_names
    }


def percent(given: str | float, option: str) -> float:
    """Return a percentage such as `1%`. Raises CaseError, naming the option, for anything else."""
    try:
        value = float(str(given).strip().removesuffix("%"))
    except ValueError:
        value = 0.0
    if not LEAST_PERCENT <= value <= MOST_PERCENT:
        raise CaseError(
            f"{option}: must be a percentage from {LEAST_PERCENT:g}% to {MOST_PERCENT:g}%, such as "
            f"1%; got {show(given)}"
        )
    return value


def training_model(case: Case) -> ReducedModelSection | None:
    """Return the model that a case's training is for, None where there is none."""
    name = case.training.model
    found = (m for m in case.rom if m.from_operators and name in (None, m.name))
    return next(found, None)


class Region:
    """The box of a case's training, as the unit cube: of Reynolds numbers the logarithm counts."""

    def __init__(self, case: Case) -> None:
        section = case.training
        self._case = case
        self._names = tuple(section.ranges)
        self._bounds = np.array([self._scaled(n, r) for n, r in section.ranges.items()])
        self._fixed = (
            {} if REYNOLDS in self._names else {REYNOLDS: case.plan.train_points[0].reynolds}
        )

    @staticmethod
    def _scaled(name: str, values: Sequence[float]) -> Array:
        return np.log(values) if name == REYNOLDS else np.asarray(values, dtype=float)

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters of all points, the Reynolds number first."""
        return tuple(dict.fromkeys((REYNOLDS, *self._names)))

    def point(self, place: Array) -> ParameterPoint:
        """Return the point at a place (n_parameters,) of the unit cube, to a few digits."""
        values = dict(self._fixed)
        for name, share, (low, high) in zip(self._names, place, self._bounds, strict=True):
            ends = self._case.training.ranges[name]
            at = low + (high - low) * share
            inside = float(f"{np.exp(at) if name == REYNOLDS else at:.{DIGITS}g}")
            values[name] = (
                ends[int(share)] if share in (0.0, 1.0) else min(max(inside, ends[0]), ends[1])
            )
        others = tuple((name, values[name]) for name in self.names[1:])
        return ParameterPoint(values[REYNOLDS], others)

    def places(self, points: Sequence[ParameterPoint]) -> Array:
        """Return where points are (n_points, n_parameters), in the unit cube if in the region."""
        rows = [
            [float(self._scaled(name, [point.as_dict()[name]])[0]) for name in self._names]
            for point in points
        ]
        low, high = self._bounds.T
        return (np.array(rows).reshape(len(points), len(self._names)) - low) / (high - low)

    def contains(self, point: ParameterPoint) -> bool:
        """Return whether a point lies in the region."""
        values = point.as_dict()
        if tuple(values) != self.names or any(values[n] != v for n, v in self._fixed.items()):
            return False
        ranges = self._case.training.ranges
        return all(low <= values[name] <= high for name, (low, high) in ranges.items())

    def candidates(self) -> list[ParameterPoint]:
        """Return the points at which errors are estimated, each once."""
        places = candidate_places(N_CANDIDATES, len(self._names), self._case.training.seed)
        return list(dict.fromkeys(map(self.point, places)))

    def starts(self, known: Sequence[ParameterPoint]) -> list[ParameterPoint]:
        """Return the points that training starts from: corners, and known ones.

        So many corners that no further point of the region changes the steps of full runs, or the
        speed of sound.
        """
        corners = [self.point(place) for place in first_corners(len(self._names))]
        found = list(dict.fromkeys((*corners, *known)))
        if len(self._names) > MOST_CORNERED:
            return found
        every = [self.point(np.array(p)) for p in product((0.0, 1.0), repeat=len(self._names))]
        everywhere = _settings(trained_at(self._case, [*found, *every]))
        for corner in every:
            if _settings(trained_at(self._case, found)) == everywhere:
                break
            found = list(dict.fromkeys((*found, corner)))
        return found


def _settings(case: Case) -> tuple[object, float]:
    return case.plan.steps, case.plan.sound_speed


def trained_at(case: Case, points: Sequence[ParameterPoint]) -> Case:
    """Return a case that is trained at some points, not checked."""
    parameters = case.parameters.model_copy(update={"train": train_values(case, points)})
    return case.model_copy(update={"parameters": parameters})


def train_values(case: Case, points: Sequence[ParameterPoint]) -> TrainValues:
    """Return the section `parameters.train` of a case with some points, as short as it can be."""
    if not points[0].others:
        return TrainValues(reynolds=tuple(point.reynolds for point in points))
    listed = tuple(point.as_dict() for point in points)
    # Test points that name no Reynolds number have the first of these.
    own = case.parameters.train.reynolds[:1]
    if own == TrainValues().reynolds:
        return TrainValues(points=listed)
    return TrainValues(points=listed, reynolds=own)
