"""The runs of a sweep as records, written to an artifact and read back.

A part of a sweep and the whole of it have the same schema: what is kept of a run does not depend on
the runs that it was made with.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter, read_record, write_record
from sphrom.artifacts.records.sweep import Estimates, Measured, Statistics, Sweep
from sphrom.case.points import ParameterPoint
from sphrom.metrics.measures import Quantities

Array = NDArray[np.float64]

COMPLETE, UNSTABLE, FAILED, NOT_RUN = 0, 1, 2, 3
BLOCK = 256
"""Runs that are written at once."""
STATES = ("complete", "unstable", "failed", "not run")
"""Words for them."""


@dataclass(frozen=True)
class EstimatedErrors:
    """Root mean squares over a run, over those of the fields [%]."""

    velocity: float
    pressure: float
    extrapolated: bool
    """Whether the run is outside of what its model was trained on."""
    over_time: Array | None = None
    """(2, n_snapshots) root mean squares of errors of velocity [m/s] and pressure [Pa]."""


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
    energies: Array | None = None
    """(n_snapshots,) kinetic energy [J/m]."""
    coordinates: Array | None = None
    """(n_snapshots, n_modes)."""
    probe_velocity: Array | None = None
    """(n_snapshots, n_probes, 2) [m/s]."""
    probe_pressure: Array | None = None
    """(n_snapshots, n_probes) [Pa]."""
    errors: EstimatedErrors | None = None
    """Estimated."""
    derivatives: Mapping[str, float] = field(default_factory=dict)
    """Of figures by parameters, such as `kinetic_energy_by_lid`."""
    measured: Mapping[str, Quantities] = field(default_factory=dict)
    """What the case measures, by name, as `of_a_run` keeps it."""


@dataclass(frozen=True)
class RunRecord:
    """One run of a sweep: its result, or why there is none."""

    point: ParameterPoint
    status: int
    result: RunResult | None = None
    reason: str = ""


def write_records(
    artifact: ArtifactWriter,
    model: str,
    records: Sequence[RunRecord],
    places: Array,
    statistics: Statistics | None = None,
) -> None:
    """Write runs of a model in their order; `places` (n_probes, 2) [m] are those of the probes."""
    complete = {k: r.result for k, r in enumerate(records) if r.result is not None}
    results = list(complete.values())
    stored = Sweep(
        model=model,
        parameter_names=",".join(records[0].point.as_dict()),
        parameters=np.array([list(r.point.as_dict().values()) for r in records]),
        status=np.array([record.status for record in records], dtype=np.int64),
        failures={str(k): record.reason for k, record in enumerate(records) if record.reason},
        complete=np.array(list(complete), dtype=np.int64),
        time_step=np.array([result.time_step for result in results]),
        kinetic_energy=np.array([result.kinetic_energy for result in results]),
        largest_speed=np.array([result.largest_speed for result in results]),
        kinetic_energy_over_time=_stacked([result.energies for result in results]),
        time=results[0].time if results else None,
        error_estimate=_estimates(complete),
        derivatives=_derivatives(results),
        derivative_names=",".join(results[0].derivatives) or None if results else None,
        statistics=statistics,
    )
    write_record(artifact, stored)
    # Block by block: together they may not fit into the memory a second time.
    if results:
        _write_stacked(artifact, "generalized_coordinates", [r.coordinates for r in results])
    if results and len(places):
        artifact.write("probes/position", places)
        _write_stacked(artifact, "probes/velocity", [r.probe_velocity for r in results])
        _write_stacked(artifact, "probes/pressure", [r.probe_pressure for r in results])
    for name, first in results[0].measured.items() if results else ():
        if not all(name in result.measured for result in results):
            continue  # some are of a version that didn't keep it
        for quantity in first:
            each = [result.measured[name][quantity] for result in results]
            _write_stacked(artifact, f"measure/{name}/{quantity}", each)


def _derivatives(results: Sequence[RunResult]) -> Array | None:
    if not results or not results[0].derivatives:
        return None
    return np.array([list(result.derivatives.values()) for result in results])


def _estimates(complete: Mapping[int, RunResult]) -> Estimates | None:
    estimated = {k: r.errors for k, r in complete.items() if r.errors is not None}
    if not estimated:
        return None
    errors = list(estimated.values())
    over_time = _stacked([each.over_time for each in errors])
    return Estimates(
        run=np.array(list(estimated), dtype=np.int64),
        velocity=np.array([each.velocity for each in errors]),
        pressure=np.array([each.pressure for each in errors]),
        extrapolated=np.array([each.extrapolated for each in errors], dtype=np.int64),
        velocity_over_time=None if over_time is None else over_time[:, 0],
        pressure_over_time=None if over_time is None else over_time[:, 1],
    )


def _stacked(arrays: Sequence[Array | None]) -> Array | None:
    """Return arrays of all runs, None where some have none."""
    found = [array for array in arrays if array is not None]
    return np.stack(found) if found and len(found) == len(arrays) else None


def _write_stacked(artifact: ArtifactWriter, name: str, arrays: Sequence[Array | None]) -> None:
    """Write arrays of all runs block by block, if runs have them."""
    first = arrays[0]
    if first is None:
        return
    stream = artifact.stream(name, first.shape, len(arrays))
    for k in range(0, len(arrays), BLOCK):
        stream.extend(np.stack([np.asarray(array) for array in arrays[k : k + BLOCK]]))


def read_points(
    artifact: Artifact, states: Sequence[int] = (COMPLETE, UNSTABLE)
) -> list[ParameterPoint]:
    """Return the points of the runs that ended in one of some ways."""
    chosen = np.isin(artifact.read("status"), states)
    names = artifact.text("parameter_names").split(",")
    return [_point(names, values) for values in artifact.read("parameters")[chosen]]


def _point(names: Sequence[str], values: Array) -> ParameterPoint:
    reynolds, *others = values.tolist()
    return ParameterPoint(reynolds, tuple(zip(names[1:], others, strict=True)))


def read_records(artifact: Artifact) -> list[RunRecord]:
    """Read all runs of an artifact."""
    stored = read_record(artifact, Sweep)
    errors = _errors(stored.error_estimate)
    results = {
        number: _result(stored, k, errors.get(number))
        for k, number in enumerate(stored.complete.tolist())
    }
    names = stored.parameter_names.split(",")
    return [
        RunRecord(_point(names, values), status, results.get(k), stored.failures.get(str(k), ""))
        for k, (values, status) in enumerate(
            zip(stored.parameters, stored.status.tolist(), strict=True)
        )
    ]


def _result(stored: Sweep, k: int, errors: EstimatedErrors | None) -> RunResult:
    """Return what is stored of a complete run."""
    coordinates, probes = stored.generalized_coordinates, stored.probes
    return RunResult(
        time=np.asarray(stored.time),
        time_step=float(stored.time_step[k]),
        kinetic_energy=float(stored.kinetic_energy[k]),
        largest_speed=float(stored.largest_speed[k]),
        energies=_of_run(stored.kinetic_energy_over_time, k),
        coordinates=None if coordinates is None else coordinates[k],
        probe_velocity=None if probes is None else probes.velocity[k],
        probe_pressure=None if probes is None else probes.pressure[k],
        errors=errors,
        measured={name: _measured(each, k) for name, each in stored.measure.items()},
        derivatives=_derivatives_of(stored, k),
    )


def _of_run(values: Array | None, k: int) -> Array | None:
    return None if values is None else values[k]


def _derivatives_of(stored: Sweep, k: int) -> dict[str, float]:
    if stored.derivatives is None or stored.derivative_names is None:
        return {}
    return dict(
        zip(stored.derivative_names.split(","), stored.derivatives[k].tolist(), strict=True)
    )


def _measured(stored: Measured, k: int) -> Quantities:
    return {name: values[k] for name, values in vars(stored).items() if values is not None}


def _errors(stored: Estimates | None) -> dict[int, EstimatedErrors]:
    if stored is None:
        return {}
    columns = (stored.run, stored.velocity, stored.pressure, stored.extrapolated)
    over_time: Sequence[Array | None] = [None] * len(stored.run)
    if stored.velocity_over_time is not None and stored.pressure_over_time is not None:
        over_time = list(np.stack((stored.velocity_over_time, stored.pressure_over_time), axis=1))
    rows = zip(*(c.tolist() for c in columns), over_time, strict=True)
    return {
        run: EstimatedErrors(velocity, pressure, bool(outside), each)
        for run, velocity, pressure, outside, each in rows
    }
