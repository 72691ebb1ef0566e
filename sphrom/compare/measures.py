"""Flow rates, probes and lines over time: maps, bases and reduced runs against full runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.compare.rows import best_name
from sphrom.metrics.measures import UNITS, Quantities, components, errors_of, mean_square
from sphrom.online.model_parts import fields_of
from sphrom.reduction.trial_basis import kept_modes, mean_density_fluctuation, project, truncate
from sphrom.setup.measured_fields import MeasuredFields
from sphrom.setup.places import role_of
from sphrom.store.bases import read_basis
from sphrom.store.measured_quantities import read_quantities
from sphrom.store.trained_operators import read_measure
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]


FULL = "full"
"""The full run in a table."""


@dataclass(frozen=True)
class MeasureRow:
    """One component of a measured quantity over the run; the full run's own has no errors."""

    measured: str
    quantity: str
    """`flow_rate`, `u`, `v` or `pressure`."""
    unit: str
    compared: str
    parameters: str
    n_modes: int | None
    role: str
    """`trained` where the parameter was trained on, else `predicted`."""
    mean: float
    """Over time, and along a line; least and greatest likewise."""
    least: float
    greatest: float
    relative_l2: float | None = field(metadata={"unit": "%"})
    """Root mean square error over time and places, over that of the full run's whole quantity: of
    both components for a velocity."""
    relative_l2_peak: float | None = field(metadata={"unit": "%"})
    """At the worst instant."""


@dataclass(frozen=True)
class ComparedMeasure:
    """One measurement of a run over time."""

    measured: str
    compared: str
    time: Array
    """(n_snapshots,) [s]."""
    quantities: Quantities
    rows: list[MeasureRow]


@dataclass(frozen=True)
class FullMeasures:
    """What a full run has measured in the fluid, that others are compared with."""

    case: Case
    point: ParameterPoint
    time: Array
    measured: Mapping[str, Quantities]

    @classmethod
    def of(cls, case: Case, point: ParameterPoint, run: Artifact) -> FullMeasures:
        """Read what a full run has measured."""
        return cls(case, point, run.read("time"), stored(case, run))

    def compared(
        self,
        name: str,
        measured: Mapping[str, Quantities],
        basis: str | None = None,
        size: int | None = None,
    ) -> Iterator[ComparedMeasure]:
        """Yield what a run that ran to the end has measured, beside the full run's."""
        role = "" if basis is None else role_of(self.case, basis, self.point)
        for each, quantities in measured.items():
            rows = [*self._rows(each, quantities, name, role, size)]
            yield ComparedMeasure(each, name, self.time, quantities, rows)

    def _rows(
        self, measured: str, quantities: Quantities, name: str, role: str, size: int | None
    ) -> Iterator[MeasureRow]:
        counted = self.time >= self.case.compare.from_time
        for quantity, values in quantities.items():
            full = self.measured[measured][quantity][counted]
            square = mean_square(quantity, full)
            own, others = (components(quantity, v) for v in (values[counted], full))
            for component, found in own.items():
                errors: tuple[float | None, float | None] = (None, None)
                if name != FULL:
                    errors = errors_of(component, found, others[component], square)
                yield MeasureRow(
                    measured=measured,
                    quantity=component,
                    unit=UNITS[quantity],
                    compared=name,
                    parameters=self.point.label,
                    n_modes=size,
                    role=role,
                    mean=float(found.mean()),
                    least=float(found.min()),
                    greatest=float(found.max()),
                    relative_l2=errors[0],
                    relative_l2_peak=errors[1],
                )


def stored(case: Case, run: Artifact) -> dict[str, Quantities]:
    """Return what a run has measured in the fluid."""
    return {name: read_quantities(run, name) for name in case.scene.measured_fields}


def run_measures(
    full: FullMeasures, name: str, run: Artifact, basis: str, size: int
) -> Iterator[ComparedMeasure]:
    """Yield what a reduced run that is complete has measured."""
    yield from full.compared(name, stored(full.case, run), basis, size)


def map_measures(full: FullMeasures, mapped: Artifact) -> Iterator[ComparedMeasure]:
    """Yield what is measured in the full run's mapped snapshots."""
    fields = MeasuredFields.of(full.case)
    if fields is None:
        return
    position = mapped.read("reference_position")
    states = zip(mapped.dataset("density_fluctuation"), mapped.dataset("velocity"), strict=True)
    each = [fields(position, *map(np.asarray, state)) for state in states]
    found = {
        name: {quantity: np.array([one[name][quantity] for one in each]) for quantity in first}
        for name, first in each[0].items()
    }
    yield from full.compared("map", found)


def best_measures(
    workspace: Workspace, full: FullMeasures, mapped: Artifact, basis: str, size: int
) -> Iterator[ComparedMeasure]:
    """Yield what is measured in the full run's mapped snapshots, projected onto a basis.

    There is nothing of a basis without projected operators.
    """
    if basis not in workspace.case.reference_bases or not full.measured:
        return
    whole = read_basis(workspace, basis)
    modes, kept = kept_modes(whole, size), truncate(whole, size)
    state = mapped.read("density_fluctuation"), mapped.read("velocity")
    with workspace.open(workspace.operators()) as artifact:
        measures = {
            measured: read_measure(artifact, basis, measured, modes) for measured in full.measured
        }
    mean = mean_density_fluctuation(kept, state[0])
    found = fields_of(measures, mean, project(kept, *state))
    yield from full.compared(best_name(basis, size), found, basis, size)
