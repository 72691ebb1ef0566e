"""The runs of a sweep (one model at many parameter points), and their records.

A run is bit for bit equal to the run of its model's stage. Full runs, and reduced runs on
particles, write trajectories as in those stages; runs on the reference points write none. The
records of a task are written as one part, which is complete or absent.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import SCHEMAS, Artifact, ArtifactWriter, write_record
from sphrom.artifacts.records.sweep import Statistics
from sphrom.case.models import Case
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import sweep_model, sweep_name
from sphrom.case.study_sections import FULL
from sphrom.errors import ArtifactError, SphromError, UnstableError
from sphrom.metrics.measures import Quantities, of_a_run
from sphrom.metrics.quantities import PLACED, components
from sphrom.metrics.series import ESTIMATED, REGIMES
from sphrom.models import fom, stages
from sphrom.models.contract import Ability, ModelRun, family_of, model_of
from sphrom.models.stored_run import StoredRun
from sphrom.setup.context import StageContext
from sphrom.setup.cost import runs_that_fit
from sphrom.store.checkpoints import remove_checkpoints
from sphrom.store.tasks import Failure, Task
from sphrom.store.trajectory import field_datasets, measured_of
from sphrom.store.workspace import Target, Workspace
from sphrom.text import counted

LARGEST_BATCH, SMALLEST_BATCH = 1000, 50
"""Limits of the runs on the reference points in one task; fewer end before a process starts."""
COMPLETE, UNSTABLE, FAILED, NOT_RUN = 0, 1, 2, 3
STATES = ("complete", "unstable", "failed", "not run")
"""The words for the statuses."""
REGIME = "regime"
"""Key of a run's regime, an index of REGIMES."""
MISSED = "missed/"
"""Prefix of the keys of errors of measurements that are due to the basis, in training runs."""
ERROR = "error_estimate/"
"""Prefix of the datasets of error estimates, which some runs lack."""
OVER_TIME = f"{ERROR}velocity_over_time", f"{ERROR}pressure_over_time"
"""Names of the estimated errors of the fields."""
INDICES = {"complete_run": "complete", "estimated_run": f"{ERROR}run"}
"""Datasets with the indices of the runs that have certain data, by the first axis of the data."""
MEASURED_ERRORS = f"{ERROR}measured", f"{ERROR}change"
OSCILLATION_ERRORS = f"{ERROR}oscillations"


@dataclass(frozen=True)
class RunRecord:
    """One run of a sweep: its values, and the reason why it has none or is doubtful."""

    point: ParameterPoint
    status: int
    reason: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Values of a complete run, by the names of datasets of a sweep, such as `time_step`."""
    derivative_names: tuple[str, ...] = ()
    """Names of the entries of its value `derivatives`."""


def make_runs(task: Task) -> tuple[Failure, ...]:
    """Make the runs of a task, write their records, and return the failures."""
    swept = _swept(replace(task, points=()))
    records: list[RunRecord] = []
    failed: list[Failure] = []
    swept.prepare(task.points)
    for point in task.points:
        require_folder(swept.workspace)
        try:
            records.append(swept.run(point))
        except SphromError as error:
            failed.append(Failure(point, str(error), type(error)))
    if records:
        require_folder(swept.workspace)
        # A part is named by its points, and has the inputs of the whole sweep.
        text = "\n".join(record.point.label for record in records)
        name = f"part-{hashlib.sha256(text.encode()).hexdigest()[:16]}.h5"
        path = parts_folder(swept.workspace) / name
        write_sweep(swept.workspace, replace(swept.workspace.sweep(), path=path), records)
    return tuple(failed)


@lru_cache(maxsize=1)
def _swept(task: Task) -> SweptModel:
    """Return the model for tasks that differ only in their points."""
    # A stopped run continues from its checkpoint, as the sweep continues.
    return SweptModel(Workspace(task.context()))


def runs_alone(case: Case) -> bool:
    """Return whether the runs of a case's sweep take no particles, and little time."""
    model = sweep_model(case)
    return model is not None and family_of(case, model).can(Ability.RUNS_ALONE)


def number_of_workers(context: StageContext, n_runs: int) -> int:
    """Return the number of processes of this machine for so many runs of a sweep."""
    case = context.case
    # A task has many runs from operators, because these are short.
    n_tasks = math.ceil(n_runs / (SMALLEST_BATCH if runs_alone(case) else 1))
    fitting = runs_that_fit(case, "fom" if sweep_model(case) is None else "rom")
    return min(context.workers or fitting, n_tasks)


class SweptModel:
    """The model of a sweep, at any parameter point."""

    def __init__(self, workspace: Workspace) -> None:
        self.workspace = workspace
        self._model = sweep_model(workspace.case)
        self._fast = None
        self._together: Iterator[ModelRun] = iter(())
        if runs_alone(workspace.case):
            assert self._model is not None
            self._fast = model_of(workspace, self._model)

    def prepare(self, points: Sequence[ParameterPoint]) -> None:
        """Let runs of a model from operators at points, in this order, share their arrays."""
        if self._fast is not None:
            self._together = self._fast.runs(points)

    def run(self, point: ParameterPoint) -> RunRecord:
        """Run the model at a parameter point.

        Raises SphromError when the run fails.
        """
        if self._fast is not None:
            made = None
            with suppress(SphromError):  # if one run fails, the others are made one by one
                made = next(self._together, None)
            if made is None or made.point != point:
                made = self._fast.run(point)
            return self._of_fast(made)
        case = self.workspace.case
        model = self._model
        # Valid runs of the case itself are kept, even with --force.
        of_case = case.plan.points if model is None else case.plan.rom_points(model)
        workspace = Workspace(replace(self.workspace.context, keep_valid=point in of_case))
        try:
            if model is None:
                target = fom.ensure_run(workspace, point)
            else:
                target = stages.ensure_run(workspace, model, point)
        except UnstableError as error:
            return RunRecord(point, UNSTABLE, str(error))
        return self._of_trajectory(point, target)

    def in_training(self, points: Sequence[ParameterPoint]) -> list[dict[str, Any]]:
        """Return the errors of training runs, for the bases of models at points.

        Each has values by the names of a run's record, and by `MISSED` those due to the basis. The
        list is empty if the case has no error estimates.
        """
        if self._fast is None:
            return []
        rows: list[dict[str, Any]] = []
        for each in self._fast.trained_differences(points):
            errors = dict(zip(OVER_TIME, each.fields.T, strict=True))
            at_once: dict[str, Quantities] = {
                n: {q: v[None] for q, v in m.items()} for n, m in each.missed.items()
            }
            missed = {f"{MISSED}{path}": v for path, v in _kept(at_once).items()}
            rows.append(_kept(each.measured) | errors | missed)
        return rows

    def _of_trajectory(self, point: ParameterPoint, target: Target) -> RunRecord:
        """Return the record of a run on particles."""
        with self.workspace.open(target) as trajectory:
            if trajectory.text("status") != "complete":
                return RunRecord(point, UNSTABLE, trajectory.text("status_detail"))
            run = StoredRun.of(self.workspace, trajectory, point, self._model)
            step = trajectory.number("time_step")
            values = _values(run.time, step, run.kinetic_energy, run.largest_speed)
            if self._model is not None:
                values["generalized_coordinates"] = trajectory.read("generalized_coordinates")
            values |= _kept(measured_of(self.workspace.case, trajectory))
        remove_checkpoints(target)
        return RunRecord(point, COMPLETE, values=values)

    def _of_fast(self, run: ModelRun) -> RunRecord:
        """Return the record of a run of a model from operators."""
        if run.failure is not None:
            return RunRecord(run.point, UNSTABLE, str(run.failure))
        values = _values(run.time, run.time_step, run.kinetic_energy, run.largest_speed)
        values["generalized_coordinates"] = run.coordinates
        if (estimate := run.estimate) is not None:
            values |= {
                f"{ERROR}velocity": estimate.velocity_percent,
                f"{ERROR}pressure": estimate.pressure_percent,
                f"{ERROR}extrapolated": int(estimate.extrapolated),
            }
            values |= zip(OVER_TIME, (estimate.velocity, estimate.pressure), strict=True)
            if columns := self.workspace.case.scene.columns:
                found = run.measured_sizes
                pairs = [found.get(column, (0.0, 0.0)) for column in columns]
                values |= zip(MEASURED_ERRORS, np.sqrt(pairs).T, strict=True)
            errors = run.oscillation_errors
            if errors and errors.keys() == self.workspace.case.plan.oscillations.keys():
                rows = [[each.get(f, 0.0) for f in ESTIMATED] for each in errors.values()]
                values[OSCILLATION_ERRORS] = np.array(rows)
        values |= _kept(run.measured)
        derivatives: dict[str, float] = {}
        has_slopes = run.model.family.can(Ability.SENSITIVITIES)
        if has_slopes and self.workspace.case.sweep.sensitivities:
            derivatives = _derivatives(run)
            values["derivatives"] = np.array([*derivatives.values()])
        if run.regime is not None:
            values[REGIME] = REGIMES.index(run.regime)
        doubts = "; ".join(run.unlike_training)
        return RunRecord(run.point, COMPLETE, doubts, values, tuple(derivatives))


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


def _derivatives(run: ModelRun) -> dict[str, float]:
    """Return the derivatives of the figures at the end of a run, by column."""
    case = run.model.workspace.case
    slopes = run.model.tangents(run.point, case.plan.parameter_names, run.reduced)
    columns = {"kinetic_energy": slopes.kinetic_energy[:, -1]}
    for name, section in case.scene.measure.items():
        for quantity in section.quantities:  # empty for lines
            at_end = slopes.measured[name][quantity][:, -1]
            at_end = at_end[:, 0] if quantity in PLACED else at_end
            columns |= {f"{name}_{c}": v for c, v in components(quantity, at_end).items()}
    return {
        f"{column}_by_{parameter}": float(value)
        for column, values in columns.items()
        for parameter, value in zip(slopes.parameters, values, strict=True)
    }


def write_records(
    artifact: ArtifactWriter,
    model: str,
    records: Sequence[RunRecord],
    statistics: Statistics | None = None,
) -> None:
    """Write the records of runs of a model in order."""
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
            rows = estimated if name.startswith(ERROR) else complete
            artifact.write(name, np.stack([records[k].values[name] for k in rows]))


def read_points(
    artifact: Artifact, states: Sequence[int] = (COMPLETE, UNSTABLE)
) -> list[ParameterPoint]:
    """Return the points of the runs with one of some statuses."""
    names = artifact.text("parameter_names").split(",")
    rows = artifact.read("parameters")[np.isin(artifact.read("status"), states)].tolist()
    return [ParameterPoint(row[0], tuple(zip(names[1:], row[1:], strict=True))) for row in rows]


def read_outcomes(artifact: Artifact) -> list[RunRecord]:
    """Read the points, statuses and reasons of all runs of an artifact, without their values."""
    points = read_points(artifact, range(len(STATES)))
    reasons = [str(artifact.attributes.get(f"failures/{k}", "")) for k in range(len(points))]
    runs = zip(points, artifact.read("status").tolist(), reasons, strict=True)
    return [RunRecord(at, status, reason) for at, status, reason in runs]


def read_records(artifact: Artifact) -> list[RunRecord]:
    """Read all runs of an artifact."""
    outcomes = read_outcomes(artifact)
    values: list[dict[str, Any]] = [{} for _ in outcomes]
    indices = {axis: path for axis, path in INDICES.items() if path in artifact}
    rows = {axis: artifact.read(path).tolist() for axis, path in indices.items()}
    time = artifact.read("time") if rows["complete_run"] else None
    for k in rows["complete_run"]:
        values[k]["time"] = time
    for name in artifact.datasets:
        described = SCHEMAS["sphrom/sweep"].dataset(name)
        axis = "" if described is None else described.axes[0]
        if axis in rows and name != indices[axis]:
            for k, value in zip(rows[axis], artifact.read(name), strict=True):
                values[k][name] = value
    names = tuple(filter(None, str(artifact.attributes.get("derivative_names", "")).split(",")))
    return [
        replace(run, values=found, derivative_names=names if found else ())
        for run, found in zip(outcomes, values, strict=True)
    ]


def doubts_in_words(runs: Sequence[RunRecord]) -> str | None:
    """Return the number of doubtful runs, with one of them, or None if there is none."""
    doubtful = [run for run in runs if run.status == COMPLETE and run.reason]
    if not doubtful:
        return None
    first = doubtful[0]
    number = f"{len(doubtful)} of {counted(len(runs), 'run')} are doubtful"
    return f"{number}, such as {first.point.rounded.label}: {first.reason}"


def require_folder(workspace: Workspace) -> None:
    """Raise ArtifactError when the folder of the artifacts was removed during the sweep."""
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
    """Write the records of a sweep, replacing an earlier file."""
    model = sweep_model(workspace.case)
    with workspace.create(target, over=True) as artifact:
        name = FULL if model is None else model.name
        write_records(artifact, name, records, statistics)
