"""The runs of a sweep: one model at one parameter point after the other, and their records.

A run is the one that the stage of its model makes, to the last bit. Full runs, and reduced ones on
particles, write their trajectories as those stages do; those on the reference points write nothing.
The records of a task become a part on disk, which is there as a whole or not at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.case.points import ParameterPoint
from sphrom.case.studies import sweep_model
from sphrom.errors import SphromError, UnstableError
from sphrom.metrics.measures import PLACED, Quantities, components, of_a_run
from sphrom.metrics.samples import Probes, Samples
from sphrom.metrics.series import kinetic_energy
from sphrom.offline import fom
from sphrom.online import rom
from sphrom.online.fast_model import FastModel, FastRun
from sphrom.online.sensitivities import tangents
from sphrom.reduction.trial_basis import KineticEnergy, SpeedBounds
from sphrom.store.checkpoints import remove_checkpoints
from sphrom.store.measured_quantities import measured_of
from sphrom.store.sampling import sample_run
from sphrom.store.workspace import Target, Workspace
from sphrom.sweep.records import (
    COMPLETE,
    ERROR,
    UNSTABLE,
    RunRecord,
    probe_places,
    require_folder,
    write_part,
)
from sphrom.sweep.workers import Failure, Task

Array = NDArray[np.float64]

LOADS = ("force_x", "force_y", "torque")
"""What columns call the loads on a wall."""
TOGETHER = 64
"""Models that are built together."""


def make_runs(task: Task) -> tuple[Failure, ...]:
    """Make the runs of a task, write those that were made, and return why others weren't."""
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
def _swept(task: Task) -> SweptModel:
    """Return the model of tasks that differ in their points alone."""
    # A run that was stopped goes on from its checkpoint, like the sweep as a whole.
    return SweptModel(Workspace(task.context(resume=not task.force)))


class SweptModel:
    """The model of a sweep, which can be run at any parameter point."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self._model = sweep_model(workspace.case)
        self._probes = Probes.at(probe_places(workspace))
        self._fast = None
        if self._model is not None and self._model.from_operators:
            self._fast = FastModel(workspace, self._model)
        self._of_bases: dict[str, tuple[SpeedBounds, KineticEnergy]] = {}

    def prepare(self, points: Sequence[ParameterPoint]) -> None:
        """Do together what takes less time so, before points are run one by one."""
        if self._fast is not None:
            with suppress(SphromError):  # whatever is wrong at a point is for its run to say
                self._fast.prepare(points)

    def run(self, point: ParameterPoint) -> RunRecord:
        """Run the model at a parameter point.

        Raises SphromError when no run can be made there.
        """
        if self._fast is not None:
            return self._of_fast(self._fast.run(point))
        case, model = self.workspace.case, self._model
        # The case's own runs that are valid stay, even with --force.
        own = point in (case.plan.points if model is None else case.plan.rom_points(model))
        workspace = Workspace(replace(self.workspace.context, keep_valid=own))
        try:
            if model is None:
                target = fom.ensure_run(workspace, point)
            else:
                target = rom.ensure_run(workspace, model, point)
        except UnstableError as error:
            return RunRecord(point, UNSTABLE, str(error))
        return self._of_trajectory(point, target)

    def _of_trajectory(self, point: ParameterPoint, target: Target) -> RunRecord:
        """Return the record of a run on particles."""
        case = self.workspace.case
        with self.workspace.open(target) as trajectory:
            if trajectory.text("status") != "complete":
                return RunRecord(point, UNSTABLE, trajectory.text("status_detail"))
            velocities, mass = trajectory.dataset("velocity"), trajectory.number("mass")
            speed = max(float(np.hypot(*velocity.T).max()) for velocity in velocities)
            energies = np.array([kinetic_energy(velocity, mass) for velocity in velocities])
            step = trajectory.number("time_step")
            values = _values(trajectory.read("time"), step, energies, speed)
            if case.sweep.coordinates and self._model is not None:
                values["generalized_coordinates"] = trajectory.read("generalized_coordinates")
            if len(self._probes.all):
                values |= _at_probes(sample_run(case, trajectory, self._probes.all))
            values |= _kept(measured_of(case, trajectory))
        remove_checkpoints(self.workspace, target)
        return RunRecord(point, COMPLETE, values=values)

    def _of_fast(self, run: FastRun) -> RunRecord:
        """Return the record of a run of a model from operators."""
        if run.failure is not None:
            return RunRecord(run.point, UNSTABLE, str(run.failure))
        sweep, basis = self.workspace.case.sweep, run.reduced.basis
        name = run.model.basis_at(run.point)
        if name not in self._of_bases:
            energy = KineticEnergy(basis, self.workspace.case.plan.mass)
            self._of_bases[name] = SpeedBounds(basis), energy
        bounds, energy = self._of_bases[name]
        energies, speed = energy.of(run.coordinates), bounds.largest(run.coordinates)
        values = _values(run.time, run.time_step, energies, speed)
        if sweep.coordinates:
            values["generalized_coordinates"] = run.coordinates
        if sweep.error_estimate and (found := run.estimate) is not None:
            velocity, pressure = found.velocity_and_pressure.T
            values |= {
                f"{ERROR}velocity": float(found.percent[0]),
                f"{ERROR}pressure": float(found.percent[1]),
                f"{ERROR}extrapolated": int(found.extrapolates),
                f"{ERROR}velocity_over_time": velocity,
                f"{ERROR}pressure_over_time": pressure,
            }
        if len(self._probes.all):
            values |= _at_probes(run.sampled(self._probes))
        values |= _kept(run.measured)
        derivatives = _derivatives(run) if sweep.sensitivities else {}
        if derivatives:
            values["derivatives"] = np.array([*derivatives.values()])
        return RunRecord(run.point, COMPLETE, "", values, tuple(derivatives))


def _values(time: Array, step: float, energies: Array, speed: float) -> dict[str, Any]:
    return {
        "time": time,
        "time_step": step,
        "kinetic_energy": float(energies[-1]),
        "largest_speed": speed,
        "kinetic_energy_over_time": energies,
    }


def _kept(measured: dict[str, Quantities]) -> dict[str, Array]:
    return {
        f"measure/{name}/{quantity}": values
        for name, quantities in measured.items()
        for quantity, values in of_a_run(quantities).items()
    }


def _at_probes(samples: Samples) -> dict[str, Array]:
    return {"probes/velocity": samples.velocity, "probes/pressure": samples.pressure}


def _derivatives(run: FastRun) -> dict[str, float]:
    """Return the derivatives of the figures at the end of a run, by their columns."""
    case = run.model.workspace.case
    found = tangents(run.model, run.point, case.plan.parameter_names, run.reduced)
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
        for parameter, value in zip(found.parameters, values, strict=True)
    }
