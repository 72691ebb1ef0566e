"""The projected operators, and what estimates of errors need beside them, in their artifact.

The closure of Eq. 3.22 is stored by the number of modes: the residual that it is made of is what
projection onto so many modes leaves, and those of fewer modes are no part of it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, read_record
from sphrom.artifacts.records.operators import (
    DriveForce,
    DriveResidual,
    Estimate,
    MeasuredTerms,
    Memory,
    Rates,
    Residual,
    WallForce,
)
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import AUTO, ReducedModelSection
from sphrom.reduction.error_calibration import FieldProducts
from sphrom.reduction.force_calibration import ForceRecord
from sphrom.reduction.forces import ReducedForce
from sphrom.reduction.held_out import UnheldShares
from sphrom.reduction.measures import ReducedMeasure
from sphrom.reduction.mode_choice import best_size
from sphrom.reduction.polynomial import Polynomial
from sphrom.reduction.reduced_operators import MemoryOperators, ReducedOperators
from sphrom.reduction.residual_norm import ResidualFactor
from sphrom.sph.fluid import Drive
from sphrom.store.calibration import snapshot_times
from sphrom.store.forces import drives
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]

Drives = dict[str, Drive[Array]]
AMPLITUDES = ("steady", "force", "force_squared")
"""Tensors that the amplitude's powers multiply: a body force's or driven walls'."""


def read_operators(artifact: Artifact, name: str, modes: NDArray[np.int64]) -> ReducedOperators:
    """Read the operators of some modes of a basis back."""
    stored = read_record(artifact, Rates, f"bases/{name}")
    drives = {name: Drive(drive.walls, drive.force) for name, drive in stored.drives.items()}
    whole = ReducedOperators(
        inertia=stored.inertia,
        viscosity=stored.viscosity,
        walls=stored.walls,
        force=stored.force,
        acoustic=stored.acoustic,
        order=1,
        walls_driven=_walls_driven(artifact),
        drives=drives,
    )
    return whole.of_modes(modes)


def _drives(stored: Mapping[str, DriveForce] | Mapping[str, DriveResidual]) -> Drives:
    return {name: Drive(drive.walls, drive.force) for name, drive in stored.items()}


def _walls_driven(artifact: Artifact) -> bool:
    return artifact.number("walls_driven") == 1.0


def read_wall_force(
    artifact: Artifact, basis: str, name: str, modes: NDArray[np.int64]
) -> ReducedForce:
    """Read the force of a measurement back, in the coordinates of some modes of a basis."""
    stored = read_record(artifact, WallForce, f"bases/{basis}/wall_force/{name}")
    force = ReducedForce(
        stored.pressure, stored.viscous, stored.walls, stored.body_force, _drives(stored.drives)
    )
    return force.of_modes(modes)


def read_force_records(
    case: Case, artifact: Artifact, basis: str, name: str, modes: NDArray[np.int64]
) -> list[ForceRecord]:
    """Read what the full runs that a basis learnt from recorded, and their projected states."""
    loads = artifact.read(f"bases/{basis}/wall_force/{name}/training_loads")
    means = artifact.read(f"bases/{basis}/training_means")
    coordinates = artifact.read(f"bases/{basis}/training_runs")[:, :, modes]
    times, records = snapshot_times(case), []
    for run, point in enumerate(case.bases[basis]):
        around = case.kinematic_viscosity(point), *drives(case, point, times), point.factors
        records.append(ForceRecord(loads[run], coordinates[run], means[run], *around))
    return records


def read_measure(
    artifact: Artifact, basis: str, name: str, modes: NDArray[np.int64]
) -> ReducedMeasure:
    """Read a measurement of fields back, in the coordinates of some modes of a basis."""
    stored = vars(read_record(artifact, MeasuredTerms, f"bases/{basis}/measure/{name}"))
    given = {quantity: terms for quantity, terms in stored.items() if terms is not None}
    return ReducedMeasure(given).of_modes(modes)


def memory_record(operators: MemoryOperators) -> Memory:
    """Return memory operators as they are stored, the viscosity's power the first axis."""
    by_amplitude = zip(*(p.powers for p in operators.coefficients), strict=True)
    stacked = [tuple(map(np.stack, zip(*powers, strict=True))) for powers in by_amplitude]
    return Memory(**dict(zip(AMPLITUDES, stacked, strict=False)))


def read_memory(artifact: Artifact, name: str, n_modes: int) -> MemoryOperators:
    """Read the memory operators of a size of basis back."""
    stored = read_record(artifact, Memory, f"bases/{name}/memory/{n_modes}")
    powers = [p for p in (stored.steady, stored.force, stored.force_squared) if p is not None]

    def of(viscosity_power: int) -> Polynomial:
        return Polynomial(tuple(tuple(t[viscosity_power] for t in tensors) for tensors in powers))

    return MemoryOperators((of(0), of(1), of(2)))


def memory_timing(basis: str, n_modes: int) -> str:
    """Return the attribute that says what the memory operators of a size of basis took."""
    return f"timing/memory-{basis}-{n_modes}"


def read_factor(artifact: Artifact, name: str) -> ResidualFactor:
    """Read the residual's factor of a basis back."""
    stored = read_record(artifact, Residual, f"bases/{name}/residual")
    parts = vars(stored) | {"drives": _drives(stored.drives)}
    return ResidualFactor(**parts, walls_driven=_walls_driven(artifact))


def read_integrated(artifact: Artifact, name: str, n_modes: int) -> int:
    """Read how many modes a model of some modes integrates; all where nothing tells."""
    if f"bases/{name}/held_out/integrated" not in artifact:
        return n_modes
    return int(artifact.read(f"bases/{name}/held_out/integrated")[n_modes - 1])


def sized(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint
) -> ReducedModelSection:
    """Return a model with its number of modes at a point, where training runs chose it."""
    return sized_in(workspace, model, workspace.case.basis_for(model, point))


def sized_in(workspace: Workspace, model: ReducedModelSection, name: str) -> ReducedModelSection:
    """Return a model with its number of modes in a basis, where training runs chose it."""
    if model.n_modes != AUTO:
        return model
    with workspace.open(workspace.operators()) as artifact:
        error = artifact.read(f"bases/{name}/held_out/error")
    return model.model_copy(update={"n_modes": best_size(error)})


def read_training(artifact: Artifact, name: str) -> tuple[FieldProducts, UnheldShares]:
    """Read what is kept of training snapshots: products with a basis, and what it doesn't hold."""
    stored = read_record(artifact, Estimate, f"bases/{name}/estimate")
    products = FieldProducts(stored.gram, stored.projections, stored.squares)
    return products, UnheldShares(**vars(stored.unheld))
