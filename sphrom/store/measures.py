"""What is measured over time, forces and fields alike, as the artifacts of runs have it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.models import Case
from sphrom.metrics.measures import UNITS, FieldMeasure, Quantities
from sphrom.sph.wall_forces import TORQUE
from sphrom.store.forces import read_forces

Array = NDArray[np.float64]


def shapes_of(measures: Mapping[str, FieldMeasure]) -> dict[str, tuple[int, ...]]:
    """Return the shape of one snapshot of each dataset of measured fields."""
    shapes: dict[str, tuple[int, ...]] = {}
    for name, measure in measures.items():
        n_places = len(measure.position)
        zero = measure.of(np.zeros((n_places, 2)), np.zeros(n_places))
        shapes |= {f"measure/{name}/{quantity}": np.shape(v) for quantity, v in zero.items()}
    return shapes


def datasets_of(measured: Mapping[str, Quantities]) -> dict[str, Array]:
    """Return what each dataset of measured fields holds."""
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


def write_measured(
    artifact: ArtifactWriter,
    measures: Mapping[str, FieldMeasure],
    measured: Mapping[str, Quantities],
) -> None:
    """Write measured fields over time, and where they are measured."""
    write_positions(artifact, measures)
    for path, values in datasets_of(measured).items():
        artifact.write(path, values)


def read_quantities(artifact: Artifact, name: str) -> Quantities:
    """Return what a run has of a measurement, by quantity (n_snapshots, ...)."""
    if f"force/{name}/pressure" in artifact:
        return totals(read_forces(artifact, name))
    paths = {quantity: f"measure/{name}/{quantity}" for quantity in UNITS}
    return {q: artifact.read(path) for q, path in paths.items() if path in artifact}


def totals(loads: Array) -> Quantities:
    """Return force and torque, by quantity, of pressure's and viscous ones (n_snapshots, 2, 3)."""
    total = loads.sum(axis=1)
    return {"force": total[:, :TORQUE], "torque": total[:, TORQUE]}


def measured_of(case: Case, artifact: Artifact) -> dict[str, Quantities]:
    """Return all that a run has measured, by the names of the measurements."""
    return {name: read_quantities(artifact, name) for name in case.scene.measure}
