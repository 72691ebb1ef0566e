"""The runs of a sweep as records, written to an artifact and read back.

A part of a sweep and the whole of it have the same schema: what is kept of a run does not depend on
the runs that it was made with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter
from sphrom.case.points import ParameterPoint
from sphrom.reduction.error_calibration import FIELDS

Array = NDArray[np.float64]

COMPLETE, UNSTABLE, FAILED, NOT_RUN = 0, 1, 2, 3
STATES = ("complete", "unstable", "failed", "not run")
"""Words for them."""
_FIGURES = ("time_step", "kinetic_energy", "largest_speed")
_SERIES = ("generalized_coordinates", "probes/velocity", "probes/pressure")


@dataclass(frozen=True)
class EstimatedErrors:
    """Root mean squares over a run, over those of the fields [%]."""

    velocity: float
    pressure: float
    extrapolated: bool
    """Whether the run is outside of what its model was trained on."""


@dataclass(frozen=True)
class RunResult:
    """What is kept of a run that is complete."""

    time: Array
    """(n_snapshots,) [s]."""
    time_step: float
    """[s]."""
    kinetic_energy: float
    """At the end [J/m]."""
    largest_speed: float
    """Of all points and snapshots [m/s]."""
    coordinates: Array | None = None
    """(n_snapshots, n_modes)."""
    probe_velocity: Array | None = None
    """(n_snapshots, n_probes, 2) [m/s]."""
    probe_pressure: Array | None = None
    """(n_snapshots, n_probes) [Pa]."""
    errors: EstimatedErrors | None = None
    """Estimated."""


@dataclass(frozen=True)
class RunRecord:
    """One run of a sweep: its result, or why there is none."""

    point: ParameterPoint
    status: int
    result: RunResult | None = None
    reason: str = ""


def write_records(
    artifact: ArtifactWriter, model: str, records: Sequence[RunRecord], places: Array
) -> None:
    """Write runs of a model in their order; `places` (n_probes, 2) [m] are those of the probes."""
    artifact.annotate("model", model)
    artifact.annotate("parameter_names", ",".join(records[0].point.as_dict()))
    artifact.write("parameters", np.array([list(r.point.as_dict().values()) for r in records]))
    artifact.write("status", np.array([record.status for record in records], dtype=np.int64))
    for number, record in enumerate(records):
        if record.reason:
            artifact.annotate(f"failures/{number}", record.reason)
    complete = {k: r.result for k, r in enumerate(records) if r.result is not None}
    artifact.write("complete", np.array(list(complete), dtype=np.int64))
    results = list(complete.values())
    for name in _FIGURES:
        artifact.write(name, np.array([getattr(result, name) for result in results], dtype=float))
    if not results:
        return
    artifact.write("time", results[0].time)
    _write_stacked(artifact, "generalized_coordinates", [r.coordinates for r in results])
    if len(places):
        artifact.write("probes/position", places)
        _write_stacked(artifact, "probes/velocity", [r.probe_velocity for r in results])
        _write_stacked(artifact, "probes/pressure", [r.probe_pressure for r in results])
    estimated = {k: r.errors for k, r in complete.items() if r.errors is not None}
    if estimated:
        artifact.write("error_estimate/run", np.array(list(estimated), dtype=np.int64))
        for name in FIELDS:
            values = [getattr(errors, name) for errors in estimated.values()]
            artifact.write(f"error_estimate/{name}", np.array(values))
        outside = [int(errors.extrapolated) for errors in estimated.values()]
        artifact.write("error_estimate/extrapolated", np.array(outside, dtype=np.int64))


def _write_stacked(artifact: ArtifactWriter, name: str, arrays: Sequence[Array | None]) -> None:
    """Write arrays of all runs one after the other, if runs have them."""
    first = arrays[0]
    if first is None:
        return
    stream = artifact.stream(name, first.shape, len(arrays))
    for array in arrays:
        stream.append(np.asarray(array))


def read_points(
    artifact: Artifact, states: Sequence[int] = (COMPLETE, UNSTABLE)
) -> list[ParameterPoint]:
    """Return the points of the runs that ended in one of some ways."""
    chosen = np.isin(artifact.read("status"), states)
    return [_point(values) for values in artifact.read("parameters")[chosen]]


def _point(values: Array) -> ParameterPoint:
    return ParameterPoint(*map(float, values))


def read_records(artifact: Artifact) -> list[RunRecord]:
    """Read all runs of an artifact."""
    results = dict(zip(artifact.read("complete").tolist(), _read_results(artifact), strict=True))
    reasons = artifact.attributes_of("failures")
    states = artifact.read("status").tolist()
    return [
        RunRecord(_point(values), states[k], results.get(k), str(reasons.get(str(k), "")))
        for k, values in enumerate(artifact.read("parameters"))
    ]


def _read_results(artifact: Artifact) -> list[RunResult]:
    numbers = artifact.read("complete").tolist()
    if not numbers:
        return []
    time, errors = artifact.read("time"), _read_errors(artifact)
    steps, energies, speeds = (artifact.read(name).tolist() for name in _FIGURES)
    coordinates, velocities, pressures = (
        artifact.read(name) if name in artifact else [None] * len(numbers) for name in _SERIES
    )
    return [
        RunResult(
            time=time,
            time_step=steps[k],
            kinetic_energy=energies[k],
            largest_speed=speeds[k],
            coordinates=coordinates[k],
            probe_velocity=velocities[k],
            probe_pressure=pressures[k],
            errors=errors.get(number),
        )
        for k, number in enumerate(numbers)
    ]


def _read_errors(artifact: Artifact) -> dict[int, EstimatedErrors]:
    if "error_estimate/run" not in artifact:
        return {}
    names = ("run", *FIELDS, "extrapolated")
    columns = (artifact.read(f"error_estimate/{name}").tolist() for name in names)
    return {
        run: EstimatedErrors(velocity, pressure, bool(outside))
        for run, velocity, pressure, outside in zip(*columns, strict=True)
    }
