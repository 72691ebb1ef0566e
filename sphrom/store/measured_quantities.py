"""Forces and fields that are measured over time, as the artifacts of runs have them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.models import Case
from sphrom.metrics.measures import UNITS, FieldMeasure, Quantities
from sphrom.sph.wall_forces import TORQUE

Array = NDArray[np.float64]

PARTS = ("pressure", "viscous")


def force_datasets(name: str, loads: Array) -> dict[str, Array]:
    """Return by dataset the forces and torques (..., 2, 3) [N/m, N] of a measurement."""
    forces = {f"force/{name}/{p}": loads[..., i, :TORQUE] for i, p in enumerate(PARTS)}
    torques = {f"force/{name}/{p}_torque": loads[..., i, TORQUE] for i, p in enumerate(PARTS)}
    return forces | torques


def read_forces(artifact: Artifact, name: str) -> Array:
    """Return the pressure's and the viscous force and torque (n_snapshots, 2, 3) [N/m, N]."""
    parts = [
        np.column_stack(
            (artifact.read(f"force/{name}/{p}"), artifact.read(f"force/{name}/{p}_torque"))
        )
        for p in PARTS
    ]
    return np.stack(parts, axis=1)


def field_datasets(measured: Mapping[str, Quantities]) -> dict[str, Array]:
    """Return measured fields by dataset."""
    return {
        f"measure/{name}/{quantity}": values
        for name, quantities in measured.items()
        for quantity, values in quantities.items()
    }


def write_positions(artifact: ArtifactWriter, measures: Mapping[str, FieldMeasure]) -> None:
    """Write where fields are measured [m]."""
    for name, measure in measures.items():
        if measure.normal is None:
            artifact.write(f"measure/{name}/position", measure.position)


def read_quantities(artifact: Artifact, name: str) -> Quantities:
    """Return the values of a measurement that a run has, by quantity (n_snapshots, ...)."""
    if f"force/{name}/pressure" in artifact:
        return totals(read_forces(artifact, name))
    paths = {quantity: f"measure/{name}/{quantity}" for quantity in UNITS}
    return {q: artifact.read(path) for q, path in paths.items() if path in artifact}


def totals(loads: Array) -> Quantities:
    """Return force and torque, by quantity, of pressure's and viscous ones (n_snapshots, 2, 3)."""
    total = loads.sum(axis=1)
    return {"force": total[:, :TORQUE], "torque": total[:, TORQUE]}


def measured_of(case: Case, artifact: Artifact) -> dict[str, Quantities]:
    """Return all measurements of a run by name."""
    return {name: read_quantities(artifact, name) for name in case.scene.measure}
