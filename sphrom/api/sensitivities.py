"""Derivatives of a reduced run by the parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sphrom.api.guard import guarded
from sphrom.api.measures import labelled
from sphrom.api.result import fluid_positions
from sphrom.case.models import Case
from sphrom.online.sensitivities import Tangents
from sphrom.store.sampling import Samples

if TYPE_CHECKING:
    import xarray

Array = NDArray[np.float64]


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
