"""The runs of a sweep: one model at one parameter point after the other, and their records.

A run is the one that the stage of its model makes, to the last bit. Full runs, and reduced ones on
particles, write their trajectories as those stages do; those on the reference points write nothing.
The records of a task become a part on disk, which is there as a whole or not at all.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import SCHEMAS, Artifact, ArtifactWriter, write_record
from sphrom.artifacts.records.sweep import Statistics
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import sweep_model, sweep_name
from sphrom.case.study_sections import FULL
from sphrom.errors import ArtifactError, SphromError, UnstableError
from sphrom.metrics.measures import PLACED, Quantities, components, of_a_run
from sphrom.metrics.series import kinetic_energy
from sphrom.offline import fom
from sphrom.online import rom
from sphrom.online.fast_model import FastRun, fast_model
from sphrom.online.sensitivities import tangents
from sphrom.online.surface_model import SurfaceRun
from sphrom.store.checkpoints import remove_checkpoints
from sphrom.store.trajectory import field_datasets, measured_of
from sphrom.store.workspace import Target, Workspace
from sphrom.sweep.workers import Failure, Task

COMPLETE, UNSTABLE, FAILED, NOT_RUN = 0, 1, 2, 3
STATES = ("complete", "unstable", "failed", "not run")
"""Words for them."""
PLACE = "place"
"""Where the point of a run is among others."""
ERROR = "error_estimate/"
"""Prefix of the datasets of error estimates, which not all runs have."""


@dataclass(frozen=True)
class RunRecord:
    """One run of a sweep: its values, or why there are none."""

    point: ParameterPoint
    status: int
    reason: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Of a complete run, by the names of datasets of a sweep, such as `time_step`."""
    derivative_names: tuple[str, ...] = ()
    """Of its value `derivatives`."""


def make_runs(task: Task) -> tuple[Failure, ...]:
    """Make the runs of a task, write those that were made, and return why others weren't."""
    swept = _swept(replace(task, points=()))
    records: list[RunRecord] = []
    failed: list[Failure] = []
    for point in task.points:
        require_folder(swept.workspace)
        try:
            records.append(swept.run(point))
        except SphromError as error:
            failed.append(Failure(point, str(error), type(error)))
    if records:
        require_folder(swept.workspace)
        # A part is named by its points: it is made with the same and from the same as the whole.
        text = "\n".join(record.point.label for record in records)
        name = f"part-{hashlib.sha256(text.encode()).hexdigest()[:16]}.h5"
        path = parts_folder(swept.workspace) / name
        write_sweep(swept.workspace, replace(swept.workspace.sweep(), path=path), records)
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
        self._fast = None
        if self._model is not None and self._model.from_operators:
            self._fast = fast_model(workspace, self._model)

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

    def in_training(self, points: Sequence[ParameterPoint]) -> list[dict[str, Any]]:
        """Return by what the training runs of models at points differ from full ones.

        They are values as records have them, with the places of their points; none without
        estimates.
        """
        if self._fast is None:
            return []
        found = self._fast.trained_differences(points)
        return [{PLACE: place} | _kept(differences) for place, differences in found]

    def _of_trajectory(self, point: ParameterPoint, target: Target) -> RunRecord:
        """Return the record of a run on particles."""
        with self.workspace.open(target) as trajectory:
            if trajectory.text("status") != "complete":
                return RunRecord(point, UNSTABLE, trajectory.text("status_detail"))
            velocities, mass = trajectory.dataset("velocity"), trajectory.number("mass")
            speed = max(float(np.hypot(*velocity.T).max()) for velocity in velocities)
            energies = np.array([kinetic_energy(velocity, mass) for velocity in velocities])
            step = trajectory.number("time_step")
            values = _values(trajectory.read("time"), step, energies, speed)
            if self._model is not None:
                values["generalized_coordinates"] = trajectory.read("generalized_coordinates")
            values |= _kept(measured_of(self.workspace.case, trajectory))
        remove_checkpoints(target)
        return RunRecord(point, COMPLETE, values=values)

    def _of_fast(self, run: FastRun | SurfaceRun) -> RunRecord:
        """Return the record of a run of a model from operators."""
        if run.failure is not None:
            return RunRecord(run.point, UNSTABLE, str(run.failure))
        values = _values(run.time, run.time_step, run.kinetic_energy, run.largest_speed)
        values["generalized_coordinates"] = run.coordinates
        if (found := run.estimate) is not None:
            values |= {
                f"{ERROR}velocity": found.velocity_percent,
                f"{ERROR}pressure": found.pressure_percent,
                f"{ERROR}extrapolated": int(found.extrapolated),
                f"{ERROR}velocity_over_time": found.velocity,
                f"{ERROR}pressure_over_time": found.pressure,
            }
        values |= _kept(run.measured)
        derivatives: dict[str, float] = {}
        if isinstance(run, FastRun) and self.workspace.case.sweep.sensitivities:
            derivatives = _derivatives(run)
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
    return field_datasets({name: of_a_run(quantities) for name, quantities in measured.items()})


def _derivatives(run: FastRun) -> dict[str, float]:
    """Return the derivatives of the figures at the end of a run, by their columns."""
    case = run.model.workspace.case
    found = tangents(run.model, run.point, case.plan.parameter_names, run.reduced)
    columns = {"kinetic_energy": found.kinetic_energy[:, -1]}
    for name, section in case.scene.measure.items():
        for quantity in section.quantities:  # of a line there is none
            at_end = found.measured[name][quantity][:, -1]
            at_end = at_end[:, 0] if quantity in PLACED else at_end
            columns |= {f"{name}_{c}": v for c, v in components(quantity, at_end).items()}
    return {
        f"{column}_by_{parameter}": float(value)
        for column, values in columns.items()
        for parameter, value in zip(found.parameters, values, strict=True)
    }


def write_records(
    artifact: ArtifactWriter,
    model: str,
    records: Sequence[RunRecord],
    statistics: Statistics | None = None,
) -> None:
    """Write runs of a model in their order."""
    artifact.annotate("model", model)
    artifact.annotate("parameter_names", ",".join(records[0].point.as_dict()))
    artifact.write("parameters", np.array([[*r.point.as_dict().values()] for r in records]))
    artifact.write("status", np.array([record.status for record in records], dtype=np.int64))
    for k, record in enumerate(records):
        if record.reason:
            artifact.annotate(f"failures/{k}", record.reason)
    if statistics is not None:
        write_record(artifact, statistics, "statistics")
    complete = [k for k, record in enumerate(records) if record.values]
    estimated = [k for k in complete if f"{ERROR}velocity" in records[k].values]
    artifact.write("complete", np.array(complete, dtype=np.int64))
    if not complete:
        for name in ("time_step", "kinetic_energy", "largest_speed"):
            artifact.write(name, np.zeros(0))
        return
    first = records[complete[0]]
    if first.derivative_names:
        artifact.annotate("derivative_names", ",".join(first.derivative_names))
    artifact.write("time", first.values["time"])
    if estimated:
        artifact.write(f"{ERROR}run", np.array(estimated, dtype=np.int64))
    for name in records[(estimated or complete)[0]].values:
        if name != "time":
            those = estimated if name.startswith(ERROR) else complete
            artifact.write(name, np.stack([records[k].values[name] for k in those]))


def read_points(
    artifact: Artifact, states: Sequence[int] = (COMPLETE, UNSTABLE)
) -> list[ParameterPoint]:
    """Return the points of the runs that ended in one of some ways."""
    names = artifact.text("parameter_names").split(",")
    rows = artifact.read("parameters")[np.isin(artifact.read("status"), states)].tolist()
    return [ParameterPoint(row[0], tuple(zip(names[1:], row[1:], strict=True))) for row in rows]


def read_records(artifact: Artifact) -> list[RunRecord]:
    """Read all runs of an artifact."""
    numbers = {"complete_run": artifact.read("complete").tolist()}
    if f"{ERROR}run" in artifact:
        numbers["estimated_run"] = artifact.read(f"{ERROR}run").tolist()
    time = artifact.read("time") if numbers["complete_run"] else None
    values: dict[int, dict[str, Any]] = {k: {"time": time} for k in numbers["complete_run"]}
    for name in artifact.datasets:
        described = SCHEMAS["sphrom/sweep"].dataset(name)
        axis = "" if described is None else described.axes[0]
        if axis in numbers and name not in ("complete", f"{ERROR}run"):
            for k, value in zip(numbers[axis], artifact.read(name), strict=True):
                values[k][name] = value
    names = tuple(filter(None, str(artifact.attributes.get("derivative_names", "")).split(",")))
    points, found = read_points(artifact, range(len(STATES))), list[RunRecord]()
    for k, status in enumerate(artifact.read("status").tolist()):
        reason = str(artifact.attributes.get(f"failures/{k}", ""))
        derived = names if k in values else ()
        found.append(RunRecord(points[k], status, reason, values.get(k, {}), derived))
    return found


def require_folder(workspace: Workspace) -> None:
    """Raise ArtifactError when somebody has removed the folder of the artifacts meanwhile."""
    if not workspace.out.is_dir():
        raise ArtifactError(f"{workspace.out} was removed while the sweep ran")


def parts_folder(workspace: Workspace) -> Path:
    """Return the folder of the parts of a sweep."""
    return workspace.out / f"sweep-{sweep_name(workspace.case)}"


def write_sweep(
    workspace: Workspace,
    target: Target,
    records: Sequence[RunRecord],
    statistics: Statistics | None = None,
) -> None:
    """Write runs of a sweep, over an earlier file."""
    model = sweep_model(workspace.case)
    over = Workspace(replace(workspace.context, force=True))
    with over.create(target) as artifact:
        name = FULL if model is None else model.name
        write_records(artifact, name, records, statistics)
