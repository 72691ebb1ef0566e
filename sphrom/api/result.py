"""What a run of a reduced model gave."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sphrom.case.models import Case
from sphrom.errors import CaseError
from sphrom.metrics.measures import COMPONENTS, UNITS, Quantities
from sphrom.online.sensitivities import Tangents
from sphrom.setup.assembly import field_measures
from sphrom.signals import guarded
from sphrom.store.sampling import Samples

if TYPE_CHECKING:
    import xarray

Array = NDArray[np.float64]
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

    variables = {
        f"{name}_{quantity}": labelled(
            _dims(name, quantity, values), values, UNITS[quantity], f"{quantity} of {name}"
        )
        for name, quantities in measured.items()
        for quantity, values in quantities.items()
    }
    coordinates = {"time": labelled("snapshot", time, "s", "time of each snapshot")}
    coordinates |= dict(_places(case))
    found = xarray.Dataset(variables, coordinates, dict(attributes))
    return found.set_xindex("time")


def _dims(name: str, quantity: str, values: Array) -> str:
    """Return the axes of a quantity of a measurement."""
    is_vector = quantity in COMPONENTS
    places = f" {name}_place" if values.ndim == 2 + is_vector else ""
    return f"snapshot{places}{' component' if is_vector else ''}"


def _places(case: Case) -> Iterator[tuple[str, Variable]]:
    for name, measure in field_measures(case).items():
        if measure.normal is None:
            dims = f"{name}_place component"
            yield f"{name}_position", labelled(dims, measure.position, "m", f"places of {name}")


@dataclass(frozen=True)
class ErrorEstimate:
    """Estimated errors of a run, without a full run to compare with."""

    velocity: Array
    """(n_snapshots,) root mean square of the velocity's error over the fluid [m/s]."""
    pressure: Array
    """(n_snapshots,) the same of the pressure less its mean [Pa]."""
    velocity_percent: float
    """Of the run, over the root mean square of its velocity [%]."""
    pressure_percent: float
    """Of the run, over the root mean square of its pressure less its mean [%]."""
    extrapolates: bool
    """Whether the run is outside of the trained parameters and times."""


@dataclass(frozen=True, repr=False)
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
    correction: Array | None
    """(n_snapshots, n_modes) the part of the coordinates that is added because training runs differ
    from the model's own; None of a model without. The rest is what its rates integrate to."""
    time_step: float
    """[s]."""
    error_estimate: ErrorEstimate | None
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
        import xarray

        position = fluid_positions(self._case, points)
        samples = self._sample(self._case.scene.domain.wrap(position))
        variables = {
            "velocity": labelled("snapshot point component", samples.velocity, "m/s", "velocity"),
            "pressure": labelled("snapshot point", samples.pressure, "Pa", "pressure"),
        }
        coordinates = {
            "time": labelled("snapshot", samples.time, "s", "time of each snapshot"),
            "position": labelled("point component", position, "m", "position of each point"),
        }
        attributes = {"model": self.model, **self.parameters}
        return xarray.Dataset(variables, coordinates, attributes).set_xindex("time")


def fluid_positions(case: Case, points: ArrayLike) -> Array:
    """Return points of the fluid (n_points, 2) [m]; raise CaseError where they are none."""
    position, domain = _positions(points), case.scene.domain
    for x, y in position[~domain.contains(position)][:1]:
        raise CaseError(f"points: ({x:g}, {y:g}) m is not in the fluid")
    return position


def _positions(points: ArrayLike) -> Array:
    try:
        position = np.array(points, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CaseError(f"points: must be numbers (n_points, 2) [m]; {error}") from error
    if position.ndim != 2 or position.shape[1] != 2 or not len(position):
        raise CaseError(f"points: must have the shape (n_points, 2); got {position.shape}")
    if not np.isfinite(position).all():
        raise CaseError("points: must be finite")
    return position


@dataclass(frozen=True, repr=False)
class Sensitivities:
    """The derivatives of a run; made by `Model.sensitivities`. Each is per unit of a parameter."""

    model: str
    """Name of the model."""
    at: dict[str, float]
    """Values of the run's parameters."""
    parameters: tuple[str, ...]
    """The parameters that the run is differentiated by, along the first axis of what follows."""
    time: Array
    """(n_snapshots,) [s]."""
    coordinates: Array
    """(n_parameters, n_snapshots, n_modes) of the generalized coordinates."""
    kinetic_energy: Array
    """(n_parameters, n_snapshots) [J/m]."""
    forces: Mapping[str, Array]
    """By measurement (n_parameters, n_snapshots, 2, 3): the pressure's and the viscous force along
    x and y [N/m] and torque [N]."""
    measured: Mapping[str, Mapping[str, Array]]
    """By measurement and quantity (n_parameters, n_snapshots, ...): probes, lines, flow rates."""
    _case: Case
    _samples: Callable[[Array], list[Samples]]

    @classmethod
    def of(
        cls,
        found: Tangents,
        model: str,
        at: dict[str, float],
        case: Case,
        samples: Callable[[Array], list[Samples]],
    ) -> Sensitivities:
        """Return what a run's tangents say.

        `samples` gives at points the run, and for each parameter the run plus its derivative.
        """
        return cls(
            model, at, found.names, found.time, found.changes, found.kinetic_energy, found.forces,
            found.measured, case, samples,
        )  # fmt: skip

    def __repr__(self) -> str:
        values = ", ".join(f"{name}={value:g}" for name, value in self.at.items())
        names = ", ".join(self.parameters)
        return f"Sensitivities({self.model!r}, {values}, by {names}, {len(self.time)} snapshots)"

    @guarded()
    def fields(self, points: ArrayLike) -> xarray.Dataset:
        """Return the derivatives of velocity and pressure over time at points of the fluid.

        Parameters, errors and result are those of `Result.fields`, with a first axis `parameter`.
        """
        import xarray

        position = fluid_positions(self._case, points)
        own, *moved = self._samples(self._case.scene.domain.wrap(position))
        velocity = np.stack([each.velocity - own.velocity for each in moved])
        pressure = np.stack([each.pressure - own.pressure for each in moved])
        axes = "parameter snapshot point"
        variables = {
            "velocity": labelled(f"{axes} component", velocity, "m/s per unit", "velocity"),
            "pressure": labelled(axes, pressure, "Pa per unit", "pressure"),
        }
        coordinates = {
            "parameter": ("parameter", list(self.parameters)),
            "time": labelled("snapshot", self.time, "s", "time of each snapshot"),
            "position": labelled("point component", position, "m", "position of each point"),
        }
        attributes = {"model": self.model, **self.at}
        return xarray.Dataset(variables, coordinates, attributes).set_xindex("time")
