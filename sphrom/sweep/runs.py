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
from sphrom.case.studies import sweep_model
from sphrom.console import SilentReporter
from sphrom.errors import SphromError, UnstableError
from sphrom.metrics.measures import PLACED, Quantities, components, of_a_run
from sphrom.metrics.samples import Probes, Samples
from sphrom.metrics.trends import kinetic_energy
from sphrom.offline import fom
from sphrom.online import rom
from sphrom.online.fast_model import FastModel, FastRun
from sphrom.online.sensitivities import tangents
from sphrom.reduction.trial_basis import KineticEnergy, SpeedBounds
from sphrom.setup import assembly
from sphrom.setup.context import StageContext
from sphrom.setup.measured_fields import sampler
from sphrom.store.checkpoints import remove_checkpoints
from sphrom.store.measured_quantities import measured_of
from sphrom.store.sampling import sample_run
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
        SilentReporter(),
        resume=not task.force,
        bitwise=True,
    )
    return SweptModel(Workspace(context))


class SweptModel:
    """The model of a sweep, which can be run at any parameter point."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = self._workspace = workspace
        self._model = sweep_model(workspace.case)
        self._probes = Probes.at(probe_places(workspace))
        self._fast = None
        if self._model is not None and self._model.from_operators:
            self._fast = _FastRuns(FastModel(workspace, self._model), self._probes)

    def prepare(self, points: Sequence[ParameterPoint]) -> None:
        """Do together what takes less time so, before points are run one by one."""
        if self._fast is not None:
            with suppress(SphromError):  # whatever is wrong at a point is for its run to say
                self._fast.model.prepare(points)

    def run(self, point: ParameterPoint) -> RunRecord:
        """Run the model at a parameter point.

        Raises SphromError when no run can be made there.
        """
        if self._fast is not None:
            return self._fast.record(point)
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


class _FastRuns:
    """Runs of a model from operators, which share bases and splines."""

    def __init__(self, model: FastModel, probes: Probes) -> None:
        self.model = model
        self._probes = probes
        self._bounds: dict[str, SpeedBounds] = {}
        self._energies: dict[str, KineticEnergy] = {}

    def record(self, point: ParameterPoint) -> RunRecord:
        """Run the model at a parameter point."""
        run = self.model.run(point)
        if run.failure is not None:
            return RunRecord(point, UNSTABLE, reason=str(run.failure))
        return RunRecord(point, COMPLETE, self._result(run))

    def _result(self, run: FastRun) -> RunResult:
        case, name = self.model.workspace.case, self.model.basis_at(run.point)
        if name not in self._bounds:
            self._bounds[name] = SpeedBounds(run.reduced.basis)
            self._energies[name] = KineticEnergy(run.reduced.basis, assembly.mass(case))
        energies = self._energies[name].of(run.coordinates)
        result = RunResult(
            time=run.time,
            time_step=run.time_step,
            kinetic_energy=float(energies[-1]),
            largest_speed=self._bounds[name].largest(run.coordinates),
            energies=energies,
            coordinates=run.coordinates if case.sweep.coordinates else None,
            measured=_kept(run.measured),
        )
        if case.sweep.error_estimate and (found := run.estimate) is not None:
            velocity, pressure = map(float, found.percent)
            over_time = found.velocity_and_pressure.T
            errors = EstimatedErrors(velocity, pressure, found.extrapolates, over_time)
            result = replace(result, errors=errors)
        if case.sweep.sensitivities:
            result = replace(result, derivatives=self._derivatives(run))
        if len(self._probes.all):
            result = _with_samples(result, run.sampled(self._probes))
        return result

    def _derivatives(self, run: FastRun) -> dict[str, float]:
        """Return the derivatives of the figures at the end of a run, by their columns."""
        case = self.model.workspace.case
        found = tangents(self.model, run.point, case.parameter_names, run.reduced)
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
