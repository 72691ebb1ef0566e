"""Projected operators in their artifact, and training runs in generalized coordinates.

Modes are orthonormal, so that the coordinates of fewer modes are the first of those that are kept,
and a model of any size is calibrated when it is built. The closure of Eq. 3.22 is stored by the
number of modes: the residual that it is made of is what projection onto so many modes leaves, and
those of fewer modes are no part of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, read_record
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import AUTO, ReducedModelSection
from sphrom.reduction.calibration import Calibration, TrainingRun, calibrate
from sphrom.reduction.held_out import best_size
from sphrom.reduction.reduced_measures import ForceRecord, ReducedForce, ReducedMeasure
from sphrom.reduction.reduced_operators import ReducedOperators
from sphrom.reduction.trial_basis import TrialBasis, project
from sphrom.setup.assembly import amplitude_of, drives
from sphrom.store.bases import mapped_runs
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]

N_BLOCK_SNAPSHOTS = 16
"""Snapshots that are projected at once."""


def training_runs(workspace: Workspace, basis: TrialBasis, name: str) -> Array:
    """Return all snapshots that a basis learnt from (n_runs, n_snapshots, n_modes), projected."""
    runs = []
    for _, densities, velocities in mapped_runs(workspace, name):
        firsts = range(0, len(densities), N_BLOCK_SNAPSHOTS)
        blocks = [slice(first, first + N_BLOCK_SNAPSHOTS) for first in firsts]
        parts = [project(basis, densities[some], velocities[some]) for some in blocks]
        runs.append(np.concatenate(parts))
    return np.stack(runs)


def calibrated(
    case: Case, points: Sequence[ParameterPoint], operators: ReducedOperators, runs: Array
) -> Calibration:
    """Calibrate operators with training runs (n_runs, n_snapshots, n_modes) at some points.

    Raises ValueError when they have too few snapshots.
    """
    times, known = snapshot_times(case), []
    for point, coordinates in zip(points, runs, strict=True):
        viscosity, amplitude = case.plan.kinematic_viscosity(point), amplitude_of(case, point)
        rates = operators.at(viscosity, factors=point.factors)
        driven = None if amplitude is None else amplitude(times)
        known.append(TrainingRun(rates, coordinates, viscosity, driven, point.factors))
    interval = case.plan.steps.snapshot_interval
    return calibrate(known, interval, case.plan.longest_sound_period)


def snapshot_times(case: Case) -> Array:
    """Return the times of the snapshots of a case's runs (n_snapshots,) [s]."""
    steps = case.plan.steps
    return steps.start_time + steps.snapshot_interval * np.arange(
        steps.n_snapshots, dtype=np.float64
    )


def read_operators(
    artifact: Artifact, name: str, modes: NDArray[np.int64] | None = None
) -> ReducedOperators:
    """Read the operators of some modes of a basis, of all by default."""
    driven = artifact.number("walls_driven") == 1.0
    whole = read_record(artifact, ReducedOperators, f"bases/{name}", walls_driven=driven)
    return whole if modes is None else whole.of_modes(modes)


def read_wall_force(
    artifact: Artifact, basis: str, name: str, modes: NDArray[np.int64]
) -> ReducedForce:
    """Read the force of a measurement, in the coordinates of some modes of a basis."""
    group = f"bases/{basis}/wall_force/{name}"
    return read_record(artifact, ReducedForce, group).of_modes(modes)


def read_measure(
    artifact: Artifact, basis: str, name: str, modes: NDArray[np.int64]
) -> ReducedMeasure:
    """Read a measurement of fields, in the coordinates of some modes of a basis."""
    return read_record(artifact, ReducedMeasure, f"bases/{basis}/measure/{name}").of_modes(modes)


def read_force_records(
    case: Case, artifact: Artifact, basis: str, name: str, modes: NDArray[np.int64]
) -> list[ForceRecord]:
    """Read what the full runs that a basis learnt from recorded, and their projected states."""
    loads = artifact.read(f"bases/{basis}/wall_force/{name}/training_loads")
    means = artifact.read(f"bases/{basis}/training_means")
    coordinates = artifact.read(f"bases/{basis}/training_runs")[:, :, modes]
    times, records = snapshot_times(case), []
    for run, point in enumerate(case.plan.bases[basis]):
        around = case.plan.kinematic_viscosity(point), *drives(case, point, times), point.factors
        records.append(ForceRecord(loads[run], coordinates[run], means[run], *around))
    return records


def memory_timing(basis: str, n_modes: int) -> str:
    """Return the attribute that says what the memory operators of a size of basis took."""
    return f"timing/memory-{basis}-{n_modes}"


def sized(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint
) -> ReducedModelSection:
    """Return a model with its number of modes at a point, where training runs chose it."""
    return sized_in(workspace, model, workspace.case.plan.basis_for(model, point))


def sized_in(workspace: Workspace, model: ReducedModelSection, name: str) -> ReducedModelSection:
    """Return a model with its number of modes in a basis, where training runs chose it."""
    if model.n_modes != AUTO:
        return model
    with workspace.open(workspace.operators()) as artifact:
        error = artifact.read(f"bases/{name}/held_out/error")
    return model.model_copy(update={"n_modes": best_size(error)})
