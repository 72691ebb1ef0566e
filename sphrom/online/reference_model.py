"""Build reduced models on the reference points: their rates, and the starts of their runs.

Whatever doesn't depend on the parameter point is read and computed once, for all points.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.plan import TimeSteps, model_plan, step_plan
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import AUTO, ReducedModelSection
from sphrom.errors import CaseError
from sphrom.online.closures import CLOSURES, Close
from sphrom.online.integration import polynomial_integrator
from sphrom.reduction.calibration import Calibration
from sphrom.reduction.correction import Correction, learn_correction
from sphrom.reduction.force_calibration import ForceRecord, calibrate_force
from sphrom.reduction.forces import ReducedForce
from sphrom.reduction.measures import ReducedMeasure
from sphrom.reduction.polynomial_model import OutputTimes, step_limits
from sphrom.reduction.reduced_operators import ReducedOperators
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.reduction.trial_basis import (
    TrialBasis,
    kept_modes,
    mean_density_fluctuation,
    project,
    truncate,
)
from sphrom.setup.places import places_of
from sphrom.setup.reduced_runs import amplitude_of, output_times_of
from sphrom.store.basis import read_basis
from sphrom.store.calibration import read_calibration
from sphrom.store.mapped_starts import Fields, MappedStarts
from sphrom.store.operators import (
    read_force_records,
    read_integrated,
    read_measure,
    read_operators,
    read_wall_force,
    sized_in,
)
from sphrom.store.workspace import Workspace

Array = NDArray[np.float64]
_Run = tuple[Array, float] | None
"""Coordinates (n_snapshots, n_modes) and the mean density [kg/m3]; None where they diverged."""


def build_reference_model(
    workspace: Workspace, model: ReducedModelSection, point: ParameterPoint
) -> ReferenceModel:
    """Return a model on the reference points at a parameter point, which need not be trained."""
    return ReferenceModels(workspace, model).at(point)


class ReferenceModels:
    """One model on the reference points, at any parameter points.

    The initial condition is the scene's at that point, or the end of the spin-up, that of the
    nearest trained value where there is none; mapped onto the reference space and projected.
    """

    def __init__(self, workspace: Workspace, model: ReducedModelSection) -> None:
        self._workspace = workspace
        self.model = model
        self._shared: dict[str, _Shared] = {}
        self._trained: dict[tuple[str, float], list[tuple[ReferenceModel, Array]]] = {}
        self._corrections: dict[str, Correction | None] = {}
        self._calibrated: dict[str, Mapping[str, ReducedForce]] = {}
        self._starts: MappedStarts | None = None
        self._plans = step_plan(workspace.case), model_plan(workspace.case, model)
        self._prepared: dict[ParameterPoint, ReferenceModel] = {}
        self._times: dict[tuple[str, int], OutputTimes] = {}
        self._leading: dict[str, ReferenceModels | None] = {}

    def at(self, point: ParameterPoint) -> ReferenceModel:
        """Return the model at a parameter point."""
        name = self._workspace.case.basis_for(self.model, point)
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
            name = self._workspace.case.basis_for(self.model, point)
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

    def _first(self, name: str) -> ReferenceModels | None:
        """Return the models of the modes that are integrated; None where all are."""
        if name not in self._leading:
            shared = self._of(name)
            change = {"n_modes": shared.n_integrated, "corrected": False}
            section = self.model.model_copy(update=change)
            fewer = kept_modes(shared.basis, shared.n_integrated).size < shared.basis.n_modes
            self._leading[name] = ReferenceModels(self._workspace, section) if fewer else None
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
        case, shared = self._workspace.case, self._of(name)
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
            return correction.at(places_of(self._workspace.case, [point])[0])
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
            points = self._workspace.case.bases[name]
            self._trained[key] = [self._repeated(point, name, step_factor) for point in points]
        return self._trained[key]

    def first_trained(self, name: str) -> ReferenceModel:
        """Return the model at the first training point of a basis, without its correction."""
        point, plan, first = self._workspace.case.bases[name][0], self._plans[0], self._first(name)
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
        steps = polynomial_integrator(self.model, integrated, plan.every).with_steps(step_factor)
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
        case, shared = self._workspace.case, self._of(name)
        viscosity = case.kinematic_viscosity(point)
        coordinates, mean = shared.initial_state(self._mapped_starts().at(point))
        output_times = self._output_times(name, plan)
        amplitude = amplitude_of(case, point)
        strongest = (
            0.0 if amplitude is None else float(np.max(np.abs(amplitude(output_times.time))))
        )
        rates = shared.operators.at(viscosity, factors=point.factors)
        polynomial, memory_length = shared.close(
            rates, viscosity, lambda: rates.jacobian(coordinates, strongest)
        )
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
            self._times[key] = output_times_of(self._workspace.case, plan, self._of(name).basis)
        return self._times[key]

    def _mapped_starts(self) -> MappedStarts:
        """Return the starts of runs, which are read once."""
        if self._starts is None:
            with self._workspace.open(self._workspace.operators()) as artifact:
                self._starts = MappedStarts(self._workspace, artifact)
        return self._starts

    def training_states(self, point: ParameterPoint) -> Array:
        """Return coordinates (n_states, n_modes) of training states of the basis at a point."""
        return self._of(self._workspace.case.basis_for(self.model, point)).states

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
            points = self._workspace.case.bases[name]
            runs = [self._run(point, name) for point in points]
            with self._workspace.open(self._workspace.operators()) as artifact:
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
            runs = polynomial_integrator(self.model, reduced, plan.every).run()
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
        case, shared = self._workspace.case, self._of(name)
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

    def _of(self, name: str) -> _Shared:
        if name not in self._shared:
            section = sized_in(self._workspace, self.model, name)
            self._shared[name] = _read_shared(self._workspace, section, name)
        return self._shared[name]


@dataclass
class _Shared:
    """The parts of a model that all parameter points with the same basis share."""

    basis: TrialBasis
    operators: ReducedOperators
    states: Array
    """(n_states, n_modes) around which steps have to be stable."""
    close: Close
    """Adds the closure to the rates."""
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


def _read_shared(workspace: Workspace, model: ReducedModelSection, name: str) -> _Shared:
    whole = read_basis(workspace, name)
    modes = kept_modes(whole, model.size)
    with workspace.open(workspace.operators()) as artifact:
        artifact.require(f"bases/{name}/acoustic", mode=whole.n_modes)
        operators = read_operators(artifact, name, modes)
        close = CLOSURES[model.projection].of_operators(workspace.case, model, artifact, name)
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
    return _Shared(
        basis, operators, states, close, calibration, projected, forces, measures, modes,
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
