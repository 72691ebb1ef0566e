"""What runs on particles measure, of one measurement, without an artifact."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import Quantities
from sphrom.setup import particles
from sphrom.setup.measured_fields import MeasuredFields
from sphrom.sph.functional import Functional
from sphrom.sph.time_loop import Snapshot
from sphrom.store.measures import totals

Array = NDArray[np.float64]
Measuring = Callable[[Snapshot, float], Quantities]
"""From a snapshot and its time [s], what is measured, by quantity."""


@dataclass
class MeasuredStates:
    """The snapshots of one run, measured one after the other."""

    measuring: Measuring | None
    """None where nothing is."""
    _each: list[Quantities] = field(default_factory=list)

    @classmethod
    def of(
        cls, case: Case, point: ParameterPoint, functional: Functional, name: str | None
    ) -> MeasuredStates:
        """Return what measures by a name of the case, or nothing."""
        if name is None:
            return cls(None)
        if name in case.scene.measured_walls:
            return cls(_force(case, point, functional, name))
        return cls(_fields(case, name))

    def add(self, snapshot: Snapshot, time: float) -> None:
        """Measure a snapshot. Raises UnstableError where too few particles are near a place."""
        if self.measuring is not None:
            self._each.append(self.measuring(snapshot, time))

    def over_time(self) -> Quantities:
        """Return all that was measured, by quantity (n_snapshots, ...)."""
        first = self._each[0] if self._each else {}
        return {name: np.array([each[name] for each in self._each]) for name in first}


def _force(
    case: Case, point: ParameterPoint, functional: Functional, name: str
) -> Measuring | None:
    forces = particles.wall_forces(case, point, functional)
    if forces is None:
        return None

    def measure(snapshot: Snapshot, time: float) -> Quantities:
        state = np.vstack((snapshot.position, snapshot.density_fluctuation, snapshot.velocity))
        return {q: values[0] for q, values in totals(forces(state, time)[name][None]).items()}

    return measure


def _fields(case: Case, name: str) -> Measuring | None:
    fields = MeasuredFields.of(case)
    if fields is None:
        return None
    return lambda snapshot, time: fields(
        snapshot.position.T, snapshot.density_fluctuation, snapshot.velocity.T
    )[name]
