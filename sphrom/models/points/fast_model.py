"""`FastModel`, a model from operators that runs at any parameters, and its runs with their results.

All commands and the Python interface run models this way. `basis_model` has the equations with one
basis, `sphrom.reduction.reference_model` integrates them, and `runs` writes the results of the
stage `rom`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts.records.reduced_models import TrainedModel
from sphrom.case.model_sections import ReducedModelSection
from sphrom.case.points import ParameterPoint
from sphrom.errors import UnstableError
from sphrom.metrics.measures import Quantities, Samples, in_regime, items
from sphrom.metrics.series import TOO_CLOSE, UNDECIDED
from sphrom.models.contract import Model, ModelRun, TrainedDifferences
from sphrom.models.estimates import ErrorEstimate
from sphrom.models.points.basis_model import BasisModel
from sphrom.models.points.error_estimates import estimate, measured_errors
from sphrom.models.points.oscillation_errors import OscillationErrors, oscillation_errors
from sphrom.models.points.quantities import quantities_of
from sphrom.models.points.stored import Fields, mapped_starts, stored_model, stored_starts
from sphrom.models.reference.stored import both
from sphrom.models.starts import RunStarts
from sphrom.plots.tables import format_figure
from sphrom.reduction.limit_cycles import CycleClosure
from sphrom.reduction.reference_model import Integrator, ReferenceModel, automatic
from sphrom.reduction.trained_basis import ALL_MODES
from sphrom.reduction.trial_basis import ModeVelocities, TrialBasis
from sphrom.setup.assembly import MOST_GROWTH, inner_product
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from sphrom.models.points.sensitivities import Tangents
    from sphrom.reduction.mode_splines import Values

DOUBTFUL = 50.0
"""Estimated error from which a run is doubtful [%]; errors are up to twice their estimates."""


class FastModel(Model[ReferenceModel]):
    """One model from operators, built and run at any parameters.

    The initial condition is that of the scene, or the end of the spin-up at the point or at the
    nearest trained point, mapped onto the reference space and projected.

    If training runs choose the number of modes, it is in the section of the model `on_basis`.
    """

    def __init__(
        self,
        workspace: Workspace,
        section: ReducedModelSection,
        stored: TrainedModel | None = None,
    ) -> None:
        super().__init__(workspace, section)
        self._is_alone = stored is not None
        self._stored = stored or stored_model(workspace, section)
        self._on_basis: dict[str, BasisModel] = {}
        self._velocities: dict[str, ModeVelocities] = {}
        self._oscillation_errors: dict[str, dict[str, OscillationErrors]] = {}

    def on_basis(self, name: str) -> BasisModel:
        """Return the model with one of its bases."""
        if name not in self._on_basis:
            if self._stored is not None and name in self._stored.bases:
                self._on_basis[name] = self._opened(self._stored, name)
            else:
                from sphrom.models.points.training import train  # models with an artifact need none

                self._on_basis[name] = train(self.workspace, self.section, name, self._starts.at)
        return self._on_basis[name]

    def _opened(self, stored: TrainedModel, name: str) -> BasisModel:
        """Return the stored model with one of its bases."""
        case = self.workspace.case
        trained = stored.bases[name]
        product = inner_product(case)
        basis = TrialBasis(
            **vars(stored.modes[name]),
            inner_product=product,
            weights=product.weights(stored.volume),
            separate_mean=case.plan.separate_mean_density,
        )
        section = self.section.model_copy(update={"n_modes": basis.n_modes})

        def values() -> Values:
            from sphrom.models.reference.splines import fit  # few programs need it
            from sphrom.reduction.mode_splines import basis_columns

            points = stored.reference_position
            report = self.workspace.context.report
            found = fit(case, points, basis_columns(basis), f"basis {name}", report).values
            if (own := trained.own_pressure) is None:
                return found
            return both(found, fit(case, points, own.modes.T, f"pressure {name}", report).values)

        start = self._starts.at
        alone = values if self._is_alone else None
        return BasisModel(self.workspace, section, name, trained, basis, start, alone)

    def at_point(self, point: ParameterPoint) -> BasisModel:
        """Return the model with the basis that it uses at a parameter point."""
        return self.on_basis(self.basis_at(point))

    @cached_property
    def _starts(self) -> RunStarts[Fields]:
        if (stored := self._stored) is not None:
            return mapped_starts(self.workspace, stored.reference_position, stored.starts)
        return mapped_starts(self.workspace, stored=stored_starts(self.workspace))

    def run(
        self,
        point: ParameterPoint,
        reduced: ReferenceModel | None = None,
        integrator: Integrator | None = None,
    ) -> FastRun:
        """Run the model at a parameter point.

        Parameters
        ----------
        reduced : the model at the point, if it is available or has other output times.
        integrator : by default the model's own.
        """
        reduced = reduced or self.at(point)
        integrator = integrator or self.at_point(point).integrator(reduced)
        return FastRun(**vars(integrator.run()), model=self, point=point, reduced=reduced)

    def runs(self, points: Sequence[ParameterPoint]) -> Iterator[FastRun]:
        """Run the model at many points; results are bitwise equal to single runs."""
        from sphrom.models.points.many_runs import MOST, can_run_together, run_together

        for name, group in groupby(points, self.basis_at):
            some = [*group]
            if can_run_together(self.on_basis(name)):
                for k in range(0, len(some), MOST):
                    yield from run_together(self, name, some[k : k + MOST])
            else:
                yield from map(self.run, some)

    def at(self, point: ParameterPoint) -> ReferenceModel:
        """Return the model at a parameter point."""
        return self.at_point(point).at(point)

    def timed(self, point: ParameterPoint, repeats: int) -> tuple[FastRun, float]:
        """Return a run in automatic steps, and the least time that some took [s]."""
        reduced = self.at(point)
        found, seconds = automatic(reduced).timed(repeats)
        return FastRun(**vars(found), model=self, point=point, reduced=reduced), seconds

    def runner(self, point: ParameterPoint) -> Callable[[], object]:
        """Return a function that makes one run at a parameter point, for timing."""
        return self.at_point(point).integrator(self.at(point)).run

    def tangents(
        self,
        point: ParameterPoint,
        names: Sequence[str],
        reduced: ReferenceModel,
        step_factor: float = 1.0,
        integrator: Integrator | None = None,
    ) -> Tangents:
        """Return derivatives with respect to some parameters, in steps longer by a factor."""
        from sphrom.models.points.sensitivities import tangents

        return tangents(self, point, names, reduced, step_factor, integrator)

    def regime(self, point: ParameterPoint) -> str | None:
        closure = self.at_point(point).trained.rates[ALL_MODES].closure
        if not isinstance(closure, CycleClosure):
            return None
        viscosity = self.workspace.case.plan.kinematic_viscosity(point)
        return closure.regime(viscosity, point.factors)

    def oscillation_errors(self, point: ParameterPoint) -> dict[str, OscillationErrors]:
        """Return the errors of oscillations of the basis at a parameter point, by name."""
        if (name := self.basis_at(point)) not in self._oscillation_errors:
            self._oscillation_errors[name] = oscillation_errors(self.on_basis(name))
        return self._oscillation_errors[name]

    def measures(
        self, reduced: ReferenceModel, time: Array, coordinates: Array
    ) -> dict[str, Quantities]:
        """Return the measurements of states (n_states, n_modes) at times (n_states,) [s]."""
        return quantities_of(self.workspace.case, reduced, time, coordinates)

    def trained_differences(self, points: Sequence[ParameterPoint]) -> list[TrainedDifferences]:
        """Return the errors of training runs, for the bases of models at points.

        The list is empty if the case has no error estimates.
        """
        bases = [self.on_basis(name) for name in dict.fromkeys(map(self.basis_at, points))]
        found = []
        for basis in bases:
            if (errors := basis.errors) is None:
                return []
            for row in range(0 if errors.held_out is None else len(errors.held_out.run)):
                differences = items(basis.differences, row)
                found.append(TrainedDifferences(differences, basis.field_errors[row], basis.missed))
        return found

    def velocities(self, run: FastRun) -> ModeVelocities:
        """Return the object that computes speeds and energies of a run, one per basis."""
        if (name := self.basis_at(run.point)) not in self._velocities:
            self._velocities[name] = ModeVelocities(run.reduced.basis)
        return self._velocities[name]


@dataclass(frozen=True, kw_only=True)
class FastRun(ModelRun):
    """A run of a model, and the model that made it."""

    model: FastModel
    reduced: ReferenceModel
    diverged_at: float
    """[s], NaN for a completed run."""

    @property
    def on_basis(self) -> BasisModel:
        """The model with the basis of the run."""
        return self.model.at_point(self.point)

    @property
    def failure(self) -> UnstableError | None:
        """Why the run ended early; None if it did not."""
        if math.isnan(at := self.diverged_at):
            return None
        chosen = self.model.section.time_step == "auto"
        return UnstableError(
            f"unstable after t = {at:.6g} s: the coordinates are beyond {MOST_GROWTH:g} times the "
            f"largest trained ones; {'other modes' if chosen else 'a smaller time step'} may help"
        )

    @cached_property
    def states(self) -> Array:
        """(n_snapshots, n) coordinates, then those of separate pressure modes, if there are any."""
        return self.reduced.with_pressure(self.time, self.coordinates)

    @property
    def kinetic_energy(self) -> Array:
        """The kinetic energy (n_snapshots,) [J/m]."""
        mass = self.model.workspace.case.plan.mass
        return self.model.velocities(self).kinetic_energy(self.coordinates, mass)

    @property
    def largest_speed(self) -> float:
        """The largest speed of all points and snapshots [m/s]."""
        return self.model.velocities(self).largest_speed(self.coordinates)

    @cached_property
    def measured(self) -> dict[str, Quantities]:
        """All measurements of the case (n_snapshots, ...), by name and quantity."""
        case = self.model.workspace.case
        return quantities_of(case, self.reduced, self.time, self.coordinates)

    @cached_property
    def estimate(self) -> ErrorEstimate | None:
        """The estimated errors of the run; None if there are no estimates."""
        return estimate(self)

    @cached_property
    def measured_errors(self) -> Mapping[str, Quantities]:
        """The estimated errors of all measurements (n_snapshots, ...); empty without estimates."""
        return measured_errors(self)

    @cached_property
    def oscillation_errors(self) -> Mapping[str, Mapping[str, float]]:
        """The estimated errors of oscillations, and of the phase at the end [deg]."""
        viscosity = self.model.workspace.case.plan.kinematic_viscosity(self.point)
        duration = float(self.time[-1] - self.time[0])
        return {
            name: in_regime(self.regime, each.at(viscosity, self.point.factors, duration))
            for name, each in self.model.oscillation_errors(self.point).items()
        }

    @cached_property
    def outside(self) -> tuple[str, ...]:
        """Warnings about a run outside the trained parameters, or longer than training runs."""
        texts = super().outside
        if self.regime == UNDECIDED:
            texts = (*texts, TOO_CLOSE)
        if self.model.at_point(self.point).leaves_cycles:
            n_modes = self.model.section.size
            return (*texts, f"states of {n_modes} modes leave the trained cycles")
        return texts

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """Reasons why a completed run may be wrong, as far as known without a full run."""
        errors = self.estimate
        if errors is None and self.model.at_point(self.point).errors is not None:
            text = (
                "no estimate of errors: the model's training runs have no error estimates, or "
                "all of them diverge"
            )
            return (*self.outside, text)
        if errors is None or max(errors.velocity_percent, errors.pressure_percent) < DOUBTFUL:
            return self.outside
        shares = errors.velocity_percent, errors.pressure_percent
        velocity, pressure = (f"{format_figure(share, 2)} %" for share in shares)
        text = f"its estimated errors are {velocity} in velocity and {pressure} in pressure"
        return (*self.outside, text)

    @property
    def done(self) -> FastRun:
        """The part of the run before it diverged."""
        n_done = int(np.isfinite(self.coordinates).all(axis=1).sum())
        return replace(
            self,
            time=self.time[:n_done],
            coordinates=self.coordinates[:n_done],
            correction=None if self.correction is None else self.correction[:n_done],
        )

    def sampled(self, points: Array) -> Samples:
        """Return velocity and pressure at points (n_points, 2) [m], by the splines of the modes."""
        mean = self.reduced.mean_density_fluctuation
        return self.model.at_point(self.point).sampled(points, self.time, self.states, mean)
