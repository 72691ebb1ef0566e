"""Errors of the forces on walls over time, of reduced runs and of projected full runs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.compare.rows import best_name
from sphrom.metrics.histories import Errors
from sphrom.online.model_parts import forces_of
from sphrom.plots.tables import columns
from sphrom.reduction.reduced_measures import calibrate_force
from sphrom.reduction.trial_basis import (
    kept_modes,
    mean_density_fluctuation,
    project,
    truncate,
)
from sphrom.setup.places import role_of
from sphrom.store.bases import read_basis
from sphrom.store.measured_quantities import read_forces
from sphrom.store.trained_operators import read_force_records, read_wall_force
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]

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
class ComparedForce:
    """The force on one wall over time."""

    row: ForceRow
    time: Array
    """(n_snapshots,) [s]."""
    loads: Array
    """(n_snapshots, 3) force along x and y [N/m] and torque [N]."""


@dataclass(frozen=True)
class FullForces:
    """The forces of a full run, that others are compared with."""

    case: Case
    point: ParameterPoint
    time: Array
    parts: dict[str, Array]
    """By measurement, (n_snapshots, 2, 3): pressure and viscous parts of the loads [N/m, N]."""

    @classmethod
    def of(cls, case: Case, point: ParameterPoint, run: Artifact) -> FullForces:
        """Read the forces of a full run."""
        return cls(case, point, run.read("time"), _stored(case, run))

    def compared(
        self, name: str, forces: dict[str, Array], basis: str | None = None, size: int | None = None
    ) -> Iterator[ComparedForce]:
        """Yield the forces of a complete run, and their errors against the full run's."""
        role = "" if basis is None else role_of(self.case, basis, self.point)
        counted = self.time >= self.case.compare.from_time
        for measured, parts in forces.items():
            own, full = parts[counted], self.parts[measured][counted]
            means = dict(zip(MEANS, map(float, own.sum(axis=1).mean(axis=0)), strict=True))
            errors = dict.fromkeys(ERRORS) if basis is None else force_errors(own, full)
            named = {f"force_{error}": value for error, value in errors.items()}
            row = ForceRow(measured, name, self.point.label, size, role, means, named)
            yield ComparedForce(row, self.time, parts.sum(axis=1))


def _stored(case: Case, run: Artifact) -> dict[str, Array]:
    return {measured: read_forces(run, measured) for measured in case.scene.measured_walls}


def run_results(
    full: FullForces, name: str, run: Artifact, basis: str, size: int
) -> Iterator[ComparedForce]:
    """Yield the forces of a reduced run that is complete."""
    yield from full.compared(name, _stored(full.case, run), basis, size)


def best_results(
    workspace: Workspace, full: FullForces, mapped: Artifact, basis: str, size: int
) -> Iterator[ComparedForce]:
    """Yield the forces of the full run's mapped snapshots, projected onto a basis.

    There are none of a basis without projected operators.
    """
    case = workspace.case
    if basis not in case.reference_bases or not full.parts:
        return
    whole = read_basis(workspace, basis)
    modes, kept = kept_modes(whole, size), truncate(whole, size)
    fields = mapped.read("density_fluctuation"), mapped.read("velocity")
    with workspace.open(workspace.operators()) as artifact:
        forces = {
            measured: calibrate_force(
                read_wall_force(artifact, basis, measured, modes),
                read_force_records(case, artifact, basis, measured, modes),
            )
            for measured in full.parts
        }
    mean = mean_density_fluctuation(kept, fields[0])
    found = forces_of(case, full.point, forces, mean, full.time, project(kept, *fields))
    yield from full.compared(best_name(basis, size), found, basis, size)


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
