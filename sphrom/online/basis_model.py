"""A model from operators with one basis: equations, starts, and corrections by training runs.

Everything that is independent of the parameter point is read and computed once, for all points.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact, read_record
from sphrom.case.models import Case
from sphrom.case.plan import MAX_STEPS
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import AUTO, ReducedModelSection
from sphrom.errors import CaseError
from sphrom.metrics.measures import Quantities, Samples, with_coefficients
from sphrom.metrics.series import smoothed
from sphrom.online.error_estimates import TrainedErrors
from sphrom.reduction import reference_model
from sphrom.reduction.calibration import Calibration, CycleClosure, Harmonics, harmonics_of
from sphrom.reduction.correction import Correction, learn_correction
from sphrom.reduction.error_calibration import OutputErrors, output_errors
from sphrom.reduction.exponential_steps import LinearPart
from sphrom.reduction.held_out import FieldProducts
from sphrom.reduction.polynomial_model import Run
from sphrom.reduction.reduced_measures import PointForce, ReducedMeasure, TimedLoads
from sphrom.reduction.reduced_operators import MemoryOperators
from sphrom.reduction.reference_model import Integrator, ReferenceModel, Steps
from sphrom.reduction.trial_basis import mean_density_fluctuation, project, truncate
from sphrom.setup.assembly import (
    amplitude_of,
    memory_length_of,
    output_times_of,
    scaled_parameters,
    sound_averages,
)
from sphrom.store.trained_models import (
    Fields,
    calibrated,
    cycle_closure,
    read_basis,
    read_operators,
    read_recorded,
    read_wall_force,
    sized_in,
    snapshot_times,
)
from sphrom.store.trajectory import totals
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from sphrom.reduction.mode_splines import ModeSplines

Start = Callable[[ParameterPoint], Fields]
"""The fields on the reference points at the start of a run at a parameter point."""


class BasisModel:
    """A model with one basis, at any parameter point.

    Attributes
    ----------
    section : the model in the case, with its number of modes.
    basis : the model's modes.
    places : (n_points, n_parameters) of the training points, as `scaled_parameters` gives them.
    modes : (n_modes,) indices of the model's modes among all modes of the basis.
    states : (n_states, n_modes) training states, around which steps must be stable.
    n_integrated : number of modes that are integrated within the trained time.
    """

    def __init__(
        self, workspace: Workspace, section: ReducedModelSection, name: str, start: Start
    ) -> None:
        case, section = workspace.case, sized_in(workspace, section, name)
        self.workspace, self.section, self.name = workspace, section, name
        self.points = case.plan.bases[name]
        self.places = scaled_parameters(case, self.points)
        self._start = start
        self._last: tuple[Fields, tuple[Array, float]] | None = None
        whole = read_basis(workspace, name)
        self.basis, self.modes = truncate(whole, section.size), np.arange(section.size)
        self._n_all_modes = whole.n_modes
        self._steps = {True: case.plan.steps, False: case.plan.model_steps(section)}
        group, is_corrected = f"bases/{name}", case.plan.is_corrected(section, name)
        self._calibration: Calibration | CycleClosure | None = None
        self._memory: MemoryOperators | None = None
        self._projected: Array | None = None
        with workspace.open(workspace.operators()) as artifact:
            self.operators = read_operators(artifact, name).of_modes(self.modes)
            self.states = artifact.read(f"{group}/states")[:, self.modes]
            if section.projection == "apg":
                memory = f"{group}/memory/{section.size}"
                self._memory = read_record(artifact, MemoryOperators, memory)
            if section.is_calibrated or is_corrected:
                runs = artifact.read(f"{group}/training_runs")[..., self.modes]
                self._calibration = self._calibrated_with(runs) if section.is_calibrated else None
                self._projected = runs if is_corrected else None
            self.n_integrated = self._read_integrated(artifact) if is_corrected else section.size
            self._forces = {
                measured: read_wall_force(artifact, name, measured, self.modes)
                for measured in case.scene.measured_walls
            }
            self._measures = {
                each: read_record(artifact, ReducedMeasure, f"{group}/measure/{each}").of_modes(
                    self.modes
                )
                for each in case.scene.measured_fields
            }

    def _calibrated_with(self, runs: Array) -> Calibration | CycleClosure | None:
        """Return the terms added to the rates; None if training runs have too few snapshots.

        Raises CaseError if the case requires a calibration that is impossible.
        """
        fit = cycle_closure if self.section.settles_on_cycles else calibrated
        try:
            return fit(self.workspace.case, self.points, self.operators, runs)
        except ValueError as error:
            if self.section.calibrated == AUTO:
                return None
            raise CaseError(f"rom.calibrated: {error}") from error

    @property
    def leaves_cycles(self) -> bool:
        """Whether states leave the trained limit cycles, on which the model should settle."""
        closure = self._calibration
        return isinstance(closure, CycleClosure) and closure.slowest() >= 1.0

    def _read_integrated(self, artifact: Artifact) -> int:
        """Return the number of modes that a corrected model integrates, given or chosen."""
        if self.section.integrated_modes != AUTO:
            return self.section.integrated_modes
        chosen = f"bases/{self.name}/held_out/integrated"
        if not self.section.is_calibrated or chosen not in artifact:
            return self.section.size
        return int(artifact.read(chosen)[self.section.size - 1])

    @cached_property
    def leading(self) -> BasisModel | None:
        """The model of the modes that are integrated; None if all are."""
        if self.n_integrated == self.basis.n_modes:
            return None
        change = {"n_modes": self.n_integrated, "corrected": False}
        section = self.section.model_copy(update=change)
        return BasisModel(self.workspace, section, self.name, self._start)

    @cached_property
    def splines(self) -> ModeSplines:
        """The splines of the model's modes."""
        from sphrom.store.trained_models import read_modes  # it imports kernels of splines

        return read_modes(self.workspace, self.name, self.section.size)[1]

    def sampled(self, points: Array, time: Array, coordinates: Array, mean: float) -> Samples:
        """Return velocity and pressure at points (n_points, 2) for coordinates (n_times, n_modes).

        `mean` is the separate density fluctuation [kg/m3].
        """
        from sphrom.store.stored_run import expand

        case, means = self.workspace.case, np.full(len(time), mean)
        return expand(case, self.basis, self.splines, points, time, coordinates, means)

    @cached_property
    def trained_errors(self) -> TrainedErrors | None:
        """The fit of error estimates to training runs; None if the case has no estimates."""
        wanted = self.workspace.case.plan.has_error_estimate(self.name)
        return TrainedErrors(self) if wanted else None

    @cached_property
    def products(self) -> FieldProducts:
        """Products of training snapshots with the modes of the model."""
        with self.workspace.open(self.workspace.operators()) as artifact:
            stored = read_record(artifact, FieldProducts, f"bases/{self.name}/estimate")
        return stored.only(self.modes, self._n_all_modes)

    def integrator(self, reduced: ReferenceModel) -> Integrator:
        """Return the time steps of the model as the case sets them; exponential ones by default.

        Raises CaseError if there are too many for any run to finish.
        """
        every = self.workspace.case.snapshots.every
        return reference_model.choose(reduced, lambda part: steps_of(self.section, part, every))

    def at(self, point: ParameterPoint) -> ReferenceModel:
        """Return the model at a point, with its corrections by training runs."""
        model, step = self.projected(point), self._first_step(point)
        leading = model.leading and replace(model.leading, first_step=step)
        return self._corrected(replace(model, first_step=step, leading=leading), point)

    def projected(self, point: ParameterPoint, *, in_training: bool = False) -> ReferenceModel:
        """Return the projected and calibrated model at a point, without correction and forces.

        Exponential steps use the linear part of the model at the nearest training point. With
        `in_training`, the model runs over the times of the training runs.
        """
        linear = self._linear_parts[self._nearest(point)]
        model = self._equations(point, in_training)
        model = replace(model, states=self.states, linear=linear)
        if self.leading is None:
            return model
        leading = self.leading.projected(point, in_training=in_training)
        # Its steps are as accurate as the basis of all modes requires.
        return replace(model, leading=replace(leading, basis=self.basis))

    def _nearest(self, point: ParameterPoint) -> int:
        place = scaled_parameters(self.workspace.case, [point])
        distances = np.linalg.norm(self.places - place, axis=1)
        # Rounded, so that of equally near points every machine takes the first.
        return int(np.round(distances, 9).argmin())

    @cached_property
    def _linear_parts(self) -> list[LinearPart | None]:
        models = [self._equations(point, in_training=True) for point in self.points]
        return [model.around(self.states).linear for model in models]

    def _equations(self, point: ParameterPoint, in_training: bool = False) -> ReferenceModel:
        """Return only the equations and the start of the model."""
        case = self.workspace.case
        viscosity = case.plan.kinematic_viscosity(point)
        fields = self._start(point)
        # Points with the same start share its projection.
        if self._last is None or self._last[0] is not fields:
            left_out = float(mean_density_fluctuation(self.basis, fields[0]))
            self._last = fields, (project(self.basis, *fields), left_out)
        coordinates, mean = self._last[1]
        rates = self.operators.at(viscosity, point.factors)
        model = ReferenceModel(
            polynomial=rates,
            basis=self.basis,
            start=coordinates,
            output_times=output_times_of(case, self._steps[in_training], self.states, point),
            mean_density_fluctuation=mean,
            amplitude=amplitude_of(case, point),
            longest_step=case.plan.longest_step(point),
            measures=self._measures,
        )
        length = closure = None
        if self._memory is not None:
            length = memory_length_of(
                case, self.section, lambda: rates.jacobian(coordinates, model.strongest)
            )
            closure = self._memory.at(viscosity).scaled(length)
        if self._calibration is not None:
            calibration = self._calibration.at(viscosity, point.factors)
            closure = calibration if closure is None else closure.plus(calibration)
        if closure is not None:
            rates = rates.plus(closure)
        return replace(model, polynomial=rates, closure=closure, memory_length=length)

    def _corrected(
        self, model: ReferenceModel, point: ParameterPoint, *, held_out: bool = False
    ) -> ReferenceModel:
        """Return a model with the corrections of its coordinates and forces by training runs.

        A training run that is `held_out` is corrected by the others only.
        """
        case = self.workspace.case
        place, times = scaled_parameters(case, [point])[0], snapshot_times(case)
        added = {
            name: TimedLoads.of(times, each.held_out(place) if held_out else each.at(place))
            for name, each in self.force_corrections.items()
            if each is not None
        }
        forces = self._forces_at(point, added)
        return replace(model, correction=self._added(point, held_out), forces=forces)

    def _forces_at(
        self, point: ParameterPoint, added: Mapping[str, TimedLoads]
    ) -> dict[str, PointForce]:
        viscosity = self.workspace.case.plan.kinematic_viscosity(point)
        around = viscosity, self.operators.walls_driven, point.factors
        forces = {
            name: force.at(*around, added.get(name)) for name, (force, _) in self._forces.items()
        }
        closure = self._calibration
        if not isinstance(closure, CycleClosure):
            return forces
        return {
            name: closure.force_at(force, *self._trained_forces[name], viscosity, point.factors)
            for name, force in forces.items()
        }

    @cached_property
    def _trained_forces(self) -> dict[str, tuple[list[PointForce], list[Harmonics]]]:
        """Forces at training points, and the harmonics of the recorded ones, on limit cycles."""
        case, closure, forces = self.workspace.case, self._calibration, {}
        assert isinstance(closure, CycleClosure)
        times, driven = snapshot_times(case), self.operators.walls_driven
        for name, (force, recorded) in self._forces.items():
            viscosities = map(case.plan.kinematic_viscosity, self.points)
            own = [
                force.at(nu, driven, p.factors)
                for nu, p in zip(viscosities, self.points, strict=True)
            ]
            loads = [
                harmonics_of(times, each.reshape(len(times), -1), cycle.frequency)
                for each, cycle in zip(recorded, closure.cycles, strict=True)
            ]
            forces[name] = own, loads
        return forces

    @cached_property
    def correction(self) -> Correction | None:
        """The correction of the model, or None if it has none."""
        if self._projected is None:
            return None
        coordinates = np.stack([coordinates for _, coordinates in self.trained])
        leading, others = np.split(np.arange(self.basis.n_modes), [self.n_integrated])
        return learn_correction(self.places, self._projected - coordinates, (leading, others))

    def _added(self, point: ParameterPoint, held_out: bool = False) -> Array | None:
        """Return the correction (n_trained_snapshots, n_modes) of coordinates, if there is one."""
        if self.correction is not None:
            place = scaled_parameters(self.workspace.case, [point])[0]
            return self.correction.held_out(place) if held_out else self.correction.at(place)
        if self.leading is None:
            return None
        return np.zeros((self._steps[True].n_snapshots, self.basis.n_modes))

    @cached_property
    def trained(self) -> list[tuple[ReferenceModel, Array]]:
        """The model at the training points, and its integrated coordinates there.

        Coordinates that are not integrated are zero.
        """
        runs = [(reduced, run.coordinates) for reduced, run in self._trained_runs]
        return [(m, run if m.leading is None else m.spread(run)) for m, run in runs]

    @cached_property
    def _trained_runs(self) -> list[tuple[ReferenceModel, Run]]:
        models = [self.projected(point, in_training=True) for point in self.points]
        return [(each, self.integrator(each.leading or each).run()) for each in models]

    def _first_step(self, point: ParameterPoint) -> float | None:
        """Return the automatic step [s] of the nearest training run, if that run is stable.

        At a training point it is exactly the step for which the correction was fitted.
        """
        with suppress(CaseError):
            _, run = self._trained_runs[self._nearest(point)]
            if self.section.time_step == AUTO and math.isnan(run.diverged_at):
                return run.time_step
        return None

    @cached_property
    def held_out(self) -> list[tuple[ReferenceModel, Array]]:
        """The model and its runs at the training points, corrected by the other runs only.

        With its own correction a training run equals the full run, so it would show no error.
        """
        runs = []
        for point, (reduced, run) in zip(self.points, self.trained, strict=True):
            model = self._corrected(reduced, point, held_out=True)
            runs.append((model, run if model.correction is None else run + model.correction))
        return runs

    @cached_property
    def measured_differences(self) -> dict[str, Quantities]:
        """Measurements of the full training runs less those of the `held_out` ones.

        By measurement and quantity (n_runs, n_snapshots, ...); not finite where a run diverged.
        They include sound and particle noise, which the model lacks.
        """
        case = self.workspace.case
        with self.workspace.open(self.workspace.operators()) as artifact:
            recorded = read_recorded(case, artifact, self.name)
        own = [
            quantities_of(case, reduced, reduced.output_times.time, run)
            for reduced, run in self.held_out
        ]
        return {
            name: {q: each - np.stack([one[name][q] for one in own]) for q, each in full.items()}
            for name, full in recorded.items()
        }

    @cached_property
    def output_errors(self) -> dict[str, dict[str, OutputErrors]]:
        """The errors of any run by measurement and quantity, from `measured_differences`."""
        averages = sound_averages(self.workspace.case)
        return {
            name: {q: output_errors(each, self.places, averages) for q, each in quantities.items()}
            for name, quantities in self.measured_differences.items()
        }

    @cached_property
    def force_corrections(self) -> dict[str, Correction | None]:
        """The corrections of forces by training runs; none if there are too many steps there."""
        case, corrections, own = self.workspace.case, dict[str, Correction | None](), []
        if self.section.settles_on_cycles:
            return corrections
        try:
            runs = self.trained if self._forces else []
        except CaseError:
            return corrections
        for point, (reduced, run) in zip(self.points, runs, strict=False):
            added = self._added(point)
            bare = replace(reduced, forces=self._forces_at(point, {}))
            states = run if added is None else run + added
            own.append(forces_of(bare, reduced.output_times.time, states))
        places, weights = self.places, sound_averages(case)
        for name, (_, recorded) in self._forces.items():
            defects = recorded - np.stack([each[name] for each in own])
            defects = defects.reshape(*defects.shape[:2], -1)
            slow = np.stack([smoothed(each, weights) for each in defects])
            # Sound and particle noise may differ from run to run.
            parts = np.concatenate((slow, defects - slow), axis=2)
            each_load = list(np.arange(parts.shape[2])[:, None])
            corrections[name] = learn_correction(places, parts, each_load, worthwhile=math.inf)
            if len(places) == 1 and np.isfinite(defects).all():
                # A single run does not determine the correlation length.
                corrections[name] = Correction(places, parts, np.full(parts.shape[2], np.inf))
        return corrections


def steps_of(section: ReducedModelSection, reduced: ReferenceModel, full_steps: int) -> Steps:
    """Return the time steps of all modes of a model, as its section sets them.

    `full_steps` is the number of the full model's steps between snapshots. Raises CaseError if
    there are too many steps for any run to finish.
    """
    output_times, n_intervals = reduced.output_times, reduced.output_times.n_snapshots - 1
    if section.time_step == "fom":
        return reference_model.runge_kutta(reduced, full_steps * n_intervals)
    if section.time_step != "auto":
        n_steps = round(output_times.interval / section.time_step) * n_intervals
        return reference_model.runge_kutta(reduced, n_steps)
    if reduced.first_step is None and output_times.duration > MAX_STEPS * reduced.step_limit:
        raise CaseError(
            f"rom: {section.name} is stable with steps of {reduced.step_limit:.3g} s only, more "
            f"than {MAX_STEPS:g} in a run; choose fewer modes, a memory_length or a time_step"
        )
    return reference_model.automatic_whole(reduced)


def forces_of(
    reduced: ReferenceModel, time: Array, coordinates: Array, mean: Array | float | None = None
) -> dict[str, Array]:
    """Return the forces and torques (n_states, 2, 3) of states [N/m, N], by measurement.

    Parameters
    ----------
    time : (n_states,) [s].
    coordinates : (n_states, n_modes).
    mean : separate density fluctuation [kg/m3], (n_states,) or one; by default the model's own.
    """
    mean = reduced.mean_density_fluctuation if mean is None else mean
    amplitude = np.zeros(len(time)) if reduced.amplitude is None else reduced.amplitude(time)
    if not reduced.forces:
        return {}
    rates = reduced.polynomial.along(coordinates, amplitude)
    states = time, coordinates, rates, amplitude, mean
    return {name: force.at(*states) for name, force in reduced.forces.items()}


def quantities_of(
    case: Case,
    reduced: ReferenceModel,
    time: Array,
    coordinates: Array,
    mean: Array | float | None = None,
) -> dict[str, Quantities]:
    """Return all measurements (n_states, ...) of a case or model, for states as in `forces_of`."""
    mean = reduced.mean_density_fluctuation if mean is None else mean
    forces = forces_of(reduced, time, coordinates, mean)
    measured = {name: totals(loads) for name, loads in forces.items()}
    measured |= reduced.measured(coordinates, mean)
    ordered = {name: measured[name] for name in (*case.scene.recorded, *measured)}
    return with_coefficients(ordered, case.plan.coefficients)
