"""Forces on walls over time, as the artifacts of runs have them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.sph.wall_forces import TORQUE

Array = NDArray[np.float64]

PARTS = ("pressure", "viscous")


def names_of(measured: Iterable[str]) -> list[str]:
    """Return the datasets that hold the forces of some measurements."""
    return [
        f"force/{name}/{dataset}"
        for name in measured
        for dataset in (*PARTS, *(f"{part}_torque" for part in PARTS))
    ]


def datasets_of(name: str, loads: Array) -> dict[str, Array]:
    """Return what each dataset of a measurement holds, of forces and torques (..., 2, 3)."""
    forces = {f"force/{name}/{p}": loads[..., i, :TORQUE] for i, p in enumerate(PARTS)}
    torques = {f"force/{name}/{p}_torque": loads[..., i, TORQUE] for i, p in enumerate(PARTS)}
    return forces | torques


def write_forces(artifact: ArtifactWriter, name: str, loads: Array) -> None:
    """Write forces and torques (n_snapshots, 2, 3) of a measurement [N/m, N]."""
    for path, values in datasets_of(name, loads).items():
        artifact.write(path, values)


def read_forces(artifact: Artifact, name: str) -> Array:
    """Return the pressure's and the viscous force and torque (n_snapshots, 2, 3) [N/m, N]."""
    parts = [
        np.column_stack(
            (artifact.read(f"force/{name}/{p}"), artifact.read(f"force/{name}/{p}_torque"))
        )
        for p in PARTS
    ]
    return np.stack(parts, axis=1)


def drives(case: Case, point: ParameterPoint, time: Array) -> tuple[Array, Array]:
    """Return the walls' speed over the given one, and the body force's amplitude (n_times,)."""
    flow = case.plan.flow(point)
    if flow.wall_amplitude is None:
        speed = np.ones(len(time))
    else:
        speed = np.array([flow.wall_amplitude(t) for t in time.tolist()])
    if flow.amplitude is None:
        return speed, np.zeros(len(time))
    return speed, np.array([flow.amplitude(t) for t in time.tolist()])
