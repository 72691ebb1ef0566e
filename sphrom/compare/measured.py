"""Forces, flow rates, probes and lines over time: maps, bases, reduced runs against full runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.compare.rows import best_name
from sphrom.metrics.histories import Errors
from sphrom.metrics.measures import UNITS, Quantities, components, errors_of, mean_square
from sphrom.online.basis_model import fields_of, forces_of
from sphrom.plots.tables import columns
from sphrom.reduction.reduced_measures import calibrate_force
from sphrom.reduction.trial_basis import kept_modes, mean_density_fluctuation, project, truncate
from sphrom.setup.assembly import role_of
from sphrom.setup.particles import MeasuredFields
from sphrom.store.bases import read_basis
from sphrom.store.measured_quantities import read_forces, read_quantities, totals
from sphrom.store.trained_operators import read_force_records, read_measure, read_wall_force
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]

FULL = "full"
"""The full run in a table."""
MEANS = {"mean_x": "N/m", "mean_y": "N/m", "mean_torque": "N"}
ERRORS = (
    "relative_l2", "relative_l2_peak", "x", "y", "pressure", "viscous", "torque_relative_l2",
)  # fmt: skip


@dataclass(frozen=True)
class ForceRow:
    """The force on one wall, over the run; the full run's own has no errors."""

    measured: str
    compared: str
    parameters: str
    n_modes: int | None
    role: str
    """`trained` where the parameter was trained on, else `predicted`."""
    means: dict[str, float] = field(metadata={"columns": MEANS})
    """Of the force [N/m] and the torque [N] over time."""
    errors: Errors = field(metadata=columns(tuple(f"force_{e}" for e in ERRORS), "%"))
    """Root mean square errors over time, relative to the full run's force, or torque: of the
    force, its components, its parts and its torque; `peak` is the error at the worst instant."""


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
class Compared:
    """One measurement of a run over time."""

    measured: str
    compared: str
    time: Array
    """(n_snapshots,) [s]."""
    quantities: Quantities
    rows: list[ForceRow] | list[MeasureRow]


@dataclass(frozen=True)
class Measured:
    """What a run has measured, by the names of the measurements."""

    forces: Mapping[str, Array]
    """(n_snapshots, 2, 3): pressure and viscous parts of force and torque [N/m, N]."""
    fields: Mapping[str, Quantities]

    @classmethod
    def of(cls, case: Case, run: Artifact) -> Measured:
        """Read what a run has measured."""
        return cls(
            {name: read_forces(run, name) for name in case.scene.measured_walls},
            {name: read_quantities(run, name) for name in case.scene.measured_fields},
        )

    @classmethod
    def mapped(cls, case: Case, mapped: Artifact) -> Measured:
        """Measure the fields of mapped snapshots, which tell no forces."""
        measure = MeasuredFields.of(case)
        if measure is None:
            return cls({}, {})
        position = mapped.read("reference_position")
        states = zip(mapped.dataset("density_fluctuation"), mapped.dataset("velocity"), strict=True)
        each = [measure(position, *map(np.asarray, state)) for state in states]
        fields = {
            name: {quantity: np.array([one[name][quantity] for one in each]) for quantity in first}
            for name, first in each[0].items()
        }
        return cls({}, fields)

    @classmethod
    def best(
        cls, workspace: Workspace, point: ParameterPoint, mapped: Artifact, basis: str, size: int
    ) -> Measured:
        """Measure mapped snapshots that are projected onto a basis.

        There is nothing of a basis without projected operators.
        """
        case, scene = workspace.case, workspace.case.scene
        if basis not in case.plan.reference_bases or not scene.measure:
            return cls({}, {})
        whole = read_basis(workspace, basis)
        modes, kept = kept_modes(whole, size), truncate(whole, size)
        with workspace.open(workspace.operators()) as artifact:
            forces = {
                name: calibrate_force(
                    read_wall_force(artifact, basis, name, modes),
                    read_force_records(case, artifact, basis, name, modes),
                )
                for name in scene.measured_walls
            }
            fields = {n: read_measure(artifact, basis, n, modes) for n in scene.measured_fields}
        state = mapped.read("density_fluctuation"), mapped.read("velocity")
        mean, coordinates = mean_density_fluctuation(kept, state[0]), project(kept, *state)
        return cls(
            forces_of(case, point, forces, mean, mapped.read("time"), coordinates),
            fields_of(fields, mean, coordinates),
        )


@dataclass(frozen=True)
class FullMeasured:
    """What a full run has measured, that others are compared with."""

    case: Case
    point: ParameterPoint
    time: Array
    full: Measured

    @classmethod
    def of(cls, case: Case, point: ParameterPoint, run: Artifact) -> FullMeasured:
        """Read what a full run has measured."""
        return cls(case, point, run.read("time"), Measured.of(case, run))

    def compared(
        self, name: str, measured: Measured, basis: str | None = None, size: int | None = None
    ) -> Iterator[Compared]:
        """Yield what a run that ran to the end has measured, and its errors."""
        role = "" if basis is None else role_of(self.case, basis, self.point)
        for each, loads in measured.forces.items():
            row = self._force_row(each, loads, name, role, size)
            yield Compared(each, name, self.time, totals(loads), [row])
        for each, quantities in measured.fields.items():
            rows = [*self._rows(each, quantities, name, role, size)]
            yield Compared(each, name, self.time, quantities, rows)

    def best(
        self, workspace: Workspace, mapped: Artifact, basis: str, size: int
    ) -> Iterator[Compared]:
        """Yield what the nearest states in a basis measure."""
        found = Measured.best(workspace, self.point, mapped, basis, size)
        yield from self.compared(best_name(basis, size), found, basis, size)

    @property
    def _counted(self) -> NDArray[np.bool_]:
        return self.time >= self.case.compare.from_time

    def _force_row(
        self, measured: str, loads: Array, name: str, role: str, size: int | None
    ) -> ForceRow:
        own, full = loads[self._counted], self.full.forces[measured][self._counted]
        means = dict(zip(MEANS, map(float, own.sum(axis=1).mean(axis=0)), strict=True))
        errors = dict.fromkeys(ERRORS) if role == "" else force_errors(own, full)
        named = {f"force_{error}": value for error, value in errors.items()}
        return ForceRow(measured, name, self.point.label, size, role, means, named)

    def _rows(
        self, measured: str, quantities: Quantities, name: str, role: str, size: int | None
    ) -> Iterator[MeasureRow]:
        for quantity, values in quantities.items():
            full = self.full.fields[measured][quantity][self._counted]
            square = mean_square(quantity, full)
            own, others = (components(quantity, v) for v in (values[self._counted], full))
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


def force_errors(parts: Array, reference: Array) -> dict[str, float | None]:
    """Return the errors (%) of a force (n_snapshots, 2, 3) by name; None where there is none."""
    wrong, total = parts - reference, reference.sum(axis=1)
    scale, torque_scale = _size(total[:, :2]), _size(total[:, 2:])
    error = wrong.sum(axis=1)
    found = {
        "relative_l2": _size(error[:, :2]),
        "relative_l2_peak": float(np.hypot(*error[:, :2].T).max()),
        "x": _size(error[:, :1]),
        "y": _size(error[:, 1:2]),
        "pressure": _size(wrong[:, 0, :2]),
        "viscous": _size(wrong[:, 1, :2]),
    }
    shares = {name: _share(value, scale) for name, value in found.items()}
    return {**shares, "torque_relative_l2": _share(_size(error[:, 2:]), torque_scale)}


def _size(vectors: Array) -> float:
    """Return the root mean square of vectors (n_snapshots, n_components) over time."""
    return math.sqrt(float(np.mean(np.sum(vectors**2, axis=1))))


def _share(error: float, scale: float) -> float | None:
    return 100.0 * error / scale if scale > 0.0 else None
