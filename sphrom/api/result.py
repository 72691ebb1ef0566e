"""What a run of a reduced model gave."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sphrom.api.guard import guarded
from sphrom.api.measures import labelled, labelled_measures
from sphrom.case.models import Case
from sphrom.errors import CaseError
from sphrom.metrics.measures import Quantities
from sphrom.store.sampling import Samples

if TYPE_CHECKING:
    import xarray

Array = NDArray[np.float64]


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
