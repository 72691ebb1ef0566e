"""A model from operators with one basis: its equations and starts at any parameter point. Its
record (`sphrom.reduction.trained_basis`) has everything that training runs determine.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.plan_times import MAX_STEPS
from sphrom.case.points import ParameterPoint
from sphrom.errors import CaseError
from sphrom.metrics.measures import Quantities, Samples, with_coefficients
from sphrom.models.points.stored import Fields, snapshot_times
from sphrom.models.reference.stored import expand, read_values
from sphrom.reduction import reference_model
from sphrom.reduction.error_calibration import (
    LocalErrorCalibration,
    OutputErrors,
    compared_snapshots,
    field_of,
    output_errors,
)
from sphrom.reduction.limit_cycles import CycleClosure
from sphrom.reduction.own_pressure import PointPressure
from sphrom.reduction.reduced_measures import PointForce, TimedLoads
from sphrom.reduction.reduced_operators import Polynomial, residual_norm
from sphrom.reduction.reference_model import Integrator, ReferenceModel, Steps
from sphrom.reduction.trained_basis import ALL_MODES, LEADING, TrainedBasis, TrainedErrors
from sphrom.reduction.trial_basis import (
    TrialBasis,
    mean_density_fluctuation,
    project,
    truncate,
    with_pressures,
)
from sphrom.setup.assembly import (
    amplitude_of,
    memory_length_of,
    output_times_of,
    sound_averages,
)
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from sphrom.reduction.correction import Correction
    from sphrom.reduction.mode_splines import Values

Start = Callable[[ParameterPoint], Fields]
"""The fields on the reference points at the start of a run at a parameter point."""
Rates = tuple[Polynomial, Polynomial | None]
"""The rates at a point, and the part of them that a closure or the calibration adds."""


class BasisModel:
    """A model with one basis, at any parameter point.

    Attributes
    ----------
    section : the model in the case, with its number of modes.
    trained : the results of training.
    basis : the model's modes.
    n_integrated : number of modes that are integrated within the trained time.
    problem : why the necessary corrections are impossible; None if there is no problem.
    """

    def __init__(
        self,
        workspace: Workspace,
        section: ReducedModelSection,
        name: str,
        trained: TrainedBasis,
        basis: TrialBasis,
        start: Start,
        values: Callable[[], Values] | None = None,
    ) -> None:
        self.workspace = workspace
        self.section = section
        self.name = name
        self.trained = trained
        self.basis = basis
        self.points = workspace.case.plan.bases[name]
        self.n_integrated = trained.rates.get(LEADING, trained.rates[ALL_MODES]).operators.n_modes
        self._start = start
        self._read_values = values
        self.problem: CaseError | None = None
        self._last: Fields | None = None
        self._starts: dict[int, tuple[Array, float]] = {}
        self._leading_basis = truncate(basis, self.n_integrated)

    @property
    def places(self) -> Array:
        """(n_points, n_parameters) of the training points, as `scaled_parameters` gives them."""
        return self.trained.places

    @property
    def states(self) -> Array:
        """(n_states, n_modes) training states, around which steps must be stable."""
        return self.trained.rates[ALL_MODES].states

    @property
    def errors(self) -> TrainedErrors | None:
        """The data of error estimates; None if the case has no estimates."""
        return self.trained.errors

    @property
    def leaves_cycles(self) -> bool:
        """Whether states leave the trained limit cycles, on which the model should settle."""
        closure = self.trained.rates[ALL_MODES].closure
        return isinstance(closure, CycleClosure) and closure.slowest() >= 1.0

    @cached_property
    def values(self) -> Values:
        """The values of the modes of `whole`, by splines."""
        if self._read_values is not None:
            return self._read_values()
        own = self.trained.own_pressure is not None
        return read_values(self.workspace, self.name, self.basis.n_modes, own_pressure=own)

    @cached_property
    def whole(self) -> TrialBasis:
        """The model's modes, and then its own pressure modes."""
        if (own := self.trained.own_pressure) is None:
            return self.basis
        return with_pressures(self.basis, own.modes)

    def sampled(self, points: Array, time: Array, states: Array, mean: float) -> Samples:
        """Return velocity and pressure at points (n_points, 2) for states of `whole`.

        `mean` is the separate density fluctuation [kg/m3].
        """
        means = np.full(len(time), mean)
        return expand(self.workspace.case, self.basis, self.values, points, time, states, means)

    def integrator(self, reduced: ReferenceModel) -> Integrator:
        """Return the time steps of the model as the case sets them; exponential ones by default.

        Raises CaseError if there are too many for any run to finish.
        """
        every = self.workspace.case.snapshots.every
        return reference_model.choose(reduced, lambda part: steps_of(self.section, part, every))

    def place(self, point: ParameterPoint) -> Array:
        """Return the scaled parameters (n_parameters,) of a point."""
        values = np.stack([*point.as_dict().values()], axis=-1)
        return self.workspace.case.plan.scaled(values)

    def at(self, point: ParameterPoint) -> ReferenceModel:
        """Return the model at a point, with its corrections by training runs.

        Raises CaseError if corrections are impossible.
        """
        return self.corrected(self.uncorrected(point), point)

    def uncorrected(
        self, point: ParameterPoint, known: Mapping[str, Rates] | None = None
    ) -> ReferenceModel:
        """Return the model without corrections and forces; `known` has its rates, if available."""
        if self.problem is not None:
            raise self.problem
        model = self.projected(point, known=known)
        # At a training point it is exactly the step for which the correction was fitted.
        nearest = self.trained.nearest(self.place(point))
        step = float(self.trained.first_step[nearest]) or None  # zero if that run is not stable
        leading = model.leading and replace(model.leading, first_step=step)
        return replace(model, first_step=step, leading=leading)

    def projected(
        self,
        point: ParameterPoint,
        *,
        in_training: bool = False,
        known: Mapping[str, Rates] | None = None,
    ) -> ReferenceModel:
        """Return the projected and calibrated model at a point, without correction and forces.

        Exponential steps use the linear part of the model at the nearest training point. With
        `in_training`, the model runs over the times of the training runs.
        """
        model = self._equations(ALL_MODES, point, in_training, known)
        if LEADING not in self.trained.rates:
            return model
        # Its steps are as accurate as the basis of all modes requires.
        leading = self._equations(LEADING, point, in_training, known)
        return replace(model, leading=replace(leading, basis=self.basis))

    def _equations(
        self,
        modes: str,
        point: ParameterPoint,
        in_training: bool,
        known: Mapping[str, Rates] | None,
    ) -> ReferenceModel:
        """Return the equations and the start of the rates of some modes."""
        rates = self.trained.rates[modes]
        nearest = self.trained.nearest(self.place(point))
        own = None if known is None else known[modes]
        model = self.equations(modes, point, in_training, own)
        return replace(model, states=rates.states, linear=rates.linear_parts[nearest])

    def equations(
        self, modes: str, point: ParameterPoint, in_training: bool, known: Rates | None = None
    ) -> ReferenceModel:
        """Return the equations without states and linear parts, which only steps need."""
        case = self.workspace.case
        rates = self.trained.rates[modes]
        viscosity = case.plan.kinematic_viscosity(point)
        basis = self.basis if modes == ALL_MODES else self._leading_basis
        start, mean = self._start_at(point, basis)
        steps = case.plan.steps if in_training else case.plan.model_steps(self.section)
        polynomial, closure = known or (rates.operators.at(viscosity, point.factors), None)
        model = ReferenceModel(
            polynomial=polynomial,
            closure=closure,
            basis=basis,
            start=start,
            output_times=output_times_of(case, steps, rates.states, point),
            mean_density_fluctuation=mean,
            amplitude=amplitude_of(case, point),
            longest_step=case.plan.longest_step(point),
        )
        if known is not None:
            return model
        length = None
        if rates.memory is not None:
            length = memory_length_of(
                case,
                self.section,
                lambda: model.polynomial.jacobian(model.start, model.strongest),
            )
        polynomial, closure = rates.at(viscosity, point.factors, length)
        return replace(model, polynomial=polynomial, closure=closure, memory_length=length)

    def _start_at(self, point: ParameterPoint, basis: TrialBasis) -> tuple[Array, float]:
        """Return the coordinates and the separate mean density fluctuation at the start."""
        density, velocity = fields = self._start(point)
        # Points with the same start share its projections.
        if self._last is not fields:
            self._last, self._starts = fields, {}
        if basis.n_modes not in self._starts:
            left_out = float(mean_density_fluctuation(basis, density))
            self._starts[basis.n_modes] = project(basis, density, velocity), left_out
        return self._starts[basis.n_modes]

    def corrected(
        self, model: ReferenceModel, point: ParameterPoint, *, held_out: bool = False
    ) -> ReferenceModel:
        """Return a model with the corrections of its coordinates and forces by training runs.

        A training run that is `held_out` is corrected by the others only.
        """
        place = self.place(point)
        times = snapshot_times(self.workspace.case)
        added = {
            name: TimedLoads.of(times, loads)
            for name, force in self.trained.forces.items()
            if (loads := _learnt(force.correction, place, held_out)) is not None
        }
        forces = {name: self.force_at(name, point, added.get(name)) for name in self.trained.forces}
        pressure = None
        if (own := self.trained.own_pressure) is not None:
            viscosity = self.workspace.case.plan.kinematic_viscosity(point)
            pressure = PointPressure(
                own.at(model.polynomial, viscosity, point.factors),
                correction=_learnt(own.correction, place, held_out),
            )
        correction = self.added(point, held_out)
        return replace(
            model,
            correction=correction,
            forces=forces,
            measures=self.trained.measures,
            pressure=pressure,
        )

    def force_at(
        self, name: str, point: ParameterPoint, correction: TimedLoads | None = None
    ) -> PointForce:
        """Return a measured force at a point, with loads that training runs add."""
        viscosity = self.workspace.case.plan.kinematic_viscosity(point)
        force = self.trained.forces[name]
        closure = self.trained.rates[ALL_MODES].closure
        projected = self._projected_force(name, point, correction)
        if not isinstance(closure, CycleClosure) or force.on_cycles is None:
            return projected
        trained = [self._projected_force(name, trained_at) for trained_at in self.points]
        loads = force.on_cycles.harmonics
        return closure.force_at(projected, trained, loads, viscosity, point.factors)

    def _projected_force(
        self, name: str, point: ParameterPoint, correction: TimedLoads | None = None
    ) -> PointForce:
        viscosity = self.workspace.case.plan.kinematic_viscosity(point)
        driven = self.trained.rates[ALL_MODES].operators.walls_driven
        return self.trained.forces[name].projected.at(viscosity, driven, point.factors, correction)

    def added(self, point: ParameterPoint, held_out: bool = False) -> Array | None:
        """Return the correction (n_trained_snapshots, n_modes) of coordinates, if there is one."""
        added = _learnt(self.trained.correction, self.place(point), held_out)
        if added is not None or LEADING not in self.trained.rates:
            return added
        return np.zeros((self.workspace.case.plan.steps.n_snapshots, self.basis.n_modes))

    def held_out(self) -> list[tuple[int, ReferenceModel, Array]]:
        """Return complete training runs, corrected by the other runs only.

        Each is the number of the training run, the model, and its coordinates.
        """
        if self.errors is None or (known := self.errors.held_out) is None:
            return []
        found = []
        for k, run in zip(known.run.tolist(), known.coordinates, strict=True):
            model = self.projected(self.points[k], in_training=True)
            found.append((k, self.corrected(model, self.points[k], held_out=True), run))
        return found

    @cached_property
    def differences(self) -> dict[str, Quantities]:
        """The errors of measurements in held-out training runs (n_held_out, n_snapshots, ...)."""
        if self.errors is None:
            return {}
        stored = {name: each.quantities for name, each in self.errors.differences.items()}
        return with_coefficients(stored, self.workspace.case.plan.coefficients)

    @cached_property
    def missed(self) -> dict[str, Quantities]:
        """The part of measurements that the basis misses, relative to its field's error (...).

        Operators that were stored before have no shares; nothing is missed then.
        """
        if self.errors is None:
            return {}
        found: dict[str, Quantities] = {}
        for name, each in self.errors.differences.items():
            shares = self.errors.outputs[name].quantities if name in self.errors.outputs else {}
            found[name] = {
                q: shares.get(q, np.zeros_like(e[0, :1]))[0] / self.errors.units[field_of(q)]
                for q, e in each.quantities.items()
            }
        return with_coefficients(found, self.workspace.case.plan.coefficients)

    @cached_property
    def field_errors(self) -> Array:
        """(n_held_out, n_snapshots, 2) errors of velocity and pressure in those runs [m/s, Pa]."""
        assert self.errors is not None
        assert self.errors.held_out is not None
        errors = self.errors.held_out.errors * self.errors.units
        n_snapshots = self.errors.held_out.coordinates.shape[1]
        known = compared_snapshots(n_snapshots)
        every = np.arange(n_snapshots)
        each = [[np.interp(every, known, field) for field in run.T] for run in errors]
        return np.array(each).transpose(0, 2, 1)

    @cached_property
    def output_errors(self) -> dict[str, dict[str, OutputErrors]]:
        """The errors of any run by measurement and quantity, from held-out training runs."""
        averages = sound_averages(self.workspace.case)
        return {
            name: {
                q: output_errors(
                    e, self.field_errors[..., field_of(q)], self.missed[name][q], averages
                )
                for q, e in each.items()
            }
            for name, each in self.differences.items()
        }

    def fitted_errors(self, point: ParameterPoint) -> LocalErrorCalibration | None:
        """Return the fit of error estimates at a point; None if there is none."""
        if self.errors is None or self.errors.fitted is None:
            return None
        return self.errors.fitted.at(self.place(point))

    def residual(
        self,
        errors: TrainedErrors,
        point: ParameterPoint,
        reduced: ReferenceModel,
        times: Array,
        coordinates: Array,
    ) -> Array:
        """Return the norm (n_states,) [/s] of a model's residual at coordinates."""
        return residual_norm(
            errors.factor,
            self.workspace.case.plan.kinematic_viscosity(point),
            coordinates,
            amplitude=reduced.amplitudes(times),
            factors=point.factors,
            closure=reduced.closure,
        )


def _learnt(correction: Correction | None, place: Array, held_out: bool) -> Array | None:
    """Return a correction at a place; at a training point it comes from the other runs only."""
    if correction is None:
        return None
    return correction.held_out(place) if held_out else correction.at(place)


def steps_of(section: ReducedModelSection, reduced: ReferenceModel, full_steps: int) -> Steps:
    """Return the time steps of all modes of a model, as its section sets them.

    `full_steps` is the number of the full model's steps between snapshots. Raises CaseError if
    there are too many steps for any run to finish.
    """
    output_times = reduced.output_times
    n_intervals = reduced.output_times.n_snapshots - 1
    if section.time_step == "fom":
        return reference_model.runge_kutta(reduced, full_steps * n_intervals)
    if section.time_step != "auto":
        n_steps = round(output_times.interval / section.time_step) * n_intervals
        return reference_model.runge_kutta(reduced, n_steps)
    if reduced.first_step is None and output_times.duration > MAX_STEPS * reduced.step_limit:
        raise CaseError(
            f"rom: {section.name} is stable only with steps below {reduced.step_limit:.3g} s, more "
            f"than {MAX_STEPS:g} in a run; choose fewer modes, a memory_length or a time_step"
        )
    return reference_model.automatic_whole(reduced)
