"""The plan of a case, first part: the parameter points of its full and reduced runs."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.points import REYNOLDS, ParameterPoint, Values, nearest_point, outside
from sphrom.errors import CaseError
from sphrom.reduction.correction import interpolation_weights

if TYPE_CHECKING:
    from sphrom.case.models import Case

STEP = 1e-5
"""Step of differences by a parameter, relative to its size."""
NEAR_ZERO = 0.01
"""Values below this share of the largest trained one are ignored in the size of a parameter."""


class PointsPlan:
    """The parameter points of one case."""

    def __init__(self, case: Case) -> None:
        self._case = case
        self._scene = case.scene
        self._fluid = case.fluid
        self._time = case.time

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """The names of the parameters of all points, the Reynolds number first."""
        section = self._case.parameters
        return tuple(dict.fromkeys((REYNOLDS, *section.train.names, *section.test.names)))

    @cached_property
    def driving(self) -> tuple[str, ...]:
        """The parameters that move walls or scale the body force; operators have a part of each."""
        return self._scene.driving(self.parameter_names[1:])

    @cached_property
    def _scheduling(self) -> tuple[str, ...]:
        return self._scene.scheduling(self.parameter_names[1:])

    def fitted_factors(self, point: ParameterPoint) -> dict[str, float]:
        """Return the values of parameters by name that corrections of rates may depend on.

        Knots of a history only change the amplitude of the driving, which the equations contain.
        """
        return {n: v for n, v in point.others if n not in self._scheduling}

    @cached_property
    def own_values(self) -> dict[str, float]:
        """The scene's own values of parameters, with the Reynolds number if training has one."""
        reynolds = self._case.parameters.train.own_reynolds
        own = {} if reynolds is None else {REYNOLDS: reynolds}
        return own | self._scene.parameters(self._fluid.reference_speed)

    @cached_property
    def usual_values(self) -> dict[str, float]:
        """The values that all training runs have in common; of other parameters, the scene's own.

        Points have these values of all parameters that they do not name.
        """
        rows = [point.as_dict() for point in self.train_points]
        common = {n: v for n, v in rows[0].items() if all(row[n] == v for row in rows)}
        return self.own_values | common

    def point(self, values: Values, usual: Mapping[str, float] | None = None) -> ParameterPoint:
        """Return the point with values by name; missing ones are the `usual_values`.

        Raises CaseError when the Reynolds number is missing, and training runs have several.
        """
        named = values if isinstance(values, dict) else {REYNOLDS: values}
        known = {**(self.usual_values if usual is None else usual), **named}
        if REYNOLDS not in known:
            missing = f"{REYNOLDS}: is missing, and training runs have several values"
            raise CaseError(f"{missing}; give its value, such as {REYNOLDS}=100")
        reynolds, *others = [float(known.get(name, 0.0)) for name in self.parameter_names]
        names = self.parameter_names[1:]
        return ParameterPoint(reynolds, tuple(zip(names, others, strict=True)))

    @cached_property
    def train_points(self) -> tuple[ParameterPoint, ...]:
        """The points of training runs; parameters that they don't name have the scene's values."""
        rows = self._case.parameters.train.values
        return tuple(self.point(row, self.own_values) for row in rows)

    @cached_property
    def test_points(self) -> tuple[ParameterPoint, ...]:
        """The points of test runs, which only check predictions."""
        return tuple(map(self.point, self._case.parameters.test.values))

    @cached_property
    def points(self) -> tuple[ParameterPoint, ...]:
        """All points of full runs."""
        return self.train_points + self.test_points

    def title(self, point: ParameterPoint) -> str:
        """Return the label of a full run in titles, without parameters that all full runs share."""
        rows = [other.as_dict() for other in self.points]
        varying = [n for n in self.parameter_names if any(row[n] != rows[0][n] for row in rows)]
        return point.label_of(varying or self.parameter_names)

    @cached_property
    def _settings(self) -> list[dict[str, float]]:
        """The values of all parameters except the Reynolds number, each combination once."""
        return [dict(others) for others in dict.fromkeys(point.others for point in self.points)]

    @cached_property
    def largest_values(self) -> Array:
        """The largest absolute trained value of each parameter (n_parameters,)."""
        return np.abs(self._trained).max(axis=0)

    def scaled(self, values: Array) -> Array:
        """Return scaled parameters (..., n_parameters), used for distances, in the case's order.

        The Reynolds number enters by its logarithm. The other parameters may be negative, so each
        is divided by its largest trained value.
        """
        sizes = self.largest_values[1:]
        others = values[..., 1:] / np.where(sizes > 0.0, sizes, 1.0)
        return np.concatenate((np.log(values[..., :1]), others), axis=-1)

    @cached_property
    def _trained(self) -> Array:
        """The parameters (n_points, n_parameters) of the training points."""
        return np.array([[*point.as_dict().values()] for point in self.train_points])

    @cached_property
    def _trained_in_corners(self) -> bool:
        """Whether training includes all corners of its ranges, so that its hull is their box."""
        ends = np.stack((self._trained.min(axis=0), self._trained.max(axis=0)), axis=1)
        return {*product(*ends.tolist())} <= {*map(tuple, self._trained.tolist())}

    def beyond_training(self, point: ParameterPoint) -> str | None:
        """Return in words where a point is outside of the training points, else None.

        It is outside of a parameter's range, or of the convex hull of the training points, where
        models estimate their errors by extrapolation.
        """
        if ranges := outside(point, self.train_points):
            listed = " and ".join(f"{each} of {name}" for name, each in ranges.items())
            return f"outside of the trained range, {listed}"
        if self._trained_in_corners:
            return None
        place = self.scaled(np.array([*point.as_dict().values()]))
        if interpolation_weights(self.scaled(self._trained), place)[1] == 0.0:
            return None
        return "outside of the training points, though each value is in its trained range"

    def small_step(self, point: ParameterPoint, name: str) -> float:
        """Return the step of a parameter for differences at a point."""
        largest = float(self.largest_values[self.parameter_names.index(name)])
        return STEP * (max(abs(point.as_dict()[name]), NEAR_ZERO * largest) or 1.0)

    def start_point(self, point: ParameterPoint) -> ParameterPoint:
        """Return the point whose initial state a run has.

        Points of full runs have a spin-up of their own; others use that of the nearest training
        run. Without a spin-up, each point starts from the initial conditions of the scene.
        """
        if self._time.spin_up == 0.0 or point in self.points:
            return point
        return nearest_point(point, self.train_points)

    def rom_points(self, model: ReducedModelSection) -> tuple[ParameterPoint, ...]:
        """Return the points at which a reduced model is run."""
        if not isinstance(model.parameters, str):
            return tuple(map(self.point, model.parameters))
        named = {"all": self.points, "train": self.train_points, "test": self.test_points}
        return named[model.parameters]
