"""The region, the model and the points of a case's training, and checks of its section."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from sphrom.case.messages import nearest
from sphrom.case.models import Case
from sphrom.case.parameters import TrainValues
from sphrom.case.plan import ends_with_case, step_plan
from sphrom.case.points import REYNOLDS, ParameterPoint, impossible
from sphrom.case.sections import ReducedModelSection
from sphrom.case.yaml_reader import Problem
from sphrom.reduction.greedy import MOST_CORNERED, candidate_places, first_corners
from sphrom.text import exact

Array = NDArray[np.float64]

DIGITS = 4
"""Of the values of candidates: they name files."""


def training_model(case: Case) -> ReducedModelSection | None:
    """Return the model that a case's training is for, None where there is none."""
    name = case.training.model
    found = (m for m in case.rom if m.from_operators and name in (None, m.name))
    return next(found, None)


def check_training(case: Case) -> Iterator[Problem]:
    """Check the region, where there is one, and its model."""
    ranges = case.training.ranges
    known = case.own_values
    for name, (low, high) in ranges.items():
        if name not in known:
            reason = f"the case has no such parameter or key; {nearest(name, known)}"
            yield Problem(("training", name), reason)
        elif not low < high:
            reason = f"must go from the lower to the higher value; got {exact(low)}, {exact(high)}"
            yield Problem(("training", name), reason)
        elif (problem := impossible(name, low)) is not None:
            yield Problem(("training", name), problem)
    for name in case.parameter_names if ranges else ():
        if name in ranges:
            continue
        if name != REYNOLDS:
            reason = f"{name} varies in parameters: give its range too, or leave it out there"
            yield Problem(("training",), reason)
        elif len({point.reynolds for point in case.train_points}) > 1:
            reason = "give a range of reynolds, as parameters.train has several"
            yield Problem(("training",), reason)
    if case.training.model is not None or ranges:
        yield from _check_model(case)


def _check_model(case: Case) -> Iterator[Problem]:
    name, fast = case.training.model, [m.name for m in case.rom if m.from_operators]
    if name is not None and name not in fast:
        known = nearest(name, fast) if fast else "there is none"
        reason = f"no model with evaluation: operators has the name {name}; {known}"
        yield Problem(("training", "model"), reason)
        return
    model = training_model(case)
    if model is None:
        reason = "is for models with evaluation: operators, and rom has none"
        yield Problem(("training",), reason)
    elif not ends_with_case(case, model):
        reason = f"{model.name} has runs that end at another time than full runs: leave out until"
        yield Problem(("training", "model"), reason)
    elif case.operators.error_estimate is False:
        reason = "false leaves training nothing to go by: leave it out, or set true"
        yield Problem(("operators", "error_estimate"), reason)


class Region:
    """The box of a case's training, as the unit cube: of Reynolds numbers the logarithm counts."""

    def __init__(self, case: Case) -> None:
        section = case.training
        self._case = case
        self._names = tuple(section.ranges)
        self._bounds = np.array([self._scaled(n, r) for n, r in section.ranges.items()])
        self._fixed = {} if REYNOLDS in self._names else {REYNOLDS: case.train_points[0].reynolds}

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
        section = self._case.training
        places = candidate_places(section.candidates, len(self._names), section.seed)
        return list(dict.fromkeys(map(self.point, places)))

    def starts(self, known: Sequence[ParameterPoint]) -> list[ParameterPoint]:
        """Return the points that training starts from: known ones, and corners.

        So many corners that no further point of the region changes the steps of full runs, or the
        speed of sound.
        """
        corners = [self.point(place) for place in first_corners(len(self._names))]
        found = list(dict.fromkeys((*known, *corners)))
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
    return step_plan(case), case.sound_speed


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
