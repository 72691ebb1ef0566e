"""What a run of a reduced model gave."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from sphrom.arrays import Array
from sphrom.case.models import Case
from sphrom.errors import CaseError
from sphrom.metrics.measures import COMPONENTS, UNITS, Quantities
from sphrom.online.error_estimates import ErrorEstimate
from sphrom.online.sensitivities import Tangents
from sphrom.setup.assembly import field_measures
from sphrom.signals import guarded
from sphrom.store.sampling import Samples

if TYPE_CHECKING:
    import xarray

Variable = tuple[object, ...]
"""Axes, values and attributes."""


def labelled(dims: str, values: Array, units: str, meaning: str) -> Variable:
    """Return a variable as xarray takes it; `dims` has spaces between axes."""
    return dims.split(), values, {"units": units, "long_name": meaning}


def labelled_measures(
    case: Case, measured: Mapping[str, Quantities], time: Array, attributes: Mapping[str, Any]
) -> xarray.Dataset:
    """Return what a case measures at times (n_snapshots,) [s], by name and quantity."""
    import xarray

    variables = {}
    for name, quantities in measured.items():
        for quantity, values in quantities.items():
            vector = " component" if quantity in COMPONENTS else ""
            places = f" {name}_place" if values.ndim == 2 + bool(vector) else ""
            axes, meaning = f"snapshot{places}{vector}", f"{quantity} of {name}"
            variables[f"{name}_{quantity}"] = labelled(axes, values, UNITS[quantity], meaning)
    coordinates = {"time": labelled("snapshot", time, "s", "time of each snapshot")}
    for name, measure in field_measures(case).items():
        if measure.normal is None:
            coordinates[f"{name}_position"] = labelled(
                f"{name}_place component", measure.position, "m", f"places of {name}"
            )
    return xarray.Dataset(variables, coordinates, dict(attributes)).set_xindex("time")


@dataclass(frozen=True, repr=False, kw_only=True)
class Result:
    """A run of a reduced model; made by `Model.run`."""

    model: str
    """Name of the model."""
    parameters: dict[str, float]
    """Values of the run's parameters."""
    time: Array
    """(n_snapshots,) [s]."""
    coordinates: Array
    """(n_snapshots, n_modes) generalized coordinates, in units of the basis's inner product."""
    correction: Array | None = None
    """(n_snapshots, n_modes) the part of the coordinates that is added because training runs differ
    from the model's own; None of a model without. The rest is what its rates integrate to."""
    time_step: float
    """[s]."""
    error_estimate: ErrorEstimate | None = None
    """None where the case wants none, and for models that are evaluated otherwise than by
    operators."""
    _case: Case
    _sample: Callable[[Array], Samples]
    _measured: Mapping[str, Quantities]

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value:g}" for name, value in self.parameters.items())
        return f"Result({self.model!r}, {values}, {len(self.time)} snapshots)"

    @property
    def measures(self) -> xarray.Dataset:
        """What the case measures, over time.

        Variables are called by the measurement and the quantity: `drag_force` (snapshot, component)
        [N/m] and `drag_torque` (snapshot) [N], `flux_flow_rate` (snapshot) [m2/s], and of places
        `wake_velocity` (snapshot, wake_place, component) [m/s] and `wake_pressure` (snapshot,
        wake_place) [Pa], with their `wake_position` (wake_place, component) [m].
        """
        attributes = {"model": self.model, **self.parameters}
        return labelled_measures(self._case, self._measured, self.time, attributes)

    @guarded()
    def fields(self, points: ArrayLike) -> xarray.Dataset:
        """Return velocity and pressure over time at points of the fluid.

        Parameters
        ----------
        points : (n_points, 2) positions [m]. Along periodic axes they may be outside of the box.

        Returns
        -------
        A dataset of `velocity` (snapshot, point, component) [m/s] and `pressure` (snapshot, point)
        [Pa], with the coordinates `time` (snapshot) [s] and `position` (point, component) [m].

        Raises
        ------
        CaseError
            When points have another shape, or one is not in the fluid.
        ArtifactError
            When artifacts that the run was made from have changed since.
        """
        position = fluid_positions(self._case, points)
        samples = self._sample(self._case.scene.domain.wrap(position))
        attributes = {"model": self.model, **self.parameters}
        return _labelled_fields(self.time, position, samples.velocity, samples.pressure, attributes)


def fluid_positions(case: Case, points: ArrayLike) -> Array:
    """Return points of the fluid (n_points, 2) [m]; raise CaseError where they are none."""
    position, domain = finite_array(points, "points"), case.scene.domain
    if position.ndim != 2 or position.shape[1] != 2 or not len(position):
        raise CaseError(f"points: must have the shape (n_points, 2); got {position.shape}")
    for x, y in position[~domain.contains(position)][:1]:
        raise CaseError(f"points: ({x:g}, {y:g}) m is not in the fluid")
    return position


def finite_array(given: ArrayLike, name: str) -> Array:
    """Return a copy as an array of finite numbers; raise CaseError for anything else."""
    try:
        values = np.array(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CaseError(f"{name}: must be numbers; {error}") from error
    if not np.isfinite(values).all():
        raise CaseError(f"{name}: must be finite")
    return values


def _labelled_fields(
    time: Array,
    position: Array,
    velocity: Array,
    pressure: Array,
    attributes: Mapping[str, Any],
    parameters: Sequence[str] = (),
) -> xarray.Dataset:
    """Return velocity and pressure at points over time, or their derivatives by parameters."""
    import xarray

    axes = "parameter snapshot point" if parameters else "snapshot point"
    per = " per unit" if parameters else ""
    variables = {
        "velocity": labelled(f"{axes} component", velocity, f"m/s{per}", "velocity"),
        "pressure": labelled(axes, pressure, f"Pa{per}", "pressure"),
    }
    coordinates: dict[str, Variable] = {
        "time": labelled("snapshot", time, "s", "time of each snapshot"),
        "position": labelled("point component", position, "m", "position of each point"),
    }
    if parameters:
        coordinates["parameter"] = ("parameter", list(parameters))
    return xarray.Dataset(variables, coordinates, attributes).set_xindex("time")


@dataclass(frozen=True, repr=False, kw_only=True)
class Sensitivities(Tangents):
    """The derivatives of a run; made by `Model.sensitivities`. Each is per unit of a parameter."""

    model: str
    """Name of the model."""
    at: dict[str, float]
    """Values of the run's parameters."""
    _case: Case
    _samples: Callable[[Array], list[Samples]]
    """At points: the run, and for each parameter the run plus its derivative."""

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value:g}" for name, value in self.at.items())
        names = ", ".join(self.parameters)
        return f"Sensitivities({self.model!r}, {values}, by {names}, {len(self.time)} snapshots)"

    @guarded()
    def fields(self, points: ArrayLike) -> xarray.Dataset:
        """Return the derivatives of velocity and pressure over time at points of the fluid.

        Parameters, errors and result are those of `Result.fields`, with a first axis `parameter`.
        """
        position = fluid_positions(self._case, points)
        own, *moved = self._samples(self._case.scene.domain.wrap(position))
        return _labelled_fields(
            self.time,
            position,
            np.stack([each.velocity - own.velocity for each in moved]),
            np.stack([each.pressure - own.pressure for each in moved]),
            {"model": self.model, **self.at},
            self.parameters,
        )
