"""Models from operators: their rates, the starts of their runs, and runs with all that they give.

Whatever doesn't depend on the parameter point is read and computed once, for all points. The
commands and the Python interface all run models this way.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.plan import TimeSteps, model_plan, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.errors import CaseError, UnstableError
from sphrom.metrics.measures import Quantities
from sphrom.metrics.samples import Probes, Samples
from sphrom.online.error_estimates import Estimate, Trained, estimate
from sphrom.online.model_parts import ModelParts, quantities_of, read_parts, steps_of
from sphrom.reduction import reference_model
from sphrom.reduction.correction import Correction, learn_correction
from sphrom.reduction.polynomial_model import OutputTimes, Runs, step_limits
from sphrom.reduction.reduced_measures import ForceRecord, ReducedForce, calibrate_force
from sphrom.reduction.reference_model import Integrator, ReferenceModel
from sphrom.reduction.trial_basis import TrialBasis, kept_modes
from sphrom.setup.places import places_of
from sphrom.setup.reduced_runs import amplitude_of, memory_length_of, output_times_of
from sphrom.store.starts import MappedStarts
from sphrom.store.trained_operators import read_force_records, sized_in
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from sphrom.reduction.mode_splines import ModeSplines

Array = NDArray[np.float64]
_Run = tuple[Array, float] | None
"""Coordinates (n_snapshots, n_modes) and the mean density [kg/m3]; None where they diverged."""


class FastModel:
    """One model from operators: built and run at any parameters.

    The initial condition is the scene's at a point, or the end of the spin-up, that of the nearest
    trained value where there is none; mapped onto the reference space and projected.

    Parameters
    ----------
    section : the model in the case. Where training runs choose its number of modes, `sized` has it.
    """

    def __init__(self, workspace: Workspace, section: ReducedModelSection) -> None:
        self.workspace, self.section = workspace, section
        self.trained_errors: dict[tuple[str, float], Trained] = {}
        """The fits of error estimates to training runs, by basis and factor of the steps."""
        self._shared: dict[str, ModelParts] = {}
        self._trained: dict[tuple[str, float], list[tuple[ReferenceModel, Array]]] = {}
        self._corrections: dict[str, Correction | None] = {}
        self._calibrated: dict[str, Mapping[str, ReducedForce]] = {}
        self._starts: MappedStarts | None = None
        self._plans = step_plan(workspace.case), model_plan(workspace.case, section)
        self._prepared: dict[ParameterPoint, ReferenceModel] = {}
        self._times: dict[tuple[str, int], OutputTimes] = {}
        self._leading: dict[str, FastModel | None] = {}
        self._splines: dict[str, ModeSplines] = {}

    def basis_at(self, point: ParameterPoint) -> str:
        """Return the name of the model's basis at a parameter point."""
        return self.workspace.case.basis_for(self.section, point)

    def trial_basis(self, point: ParameterPoint) -> TrialBasis:
        """Return the modes of the model at a parameter point."""
        return self._of(self.basis_at(point)).basis

    def sized(self, point: ParameterPoint) -> ReducedModelSection:
        """Return the model's section with its number of modes at a point."""
        return self._of(self.basis_at(point)).section

    def integrator(self, reduced: ReferenceModel) -> Integrator:
        """Return the steps of the model as the case asks for them: exponential ones by default.

        Raises CaseError where they are too many for any run to end.
        """
        every = self.workspace.case.snapshots.every
        return reference_model.choose(reduced, lambda part: steps_of(self.section, part, every))

    def run(
        self,
        point: ParameterPoint,
        reduced: ReferenceModel | None = None,
        integrator: Integrator | None = None,
    ) -> FastRun:
        """Run the model at a parameter point.

        Parameters
        ----------
        reduced : the model at the point, where it is known or has other output times.
        integrator : the model's own by default.
        """
        reduced = reduced or self.at(point)
        return FastRun(self, point, reduced, (integrator or self.integrator(reduced)).run())

    def at(self, point: ParameterPoint) -> ReferenceModel:
        """Return the model at a parameter point."""
        name = self.basis_at(point)
        found, first = self._built(point, name), self._first(name)
        if first is not None:
            found = found.with_leading(first._built(point, name))
        return self._taught(found, name, point)

    def _built(self, point: ParameterPoint, name: str) -> ReferenceModel:
        return self._prepared.pop(point, None) or self._projected(point, name, self._plans[1])

    def prepare(self, points: Sequence[ParameterPoint]) -> None:
        """Build the models at points together, which is faster, for `at` to return them."""
        by_basis: dict[str, list[ParameterPoint]] = {}
        for point in points:
            name = self.basis_at(point)
            by_basis.setdefault(name, []).append(point)
        for name, those in by_basis.items():
            found = [self._equations(name, point, self._plans[1]) for point in those]
            limited = _with_limits(found, self._of(name).states)
            self._prepared |= dict(zip(those, limited, strict=True))
            if (first := self._first(name)) is not None:
                first.prepare(those)

    def equations(self, point: ParameterPoint, basis: str) -> ReferenceModel:
        """Return the model at a point with a basis, without what choosing steps takes."""
        found, _ = self._equations(basis, point, self._plans[1])
        if (first := self._first(basis)) is not None:
            leading, _ = first._equations(basis, point, self._plans[1])
            found = found.with_leading(leading)
        return self._taught(found, basis, point)

    def _first(self, name: str) -> FastModel | None:
        """Return the models of the modes that are integrated; None where all are."""
        if name not in self._leading:
            shared = self._of(name)
            change = {"n_modes": shared.n_integrated, "corrected": False}
            section = self.section.model_copy(update=change)
            fewer = kept_modes(shared.basis, shared.n_integrated).size < shared.basis.n_modes
            self._leading[name] = FastModel(self.workspace, section) if fewer else None
        return self._leading[name]

    def _taught(self, found: ReferenceModel, name: str, point: ParameterPoint) -> ReferenceModel:
        """Return a model with what training runs tell of its coordinates and forces."""
        return replace(found, correction=self._added(name, point), forces=self._forces(name, point))

    def correction(self, name: str) -> Correction | None:
        """Return the correction of the model with a basis, None where it has none."""
        if name not in self._corrections:
            self._corrections[name] = self._learnt(name)
        return self._corrections[name]

    def _learnt(self, name: str) -> Correction | None:
        case, shared = self.workspace.case, self._of(name)
        if shared.projected is None:
            return None
        coordinates = np.stack([coordinates for _, coordinates in self.trained(name)])
        leading = kept_modes(shared.basis, shared.n_integrated)
        others = np.setdiff1d(np.arange(coordinates.shape[2]), leading)
        places = places_of(case, case.bases[name])
        return learn_correction(places, shared.projected - coordinates, (leading, others))

    def _added(self, name: str, point: ParameterPoint) -> Array | None:
        """Return what is added to coordinates (n_trained_snapshots, n_modes), if anything is."""
        correction = self.correction(name)
        if correction is not None:
            return correction.at(places_of(self.workspace.case, [point])[0])
        if self._first(name) is None:
            return None
        return np.zeros((self._plans[0].n_snapshots, self._of(name).basis.n_modes))

    def trained(self, name: str, step_factor: float = 1.0) -> list[tuple[ReferenceModel, Array]]:
        """Return the model at the training points of a basis, and what it integrates to there.

        Coordinates that are not integrated are zero.

        Parameters
        ----------
        step_factor : length of the steps over the model's own.
        """
        key = name, step_factor
        if key not in self._trained:
            points = self.workspace.case.bases[name]
            self._trained[key] = [self._repeated(point, name, step_factor) for point in points]
        return self._trained[key]

    def first_trained(self, name: str) -> ReferenceModel:
        """Return the model at the first training point of a basis, without its correction."""
        point, plan, first = self.workspace.case.bases[name][0], self._plans[0], self._first(name)
        leading = None if first is None else first._projected(point, name, plan)
        return self._projected(point, name, plan).with_leading(leading)

    def _repeated(
        self, point: ParameterPoint, name: str, step_factor: float
    ) -> tuple[ReferenceModel, Array]:
        """Return the model at a training point, and what it integrates to."""
        plan, first = self._plans[0], self._first(name)
        reduced = self._projected(point, name, plan)
        leading = None if first is None else first._projected(point, name, plan)
        integrated = reduced.with_leading(leading).leading or reduced
        steps = self.integrator(integrated).with_steps(step_factor)
        coordinates = steps.run().coordinates[0]
        return reduced, coordinates if first is None else reduced.spread(coordinates)

    def _projected(self, point: ParameterPoint, name: str, plan: TimeSteps) -> ReferenceModel:
        """Return the model without its correction and its forces."""
        equations = self._equations(name, point, plan)
        return _with_limits([equations], self._of(name).states)[0]

    def _equations(
        self, name: str, point: ParameterPoint, plan: TimeSteps
    ) -> tuple[ReferenceModel, float]:
        """Return the model's equations and start alone; the largest amplitude."""
        case, shared = self.workspace.case, self._of(name)
        viscosity = case.kinematic_viscosity(point)
        coordinates, mean = shared.initial_state(self._mapped_starts().at(point))
        output_times = self._output_times(name, plan)
        amplitude = amplitude_of(case, point)
        strongest = (
            0.0 if amplitude is None else float(np.max(np.abs(amplitude(output_times.time))))
        )
        rates = shared.operators.at(viscosity, factors=point.factors)
        polynomial, memory_length = rates, None
        if shared.memory is not None:
            memory_length = memory_length_of(
                case, shared.section, lambda: rates.jacobian(coordinates, strongest)
            )
            polynomial = rates.plus(shared.memory.at(viscosity), memory_length)
        if shared.calibration is not None:
            polynomial = polynomial.plus(shared.calibration.at(viscosity, point.factors))
        found = ReferenceModel(
            polynomial=polynomial,
            basis=shared.basis,
            start=coordinates,
            output_times=output_times,
            mean_density_fluctuation=mean,
            step_limit=math.inf,
            amplitude=amplitude,
            memory_length=memory_length,
            measures=shared.measures,
        )
        return found, strongest

    def _output_times(self, name: str, plan: TimeSteps) -> OutputTimes:
        """Return the snapshots of a plan's runs with a basis, which are the same at all points."""
        key = name, plan.n_snapshots
        if key not in self._times:
            self._times[key] = output_times_of(self.workspace.case, plan, self._of(name).basis)
        return self._times[key]

    def _mapped_starts(self) -> MappedStarts:
        """Return the starts of runs, which are read once."""
        if self._starts is None:
            with self.workspace.open(self.workspace.operators()) as artifact:
                self._starts = MappedStarts(self.workspace, artifact)
        return self._starts

    def training_states(self, point: ParameterPoint) -> Array:
        """Return coordinates (n_states, n_modes) of training states of the basis at a point."""
        return self._of(self.basis_at(point)).states

    def _forces(self, name: str, point: ParameterPoint) -> Mapping[str, ReducedForce]:
        """Return the forces on walls at a parameter point, calibrated."""
        forces = self._calibrated_forces(name)
        return {measured: f.with_drives(point.factors) for measured, f in forces.items()}

    def _calibrated_forces(self, name: str) -> Mapping[str, ReducedForce]:
        """Return the forces on walls, calibrated in runs of the model at the trained points."""
        forces = self._of(name).forces
        if not forces:
            return {}
        if name not in self._calibrated:
            points = self.workspace.case.bases[name]
            runs = [self._run(point, name) for point in points]
            with self.workspace.open(self.workspace.operators()) as artifact:
                self._calibrated[name] = {
                    measured: calibrate_force(force, self._records(artifact, name, measured, runs))
                    for measured, force in forces.items()
                }
        return self._calibrated[name]

    def _run(self, point: ParameterPoint, name: str) -> _Run:
        """Return the coordinates and mean of a run; None where it is not stable."""
        plan = self._plans[0]
        try:
            reduced, first = self._projected(point, name, plan), self._first(name)
            leading = None if first is None else first._projected(point, name, plan)
            reduced = replace(reduced, correction=self._added(name, point)).with_leading(leading)
            runs = self.integrator(reduced).run()
        except CaseError:
            return None
        coordinates = runs.coordinates[0]
        if not np.isfinite(coordinates).all():
            return None
        return coordinates, reduced.mean_density_fluctuation

    def _records(
        self,
        artifact: Artifact,
        name: str,
        measured: str,
        runs: Sequence[_Run],
    ) -> list[ForceRecord]:
        """Return what full runs recorded, with the states of the model's own where they are."""
        case, shared = self.workspace.case, self._of(name)
        records = read_force_records(case, artifact, name, measured, shared.modes)
        return [
            record
            if run is None
            else replace(
                record,
                coordinates=run[0],
                mean_density_fluctuation=np.full(len(run[0]), run[1]),
            )
            for record, run in zip(records, runs, strict=True)
        ]

    def sampled(
        self,
        point: ParameterPoint,
        reduced: ReferenceModel,
        probes: Probes,
        time: Array,
        coordinates: Array,
        mean_density_fluctuation: float,
    ) -> Samples:
        """Return velocity and pressure at probes of coordinates (n_snapshots, n_modes)."""
        # Fields load the kernels of splines.
        from sphrom.store.bases import read_model_splines
        from sphrom.store.sampling import expand

        name = self.basis_at(point)
        if name not in self._splines:
            size = self._of(name).section.size
            self._splines[name] = read_model_splines(self.workspace, name, size)
        splines = self._splines[name]
        means = np.full(len(time), mean_density_fluctuation)
        case = self.workspace.case
        return expand(case, reduced.basis, splines, probes, time, coordinates, means)

    def _of(self, name: str) -> ModelParts:
        if name not in self._shared:
            section = sized_in(self.workspace, self.section, name)
            self._shared[name] = read_parts(self.workspace, section, name)
        return self._shared[name]


def _with_limits(
    equations: Sequence[tuple[ReferenceModel, float]], states: Array
) -> list[ReferenceModel]:
    """Return models with their step limits around states, given with their largest amplitudes."""
    mean = states.mean(axis=0)
    limits = step_limits(
        [
            (found.polynomial, np.vstack((found.start, states)), strongest)
            for found, strongest in equations
        ]
    )
    return [
        replace(found, step_limit=limit, linear=found.polynomial.jacobian(mean, strongest))
        for (found, strongest), limit in zip(equations, limits, strict=True)
    ]


@dataclass(frozen=True)
class FastRun:
    """A run of a model, and the model that made it."""

    model: FastModel
    """The model at any parameter point."""
    point: ParameterPoint
    reduced: ReferenceModel
    """The model at the point."""
    runs: Runs
    """The run, alone."""
    step_factor: float = 1.0
    """Length of its steps over the model's own."""

    @property
    def name(self) -> str:
        """The model and the point, as messages name them."""
        return f"{self.model.section.name}, {self.point.label}"

    @property
    def time(self) -> Array:
        """(n_snapshots,) [s]."""
        return self.runs.time

    @property
    def time_step(self) -> float:
        """[s]."""
        return float(self.runs.time_step[0])

    @property
    def coordinates(self) -> Array:
        """(n_snapshots, n_modes), NaN once it has diverged."""
        return self.runs.coordinates[0]

    @property
    def correction(self) -> Array | None:
        """(n_snapshots, n_modes) the part of the coordinates that training runs add, if any do."""
        return None if self.runs.correction is None else self.runs.correction[0]

    @property
    def failure(self) -> UnstableError | None:
        """Why the run ended early; None where it didn't."""
        at = float(self.runs.diverged_at[0])
        if np.isnan(at):
            return None
        return UnstableError(
            f"unstable after t = {at:.6g} s: the coordinates are beyond those of a flow as fast as "
            "sound; a smaller time step or another number of modes may help"
        )

    @property
    def measured(self) -> dict[str, Quantities]:
        """All that the case measures, by name and quantity (n_snapshots, ...)."""
        case = self.model.workspace.case
        return quantities_of(case, self.point, self.reduced, self.time, self.coordinates)

    @property
    def estimate(self) -> Estimate | None:
        """The estimated errors of the run; None where the case wants none or can't have them."""
        found = estimate(self)
        return None if found is None or found.errors is None else found

    def sampled(self, probes: Probes) -> Samples:
        """Return velocity and pressure at probes, by the splines of the modes."""
        return self.model.sampled(
            self.point,
            self.reduced,
            probes,
            self.time,
            self.coordinates,
            self.reduced.mean_density_fluctuation,
        )
