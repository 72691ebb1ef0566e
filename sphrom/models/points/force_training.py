"""The training of a model's forces on walls: the choice of their pressure, and corrections.

The pressure part of a load follows from the balance of momentum or the joint pressure
(`sphrom.reduction.reduced_measures`). If the model has pressure modes of its own, the sum over the
wall's ghosts with these modes is another candidate. Held-out training runs choose one of them for
each component.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sphrom.arrays import Array, Mask
from sphrom.artifacts.records.reduced_models import WallForce
from sphrom.metrics.series import smoothed
from sphrom.models.points.basis_model import BasisModel
from sphrom.models.points.quantities import forces_of
from sphrom.models.points.stored import snapshot_times
from sphrom.plots.tables import format_figure
from sphrom.reduction.correction import interpolated
from sphrom.reduction.held_out import DIVERGED
from sphrom.reduction.own_pressure import expected_errors
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.reduction.trained_basis import TrainedBasis, TrainedForce
from sphrom.setup.assembly import sound_averages

CLEARLY = 0.7
"""Largest error with separate pressure modes, relative to that without, for which they are used. A
few runs do not tell smaller differences from noise: on a turning disc, 0.9 in held-out runs was 1.4
to 2.9 in other runs. In a channel with a wavy floor it is 0.1 to 0.2 for the torque."""


@dataclass(frozen=True)
class ForceTraining:
    """The training of a model's forces, by its own runs at the training points."""

    model_with: Callable[[TrainedBasis], BasisModel]
    """Returns the model with other training results."""
    models: Sequence[ReferenceModel]
    """The model at each training point, without corrections and forces."""
    coordinates: Array
    """(n_runs, n_snapshots, n_modes) of its runs there."""
    recorded: Mapping[str, WallForce]
    held_out: Mapping[int, Array]
    """Coordinates (n_snapshots, n_pressure_modes) of separate modes in held-out runs, by number."""

    def forces(self, trained: TrainedBasis) -> dict[str, TrainedForce]:
        """Return corrected forces, with separate pressure modes in components that they improve."""
        plain = self._corrected(trained)
        if (own := trained.own_pressure) is None:
            return plain

        def with_own(loads: Mapping[str, Mask], size: int | None = None) -> dict[str, TrainedForce]:
            changed = {}
            for name, force in trained.forces.items():
                modes = self.recorded[name].own
                assert modes is not None
                projected = force.projected.with_own(modes[:, :size], loads[name])
                changed[name] = replace(force, projected=projected)
            return self._corrected(replace(trained, forces=changed))

        candidates = plain, with_own(dict.fromkeys(plain, np.ones(3, dtype=bool)))
        errors = [self._errors(replace(trained, forces=forces)) for forces in candidates]
        both = {name: np.stack([each[name] for each in errors]) for name in plain}
        chosen = {n: chosen_loads(each, trained.places) for n, each in both.items()}
        found = plain | {
            name: force
            for name, force in with_own(chosen, len(own.modes)).items()
            if chosen[name].any()
        }
        return {name: replace(found[name], pressure_errors=both[name]) for name in found}

    def _errors(self, trained: TrainedBasis) -> dict[str, Array]:
        """Return errors (n_runs, 3) of forces and torques in held-out runs, without sound.

        They are relative to the root mean square over all runs, and large where a run diverged.
        """
        model = self.model_with(trained)
        case = model.workspace.case
        times = snapshot_times(case)
        weights = sound_averages(case)
        predicted = {}
        for k, own in self.held_out.items():
            reduced = model.corrected(self.models[k], model.points[k], held_out=True)
            run = _with(self.coordinates[k], reduced.correction)
            predicted[k] = forces_of(reduced, times, run, own=own)
        errors = {}
        for name, force in self.recorded.items():
            loads = force.training_loads.sum(axis=2)
            size = np.sqrt(np.mean(loads**2, axis=(0, 1)))
            errors[name] = np.full((len(loads), 3), DIVERGED)
            for k, found in predicted.items():
                missed = smoothed(found[name].sum(axis=1) - loads[k], weights)
                square = np.mean(missed**2, axis=0)
                errors[name][k] = np.sqrt(square) / np.where(size > 0.0, size, 1.0)
        return errors

    def _corrected(self, trained: TrainedBasis) -> dict[str, TrainedForce]:
        """Return the forces with the corrections by their errors in training runs."""
        model = self.model_with(trained)
        times = snapshot_times(model.workspace.case)
        modelled = []
        for point, reduced, run in zip(model.points, self.models, self.coordinates, strict=True):
            states = _with(run, model.added(point))
            modelled.append(forces_of(model.corrected(reduced, point), times, states))
        weights = sound_averages(model.workspace.case)
        found = {}
        for name, force in trained.forces.items():
            recorded = self.recorded[name].training_loads
            defects = recorded - np.stack([forces[name] for forces in modelled])
            defects = defects.reshape(*defects.shape[:2], -1)
            slow = np.stack([smoothed(defect, weights) for defect in defects])
            # Sound and particle noise may differ from run to run.
            parts = np.concatenate((slow, defects - slow), axis=2)
            each_load = list(np.arange(parts.shape[2])[:, None])
            correction = interpolated(trained.places, parts, each_load)
            found[name] = replace(force, correction=correction)
        return found


def chosen_loads(errors: Array, places: Array) -> Mask:
    """Return whether separate pressure modes are clearly better (3,), from the errors of both.

    `errors` are (2, n_runs, 3), at places (n_runs, n_parameters).
    """
    joint, own = expected_errors(errors, places)
    return np.asarray(own < CLEARLY * joint)


def report_forces(model: BasisModel, basis: str) -> None:
    """Report the errors of measured forces with both pressures, and which one was chosen."""
    trained = model.trained
    rows = []
    for name, force in trained.forces.items():
        if (errors := force.pressure_errors) is None:
            continue
        chosen = chosen_loads(errors, trained.places)
        expected = 100.0 * expected_errors(errors, trained.places)
        third = "torque" if model.workspace.case.scene.domain.n_dim == 2 else "force z"
        for load, component in enumerate(("force x", "force y", third)):
            figures = map(format_figure, expected[:, load])
            rows.append((name, component, *figures, "own pressure" if chosen[load] else "joint"))
    if rows:
        model.workspace.context.report.table(
            f"forces of {model.section.name}, basis {basis}: errors in held-out training runs "
            "with each pressure, without sound",
            ("measured", "component", "joint [%]", "own pressure [%]", "chosen"),
            rows,
        )


def _with(run: Array, added: Array | None) -> Array:
    return run if added is None else run + added
