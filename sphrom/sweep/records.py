"""The runs of a sweep as records, written to an artifact and read back.

A part of a sweep, with the runs of one task, and the whole of it have the same schema: what is kept
of a run does not depend on the runs that it was made with.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import SCHEMAS, Artifact, ArtifactWriter, write_record
from sphrom.artifacts.records.sweep import Statistics
from sphrom.case.points import ParameterPoint
from sphrom.case.studies import sweep_model, sweep_name
from sphrom.case.study_sections import FULL
from sphrom.errors import ArtifactError
from sphrom.store.workspace import Target, Workspace

Array = NDArray[np.float64]

COMPLETE, UNSTABLE, FAILED, NOT_RUN = 0, 1, 2, 3
STATES = ("complete", "unstable", "failed", "not run")
"""Words for them."""
ERROR = "error_estimate/"
"""Prefix of the datasets of error estimates, which not all runs have."""


@dataclass(frozen=True)
class RunRecord:
    """One run of a sweep: its values, or why there are none."""

    point: ParameterPoint
    status: int
    reason: str = ""
    values: Mapping[str, Any] = field(default_factory=dict)
    """Of a complete run, by the names of datasets of a sweep, such as `probes/velocity`."""
    derivative_names: tuple[str, ...] = ()
    """Of its value `derivatives`."""


def write_records(
    artifact: ArtifactWriter,
    model: str,
    records: Sequence[RunRecord],
    places: Array,
    statistics: Statistics | None = None,
) -> None:
    """Write runs of a model in their order; `places` (n_probes, 2) [m] are those of the probes."""
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
    if len(places):
        artifact.write("probes/position", places)
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
    values: dict[int, dict[str, Any]] = {
        k: {"time": artifact.read("time")} for k in numbers["complete_run"]
    }
    for name in artifact.datasets:
        described = SCHEMAS["sphrom/sweep"].dataset(name)
        axis = "" if described is None else described.axes[0]
        if axis in numbers and name not in ("complete", f"{ERROR}run"):
            for k, value in zip(numbers[axis], artifact.read(name), strict=True):
                values[k][name] = value
    names = str(artifact.attributes.get("derivative_names", ""))
    points = read_points(artifact, range(len(STATES)))
    return [
        RunRecord(
            point,
            status,
            str(artifact.attributes.get(f"failures/{k}", "")),
            values.get(k, {}),
            tuple(names.split(",")) if names and k in values else (),
        )
        for k, (point, status) in enumerate(
            zip(points, artifact.read("status").tolist(), strict=True)
        )
    ]


def probe_places(workspace: Workspace) -> Array:
    """Return where a sweep keeps velocity and pressure (n_probes, 2) [m]."""
    return np.array(workspace.case.sweep.probes, dtype=float).reshape(-1, 2)


def require_folder(workspace: Workspace) -> None:
    """Raise ArtifactError when somebody has removed the folder of the artifacts meanwhile."""
    if not workspace.out.is_dir():
        raise ArtifactError(f"{workspace.out} was removed while the sweep ran")


def parts_folder(workspace: Workspace) -> Path:
    """Return the folder of the parts of a sweep."""
    return workspace.out / f"sweep-{sweep_name(workspace.case)}"


def write_part(workspace: Workspace, records: Sequence[RunRecord]) -> None:
    """Write a part, named by its points: made with the same and from the same as the whole."""
    require_folder(workspace)
    text = "\n".join(record.point.label for record in records)
    name = f"part-{hashlib.sha256(text.encode()).hexdigest()[:16]}.h5"
    path = parts_folder(workspace) / name
    write_sweep(workspace, replace(workspace.sweep(), path=path), records)


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
        write_records(artifact, name, records, probe_places(workspace), statistics)
