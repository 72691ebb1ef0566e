"""Parts of models from operators that artifacts hold, the steps that a case asks for, and
measurements in states of the models, from the coordinates alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, read_record
from sphrom.case.models import Case
from sphrom.case.plan import MAX_STEPS
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import AUTO, ReducedModelSection
from sphrom.errors import CaseError
from sphrom.metrics.measures import Quantities
from sphrom.reduction import reference_model
from sphrom.reduction.calibration import Calibration
from sphrom.reduction.reduced_measures import ReducedForce, ReducedMeasure
from sphrom.reduction.reduced_operators import MemoryOperators, ReducedOperators
from sphrom.reduction.reference_model import ReferenceModel, Steps
from sphrom.reduction.trial_basis import (
    TrialBasis,
    kept_modes,
    mean_density_fluctuation,
    project,
    truncate,
)
from sphrom.setup.reduced_runs import drives
from sphrom.store.bases import read_basis
from sphrom.store.measured_quantities import totals
from sphrom.store.starts import Fields
from sphrom.store.trained_operators import (
    read_calibration,
    read_integrated,
    read_measure,
    read_operators,
    read_wall_force,
)
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]


def forces_of(
    case: Case,
    point: ParameterPoint,
    forces: Mapping[str, ReducedForce],
    mean_density_fluctuation: Array | float,
    time: Array,
    coordinates: Array,
) -> dict[str, Array]:
    """Return by measurement the forces and torques (n_snapshots, 2, 3) of states [N/m, N].

    Times are (n_snapshots,) [s], coordinates (n_snapshots, n_modes); the mean that is carried apart
    is (n_snapshots,) or one for all [kg/m3].
    """
    if not forces:
        return {}
    viscosity, (speed, amplitude) = case.kinematic_viscosity(point), drives(case, point, time)
    return {
        name: force.at(coordinates, mean_density_fluctuation, viscosity, speed, amplitude)
        for name, force in forces.items()
    }


def fields_of(
    measures: Mapping[str, ReducedMeasure],
    mean_density_fluctuation: Array | float,
    coordinates: Array,
) -> dict[str, Quantities]:
    """Return by measurement what is measured in the fluid, in states as `forces_of` has them."""
    return {name: m.at(coordinates, mean_density_fluctuation) for name, m in measures.items()}


def quantities_of(
    case: Case, point: ParameterPoint, reduced: ReferenceModel, time: Array, coordinates: Array
) -> dict[str, Quantities]:
    """Return all that a case measures, forces and fields, in coordinates (n_states, n_modes).

    Times are (n_states,) [s]; quantities are (n_states, ...).
    """
    mean = reduced.mean_density_fluctuation
    forces = forces_of(case, point, reduced.forces, mean, time, coordinates)
    found = {name: totals(loads) for name, loads in forces.items()}
    found |= fields_of(reduced.measures, mean, coordinates)
    return {name: found[name] for name in case.scene.measure}


@dataclass
class ModelParts:
    """The parts of a model that all parameter points with the same basis share."""

    section: ReducedModelSection
    """With its number of modes."""
    basis: TrialBasis
    operators: ReducedOperators
    states: Array
    """(n_states, n_modes) around which steps have to be stable."""
    memory: MemoryOperators | None
    """The closure's, of a model that has one."""
    calibration: Calibration | None
    projected: Array | None
    """(n_runs, n_snapshots, n_modes) the training runs, of models that are corrected."""
    forces: Mapping[str, ReducedForce]
    """As they were projected."""
    measures: Mapping[str, ReducedMeasure]
    modes: NDArray[np.int64]
    n_integrated: int
    """How many modes (of each part) are integrated as long as training runs are."""
    _last: tuple[Fields, tuple[Array, float]] | None = None
    """Fields and their state, which are the same for all points where they start alike."""

    def initial_state(self, fields: Fields) -> tuple[Array, float]:
        """Return coordinates (n_modes,) of mapped fields, and the separate mean density."""
        if self._last is None or self._last[0] is not fields:
            mean = float(mean_density_fluctuation(self.basis, fields[0]))
            self._last = fields, (project(self.basis, *fields), mean)
        return self._last[1]


def read_parts(workspace: Workspace, model: ReducedModelSection, name: str) -> ModelParts:
    """Read the parts of a model with a basis, whose number of modes is known."""
    whole = read_basis(workspace, name)
    modes = kept_modes(whole, model.size)
    with workspace.open(workspace.operators()) as artifact:
        artifact.require(f"bases/{name}/acoustic", mode=whole.n_modes)
        operators = read_operators(artifact, name, modes)
        memory = None
        if model.projection == "apg":
            memory = read_record(artifact, MemoryOperators, f"bases/{name}/memory/{model.size}")
        calibration = None
        if model.is_calibrated:
            calibration = read_calibration(
                workspace.case, artifact, name, operators, modes, required=model.calibrated is True
            )
        projected = None
        if workspace.case.is_corrected(model, name):
            projected = artifact.read(f"bases/{name}/training_runs")[..., modes]
        n_integrated = _n_integrated(workspace, model, name, artifact)
        states = artifact.read(f"bases/{name}/states")[:, modes]
        forces = {
            measured: read_wall_force(artifact, name, measured, modes)
            for measured in workspace.case.scene.measured_walls
        }
        measures = {
            measured: read_measure(artifact, name, measured, modes)
            for measured in workspace.case.scene.measured_fields
        }
    basis = truncate(whole, model.size)
    return ModelParts(
        model, basis, operators, states, memory, calibration, projected, forces, measures, modes,
        n_integrated,
    )  # fmt: skip


def _n_integrated(
    workspace: Workspace, model: ReducedModelSection, name: str, artifact: Artifact
) -> int:
    """Return how many modes a model integrates: all, as asked, or as training runs chose."""
    if not workspace.case.is_corrected(model, name):
        return model.size
    if model.integrated_modes != AUTO:
        return model.integrated_modes
    return read_integrated(artifact, name, model.size) if model.is_calibrated else model.size


def steps_of(model: ReducedModelSection, reduced: ReferenceModel, full_steps: int) -> Steps:
    """Return the steps of all modes of a model, as its section asks for them.

    Raises CaseError where they are too many for any run to end.

    Parameters
    ----------
    full_steps : those of the full model from one snapshot to the next.
    """
    output_times = reduced.output_times
    n_intervals = output_times.n_snapshots - 1
    if model.time_step == "fom":
        return reference_model.runge_kutta(reduced, full_steps * n_intervals)
    if model.time_step != "auto":
        n_steps = round(output_times.interval / model.time_step) * n_intervals
        return reference_model.runge_kutta(reduced, n_steps)
    if output_times.duration > MAX_STEPS * reduced.step_limit:
        raise CaseError(
            f"rom: {model.name} is stable with steps of {reduced.step_limit:.3g} s only, which are "
            f"more than {MAX_STEPS:g} in all; choose fewer modes, a shorter memory_length or a "
            "time_step"
        )
    return reference_model.automatic_whole(reduced)
