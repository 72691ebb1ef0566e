"""The training of a model from operators with one basis: records in, a record out.

The model is calibrated with its training runs, repeats them, and learns from its errors there:
the corrections of coordinates and forces, and the fit of error estimates.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sphrom.arrays import Array, Indices
from sphrom.artifacts.records.reduced_models import TrainedModel
from sphrom.case.model_sections import AUTO, ReducedModelSection
from sphrom.errors import CaseError
from sphrom.metrics.measures import Quantities
from sphrom.metrics.quantities import COEFFICIENT
from sphrom.models.points.basis_model import BasisModel, Start
from sphrom.models.points.force_training import ForceTraining, report_forces
from sphrom.models.points.pressures import report_pressure
from sphrom.models.points.quantities import quantities_of
from sphrom.models.points.stored import (
    calibrated,
    cycle_closure,
    mapped_starts,
    read_operators,
    recorded_of,
    report_onset,
    sized,
    snapshot_times,
    stored_starts,
)
from sphrom.models.reference.stored import read_basis
from sphrom.reduction.calibration import Calibration, TrainingRun
from sphrom.reduction.correction import learn_correction
from sphrom.reduction.cycle_fits import harmonics_of
from sphrom.reduction.error_calibration import calibrate_errors, compared_snapshots
from sphrom.reduction.held_out import FieldProducts
from sphrom.reduction.limit_cycles import CycleClosure
from sphrom.reduction.own_pressure import (
    JOINT,
    PressureSpace,
    choose,
    fitted,
)
from sphrom.reduction.polynomial_model import Run
from sphrom.reduction.reduced_measures import ReducedForce, ReducedMeasure
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.reduction.trained_basis import (
    ALL_MODES,
    LEADING,
    CycleLoads,
    Differences,
    HeldOutRuns,
    TrainedBasis,
    TrainedErrors,
    TrainedForce,
    TrainedRates,
)
from sphrom.reduction.trial_basis import truncate
from sphrom.setup.assembly import scaled_parameters
from sphrom.store.workspace import Workspace


def trained_model(
    workspace: Workspace, section: ReducedModelSection, common: Mapping[str, Any]
) -> TrainedModel | None:
    """Return a model trained with all its bases; None if it lacks necessary corrections."""
    starts = stored_starts(workspace)
    start = mapped_starts(workspace, stored=starts).at
    names = workspace.case.plan.bases_for(section)
    models = {name: train(workspace, section, name, start) for name in names}
    if any(model.problem is not None for model in models.values()):
        return None
    for name, model in models.items():
        report_pressure(workspace, section.name, name, model.trained)
        report_forces(model, name)
        report_onset(workspace, section.name, name, model.trained)
    with workspace.open(workspace.basis()) as artifact:
        return TrainedModel(
            bases={name: model.trained for name, model in models.items()},
            modes={name: model.basis for name, model in models.items()},
            volume=artifact.read("volume"),
            reference_position=artifact.read("reference_position"),
            starts=starts,
            **common,
        )


def train(
    workspace: Workspace, section: ReducedModelSection, name: str, start: Start
) -> BasisModel:
    """Return a model trained with one basis.

    Raises CaseError if the case requires a calibration that is impossible.
    """
    section = sized(workspace, section, name)
    model = _Training(workspace, section, name, start).model()
    # Sums over arrays in this order have the bits of a model that is read from its artifact.
    model.trained = model.trained.mapped(np.ascontiguousarray)
    return model


class _Training:
    """The training of one model."""

    def __init__(
        self,
        workspace: Workspace,
        section: ReducedModelSection,
        name: str,
        start: Start,
    ) -> None:
        self.workspace = workspace
        self.section = section
        self.name = name
        self.start = start
        self.case = workspace.case
        self.points = self.case.plan.bases[name]
        self.stored = read_operators(workspace, name)
        self.modes = np.arange(section.size)
        self.times = snapshot_times(self.case)
        whole = read_basis(workspace, name)
        self.n_all_modes = whole.n_modes
        self.basis = truncate(whole, section.size)
        stored = self.stored.pressure
        self.n_columns = self.n_all_modes + (0 if stored is None else len(stored.modes))
        # Pressure modes follow all modes.
        self.with_own = np.append(self.modes, np.arange(self.n_all_modes, self.n_columns))
        self.is_corrected = self.case.plan.is_corrected(section, name)
        self.projected: Array | None = None
        if section.is_calibrated or self.is_corrected:
            assert self.stored.training_runs is not None
            self.projected = self.stored.training_runs[..., self.modes]

    def model(self) -> BasisModel:
        """Return the trained model."""
        rates = {ALL_MODES: self._rates(self.section, self.modes)}
        n_integrated = self._n_integrated()
        if n_integrated < self.section.size:
            change = {"n_modes": n_integrated, "corrected": False}
            section = self.section.model_copy(update=change)
            rates[LEADING] = self._rates(section, self.modes[:n_integrated])
        trained = TrainedBasis(
            places=scaled_parameters(self.case, self.points),
            rates=rates,
            first_step=np.zeros(len(self.points)),
            forces=self._forces(rates[ALL_MODES].closure),
            measures=self._measures(self.modes),
        )
        trained = replace(trained, rates=self._with_linear_parts(trained))
        model = self._with(trained)
        try:
            models, runs = self._repeated(model)
        except CaseError as error:
            # Models without corrections may be stable at other parameters.
            model.problem = error if self.is_corrected else None
            return model
        return self._learnt(trained, models, runs)

    def _with(self, trained: TrainedBasis) -> BasisModel:
        return BasisModel(self.workspace, self.section, self.name, trained, self.basis, self.start)

    def _repeated(self, model: BasisModel) -> tuple[list[ReferenceModel], list[Run]]:
        """Return the model at the training points without corrections, and its runs."""
        models = [model.projected(point, in_training=True) for point in self.points]
        return models, [model.integrator(m.leading or m).run() for m in models]

    def _corrected(
        self, trained: TrainedBasis, models: Sequence[ReferenceModel], runs: Sequence[Run]
    ) -> tuple[TrainedBasis, Array]:
        """Return the model with its correction, and its training runs without that correction."""
        # Coordinates that are not integrated are zero.
        coordinates = np.stack(
            [
                run.coordinates if each.leading is None else each.spread(run.coordinates)
                for each, run in zip(models, runs, strict=True)
            ]
        )
        if not self.is_corrected:
            return trained, coordinates
        assert self.projected is not None
        groups = np.split(self.modes, [self._n_integrated()])
        learnt = learn_correction(trained.places, self.projected - coordinates, tuple(groups))
        return replace(trained, correction=learnt), coordinates

    def _learnt(
        self, trained: TrainedBasis, models: Sequence[ReferenceModel], runs: Sequence[Run]
    ) -> BasisModel:
        """Return the model with the corrections and steps that follow from its own training
        runs."""
        if self.section.time_step == AUTO:
            steps = [0.0 if math.isfinite(run.diverged_at) else run.time_step for run in runs]
            trained = replace(trained, first_step=np.array(steps))
        trained, coordinates = self._corrected(trained, models, runs)
        own: dict[int, Array] = {}
        if self.stored.pressure is not None and not self.section.settles_on_cycles:
            trained, own = self._with_own_pressure(
                trained, models, coordinates, self.stored.pressure
            )
        if not self.section.settles_on_cycles:
            training = ForceTraining(self._with, models, coordinates, self.stored.wall_force, own)
            trained = replace(trained, forces=training.forces(trained))
        if self.case.plan.has_error_estimate(self.name):
            trained = replace(trained, errors=self._errors(trained, models, coordinates))
        return self._with(trained)

    def _n_integrated(self) -> int:
        """Return the number of modes that are integrated, given or chosen."""
        if not self.is_corrected:
            return self.section.size
        if self.section.integrated_modes != AUTO:
            return self.section.integrated_modes
        chosen = self.stored.held_out
        if not self.section.is_calibrated or chosen is None:
            return self.section.size
        return int(chosen.integrated[self.section.size - 1])

    def _rates(self, section: ReducedModelSection, modes: Indices) -> TrainedRates:
        """Return the calibrated rates of some modes; their linear parts are made later."""
        operators = self.stored.rates.of_modes(modes)
        memory, calibration, cycles = None, None, None
        if section.projection == "apg":
            memory = self.stored.memory[str(section.size)]
        if section.is_calibrated:
            assert self.projected is not None
            fit: Callable[..., Calibration | CycleClosure] = calibrated
            if section.settles_on_cycles:
                fit = cycle_closure
            try:
                closure = fit(self.case, self.points, operators, self.projected[..., modes])
            except ValueError as error:
                # Training runs have too few snapshots.
                if section.calibrated != AUTO:
                    raise CaseError(f"rom.calibrated: {error}") from error
            else:
                if isinstance(closure, CycleClosure):
                    cycles = closure.trained
                else:
                    calibration = closure
        return TrainedRates(
            projected=operators,
            walls_driven=int(operators.walls_driven),
            memory=memory,
            calibration=calibration,
            cycles=cycles,
            linear=np.zeros((0, len(modes), len(modes))),
            states=self.stored.states[:, modes],
        )

    def _with_linear_parts(self, trained: TrainedBasis) -> dict[str, TrainedRates]:
        """Return the rates with the linear part of each training run, a Jacobian there."""
        bare = self._with(trained)
        found = {}
        for name, rates in trained.rates.items():
            models = [bare.equations(name, point, in_training=True) for point in self.points]
            parts = [model.around(rates.states).linear for model in models]
            found[name] = replace(rates, linear=np.stack([p.matrix for p in parts if p]))
        return found

    def _forces(self, closure: Calibration | CycleClosure | None) -> dict[str, TrainedForce]:
        """Return the measured forces without correction, and their harmonics on limit cycles."""
        forces = {}
        for measured in self.case.scene.measured_walls:
            force = self.stored.wall_force[measured]
            on_cycles = None
            if isinstance(closure, CycleClosure):
                harmonics = np.stack(
                    [
                        harmonics_of(self.times, e.reshape(len(self.times), -1), cycle.frequency)
                        for e, cycle in zip(
                            force.training_loads, closure.trained.cycles, strict=True
                        )
                    ]
                )
                on_cycles = CycleLoads(real=harmonics.real, imaginary=harmonics.imag)
            forces[measured] = TrainedForce(
                projected=replace(ReducedForce.of(force).of_modes(self.modes), own=None),
                on_cycles=on_cycles,
            )
        return forces

    def _measures(self, modes: Indices) -> dict[str, ReducedMeasure]:
        """Return the measured fields, of some of the modes and pressure modes."""
        return {
            name: ReducedMeasure.of(measure).of_modes(modes)
            for name, measure in self.stored.measure.items()
        }

    def _with_own_pressure(
        self,
        trained: TrainedBasis,
        models: Sequence[ReferenceModel],
        coordinates: Array,
        stored: PressureSpace,
    ) -> tuple[TrainedBasis, dict[int, Array]]:
        """Return the model with the pressure whose expected error is the least.

        Its own modes have coordinates (n_snapshots, n_pressure_modes) in held-out training runs, by
        number of the run.
        """
        space = stored.of_modes(self.modes)
        usable = np.flatnonzero(space.squares.any(axis=1)).tolist()
        runs = self._known(self._with(trained), models, coordinates, usable)
        without = {k: self._without(trained, k, usable) for k in usable}
        predicted = {k: known for k, known in without.items() if k in known and len(known) > 1}
        if len(runs) < 2 or not predicted:
            return trained, {}
        chosen, errors, held_out = choose(space, runs, predicted, trained.places)
        trained = replace(trained, pressure_errors=errors)
        if chosen == JOINT:
            return trained, {}
        base = np.eye(len(space.modes), len(space.gradients))
        own = fitted(space, base, chosen, runs, trained.places)
        pressure = {chosen: replace(own, modes=space.modes)}
        trained = replace(trained, pressure=pressure, measures=self._measures(self.with_own))
        return trained, held_out

    def _without(
        self, trained: TrainedBasis, k: int, usable: Sequence[int]
    ) -> dict[int, TrainingRun]:
        """Return the complete training runs of a model that is fitted to all of them but `k`."""
        others = np.delete(np.arange(len(self.points)), k)
        points = [self.points[j] for j in others]
        rates = {}
        for name, known in trained.rates.items():
            fitted_to = known.calibration
            if fitted_to is not None:
                assert self.projected is not None
                projected = self.projected[others][..., : known.operators.n_modes]
                fitted_to = calibrated(self.case, points, known.operators, projected)
            rates[name] = replace(known, calibration=fitted_to)
        model = self._with(replace(trained, rates=rates))
        try:
            models, runs = self._repeated(model)
        except CaseError:
            return {}
        trained, coordinates = self._corrected(model.trained, models, runs)
        return self._known(self._with(trained), models, coordinates, usable, k)

    def _known(
        self,
        model: BasisModel,
        models: Sequence[ReferenceModel],
        coordinates: Array,
        usable: Sequence[int],
        held_out: int | None = None,
    ) -> dict[int, TrainingRun]:
        """Return complete corrected training runs, one of them corrected by the others only."""
        runs = {}
        for k in usable:
            point = self.points[k]
            found = _with(coordinates[k], model.added(point, held_out=k == held_out))
            if np.isfinite(found).all():
                runs[k] = TrainingRun(
                    models[k].polynomial,
                    found,
                    self.case.plan.kinematic_viscosity(point),
                    models[k].amplitudes(self.times),
                    self.case.plan.fitted_factors(point),
                )
        return runs

    def _errors(
        self, trained: TrainedBasis, models: Sequence[ReferenceModel], coordinates: Array
    ) -> TrainedErrors:
        """Return the data of error estimates, fitted to the errors of training runs."""
        model = self._with(trained)
        whole = self.stored.rates
        factor = self.stored.residual
        estimate = self.stored.estimate
        assert factor is not None
        assert estimate is not None
        used = self.with_own if trained.pressure else self.modes
        products = FieldProducts.of(estimate).only(used, self.n_columns)
        scale = self.case.fluid.reference_density * self.case.plan.sound_speed
        compared = compared_snapshots(self.case.plan.steps.n_snapshots)
        errors = TrainedErrors(
            factor=factor.of_model(whole, self.modes),
            products=products,
            outputs={
                name: shares.mapped(lambda share: share[self.modes[-1:]])
                for name, shares in estimate.outputs.items()
            },
            units=np.array([1.0, scale]),
        )
        # Of velocity, and of the pressure in the modes that the model uses: own ones are the last.
        fields = [0, -1 if trained.pressure else 1]
        held_out, own, residuals, known = [], [], [], []
        for k, (point, reduced) in enumerate(zip(self.points, models, strict=True)):
            corrected = model.corrected(reduced, point, held_out=True)
            run = coordinates[k]
            predicted = _with(run, corrected.correction)
            held_out.append((corrected, predicted))
            own.append(_with(run, model.added(point)))
            residuals.append(model.residual(errors, point, reduced, self.times, predicted))
            states = corrected.with_pressure(self.times, predicted)
            known.append(products.errors(k, states[compared]))
        fitted = calibrate_errors(
            self.times,
            np.stack(own),
            np.stack(residuals),
            np.stack(known),
            compared,
            trained.places,
            estimate.unheld.mapped(lambda shares: shares[..., self.modes[-1], fields]),
        )
        complete = [k for k, (_, run) in enumerate(held_out) if np.isfinite(run).all()]
        if not complete:
            return replace(errors, fitted=fitted)
        runs = HeldOutRuns(
            run=np.array(complete, dtype=np.int64),
            coordinates=np.stack([held_out[k][1] for k in complete]),
            errors=np.stack([known[k] for k in complete]),
        )
        differences = self._differences([held_out[k] for k in complete], complete)
        return replace(errors, fitted=fitted, held_out=runs, differences=differences)

    def _differences(
        self, held_out: Sequence[tuple[ReferenceModel, Array]], complete: Sequence[int]
    ) -> dict[str, Differences]:
        """Return measurements of full training runs minus those of complete held-out ones.

        They include sound and particle noise, which the model lacks.
        """
        own = [quantities_of(self.case, reduced, self.times, run) for reduced, run in held_out]
        found = {}
        for name, full in recorded_of(self.case, self.stored).items():
            quantities: Quantities = {
                q: each[complete] - np.stack([one[name][q] for one in own])
                for q, each in full.items()
                if q != COEFFICIENT
            }
            found[name] = Differences(quantities=quantities)
        return found


def _with(run: Array, added: Array | None) -> Array:
    """Return coordinates with a correction, if there is one."""
    return run if added is None else run + added
