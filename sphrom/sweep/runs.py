"""The runs of a sweep: one model at one parameter point after the other, and their records.

A run is the one that the stage of its model makes, to the last bit. Full runs, and reduced ones on
particles, write their trajectories as those stages do; those on the reference points write nothing.
The records of a task become a part on disk, which is there as a whole or not at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact
from sphrom.case.loader import case_of_text
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.case.studies import sweep_model
from sphrom.errors import SphromError, UnstableError
from sphrom.metrics.measures import PLACED, Quantities, components, of_a_run
from sphrom.metrics.samples import Probes, Samples
from sphrom.metrics.trends import kinetic_energy
from sphrom.offline import fom
from sphrom.online import rom
from sphrom.online.error_estimates import EstimatedRun, Trained, estimate, shares, units_of
from sphrom.online.measures import quantities_of
from sphrom.online.reference_model import ReferenceModels
from sphrom.online.reference_runs import failure_of, run_once
from sphrom.online.sensitivities import tangents
from sphrom.reduction.kinetic_energy import KineticEnergy
from sphrom.reduction.largest_speed import SpeedBounds
from sphrom.reduction.mode_splines import ModeSplines
from sphrom.reduction.polynomial_model import Runs
from sphrom.reduction.reference_model import ReferenceModel
from sphrom.setup import assembly
from sphrom.setup.context import StageContext
from sphrom.setup.measured_fields import sampler
from sphrom.setup.reporters import BriefReporter
from sphrom.store.checkpoints import remove_checkpoints
from sphrom.store.measures import measured_of
from sphrom.store.operators import sized_in
from sphrom.store.sampling import expand, sample_run
from sphrom.store.splines import read_model_splines
from sphrom.store.sweep import COMPLETE, UNSTABLE, EstimatedErrors, RunRecord, RunResult
from sphrom.store.targets import Target
from sphrom.store.workspace import Workspace
from sphrom.sweep.parts import probe_places, require_folder, write_part
from sphrom.sweep.tasks import Failure, SweepTask, attempted

Array = NDArray[np.float64]

LOADS = ("force_x", "force_y", "torque")
"""What columns call the loads on a wall."""
TOGETHER = 64
"""Models that are built together."""
NOWHERE = np.empty((0, 2))


def attempt(task: SweepTask) -> tuple[Failure, ...]:
    """Do a task, and return its failures."""
    return attempted(task, _run)


def _run(task: SweepTask) -> tuple[Failure, ...]:
    swept = _swept(replace(task, points=()))
    records: list[RunRecord] = []
    failed: list[Failure] = []
    for k, point in enumerate(task.points):
        if k % TOGETHER == 0:
            swept.prepare(task.points[k : k + TOGETHER])
        require_folder(swept.workspace)
        try:
            records.append(swept.run(point))
        except SphromError as error:
            failed.append(Failure(point, str(error), error.exit_code))
    if records:
        write_part(swept.workspace, records)
    return tuple(failed)


@lru_cache(maxsize=1)
def _swept(task: SweepTask) -> SweptModel:
    """Return the model of tasks that differ in their points alone."""
    # A run that was stopped goes on from its checkpoint, like the sweep as a whole.
    context = StageContext(
        case_of_text(task.case_text, task.case_folder),
        Path(task.out),
        task.force,
        task.threads,
        BriefReporter(),
        resume=not task.force,
        bitwise=True,
    )
    return SweptModel(Workspace(context))


class SweptModel:
    """The model of a sweep, which can be run at any parameter point."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = self._workspace = workspace
        self._model = sweep_model(workspace.case)
        self._probes = Probes(NOWHERE, NOWHERE, (0, 0), stations=probe_places(workspace))
        self._on_points = None
        if self._model is not None and self._model.on_points:
            self._on_points = _OnReferencePoints(workspace, self._model, self._probes)

    def prepare(self, points: Sequence[ParameterPoint]) -> None:
        """Do together what takes less time so, before points are run one by one."""
        if self._on_points is not None:
            self._on_points.prepare(points)

    def run(self, point: ParameterPoint) -> RunRecord:
        """Run the model at a parameter point.

        Raises SphromError when no run can be made there.
        """
        if self._on_points is not None:
            return self._on_points.run(point)
        workspace, model = self._workspace_of(point), self._model
        try:
            if model is None:
                target = fom.ensure_run(workspace, point)
            else:
                target = rom.ensure_run(workspace, model, point)
        except UnstableError as error:
            return RunRecord(point, UNSTABLE, reason=str(error))
        return self._of_trajectory(point, target)

    def _workspace_of(self, point: ParameterPoint) -> Workspace:
        """Return where a run is made: the case's own that are valid stay, even with --force."""
        case, model = self._workspace.case, self._model
        if point in (case.points if model is None else case.rom_points(model)):
            return Workspace(replace(self._workspace.context, keep_valid=True))
        return self._workspace

    def _of_trajectory(self, point: ParameterPoint, target: Target) -> RunRecord:
        """Return the record of a run on particles."""
        with self._workspace.open(target) as trajectory:
            if trajectory.text("status") != "complete":
                return RunRecord(point, UNSTABLE, reason=trajectory.text("status_detail"))
            coordinates = None
            if self._workspace.case.sweep.coordinates and self._model is not None:
                coordinates = trajectory.read("generalized_coordinates")
            energies, speed = _figures(trajectory)
            time, step = trajectory.read("time"), trajectory.number("time_step")
            result = RunResult(time, step, float(energies[-1]), speed, energies, coordinates)
            if len(self._probes.all):
                case = self._workspace.case
                sample = sampler(case, self._probes.all)
                samples = sample_run(case, trajectory, sample, lambda done: None)
                result = _with_samples(result, samples)
            measured = measured_of(self._workspace.case, trajectory)
        result = replace(result, measured=_kept(measured))
        remove_checkpoints(self._workspace, target)
        return RunRecord(point, COMPLETE, result)


def _figures(trajectory: Artifact) -> tuple[Array, float]:
    """Return the kinetic energy (n_snapshots,) [J/m] and the largest speed [m/s]."""
    velocities, mass = trajectory.dataset("velocity"), trajectory.number("mass")
    energies, speeds = [], []
    for k in range(len(velocities)):
        velocity = velocities[k]
        speeds.append(float(np.hypot(*velocity.T).max()))
        energies.append(kinetic_energy(velocity, mass))
    return np.array(energies), max(speeds)


def _kept(measured: Mapping[str, Quantities]) -> dict[str, Quantities]:
    return {name: of_a_run(quantities) for name, quantities in measured.items()}


def _with_samples(result: RunResult, samples: Samples) -> RunResult:
    return replace(result, probe_velocity=samples.velocity, probe_pressure=samples.pressure)


class _OnReferencePoints:
    """A model on the reference points, whose runs share bases and splines."""

    def __init__(self, workspace: Workspace, model: ReducedModelSection, probes: Probes) -> None:
        self._workspace = workspace
        self._model = model
        self._probes = probes
        self._models = ReferenceModels(workspace, model)
        self._estimated: dict[str, Trained] = {}
        self._bounds: dict[str, SpeedBounds] = {}
        self._energies: dict[str, KineticEnergy] = {}
        self._splines: dict[str, ModeSplines] = {}

    def prepare(self, points: Sequence[ParameterPoint]) -> None:
        """Build the models at points."""
        with suppress(SphromError):  # whatever is wrong at a point is for its run to say
            self._models.prepare(points)

    def run(self, point: ParameterPoint) -> RunRecord:
        """Run the model at a parameter point."""
        reduced = self._models.at(point)
        runs = run_once(self._workspace, self._model, point, reduced)
        if (failure := failure_of(runs)) is not None:
            return RunRecord(point, UNSTABLE, reason=str(failure))
        return RunRecord(point, COMPLETE, self._result(point, reduced, runs))

    def _result(self, point: ParameterPoint, reduced: ReferenceModel, runs: Runs) -> RunResult:
        case, coordinates = self._workspace.case, runs.coordinates[0]
        name = case.basis_for(self._model, point)
        if name not in self._bounds:
            self._bounds[name] = SpeedBounds(reduced.basis)
            self._energies[name] = KineticEnergy(reduced.basis, assembly.mass(case))
        energies = self._energies[name].of(coordinates)
        result = RunResult(
            time=runs.time,
            time_step=float(runs.time_step[0]),
            kinetic_energy=float(energies[-1]),
            largest_speed=self._bounds[name].largest(coordinates),
            energies=energies,
            coordinates=coordinates if case.sweep.coordinates else None,
            measured=_kept(quantities_of(case, point, reduced, runs.time, coordinates)),
        )
        if case.sweep.error_estimate:
            result = replace(result, errors=self._errors(point, reduced, runs))
        if case.sweep.sensitivities:
            result = replace(result, derivatives=self._derivatives(point, reduced))
        if len(self._probes.all):
            result = _with_samples(result, self._samples(name, reduced, runs))
        return result

    def _derivatives(self, point: ParameterPoint, reduced: ReferenceModel) -> dict[str, float]:
        """Return the derivatives of the figures at the end of a run, by their columns."""
        case = self._workspace.case
        found = tangents(case, self._models, point, case.parameter_names, reduced)
        columns = {"kinetic_energy": found.kinetic_energy[:, -1]}
        for name, loads in found.forces.items():
            for load, values in zip(LOADS, loads[:, -1].sum(axis=1).T, strict=True):
                columns[f"{name}_{load}"] = values
        for name, section in case.scene.measured_fields.items():
            for quantity in section.quantities:  # of a line there is none
                at_end = found.measured[name][quantity][:, -1]
                at_probe = at_end[:, 0] if quantity in PLACED else at_end
                for component, values in components(quantity, at_probe).items():
                    columns[f"{name}_{component}"] = values
        return {
            f"{column}_by_{parameter}": float(value)
            for column, values in columns.items()
            for parameter, value in zip(found.names, values, strict=True)
        }

    def _errors(
        self, point: ParameterPoint, reduced: ReferenceModel, runs: Runs
    ) -> EstimatedErrors | None:
        """Return the estimated errors of velocity and pressure, over their sizes [%]."""
        if not self._model.from_operators:
            return None
        run = EstimatedRun(self._models, point, reduced, runs)
        found = estimate(self._workspace, run, self._estimated)
        if found is None or found.errors is None:
            return None
        velocity, pressure = 100.0 * shares(found.errors, found.sizes)
        over_time = (found.errors * units_of(self._workspace.case)).T
        return EstimatedErrors(float(velocity), float(pressure), found.extrapolates, over_time)

    def _samples(self, name: str, reduced: ReferenceModel, runs: Runs) -> Samples:
        if name not in self._splines:
            n_modes = sized_in(self._workspace, self._model, name).size
            self._splines[name] = read_model_splines(self._workspace, name, n_modes)
        return expand(
            self._workspace.case,
            reduced.basis,
            self._splines[name],
            self._probes,
            runs.time,
            runs.coordinates[0],
            np.full(len(runs.time), reduced.mean_density_fluctuation),
        )
