"""What `compare` stores: errors over time, lines and stations, and the reference profiles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter
from sphrom.compare.error_rows import EQ41, PLACES, ErrorRow
from sphrom.compare.figures_of_merit import History
from sphrom.compare.point_results import Excerpt, PointResults
from sphrom.compare.reference_errors import ReferenceRow
from sphrom.store.sampling import Probes, Samples
from sphrom.text import exact

Array = NDArray[np.float64]


def write_results(artifact: ArtifactWriter, result: PointResults, probes: Probes) -> None:
    """Store every history, the centrelines and stations, and the reference profiles."""
    place = result.point.file_label
    for comparison in (c for c in result.comparisons if len(c.history.time)):
        group = f"series/{_group_name(comparison.row)}/{place}"
        for name, values in _series(comparison.history):
            artifact.write(f"{group}/{name}", values)
        for name, value in _numbers(comparison.row):
            artifact.annotate(f"{group}/{name}", value)
    for name, excerpt in _excerpts(result):
        group = f"centreline/{name}/{place}"
        artifact.write(f"{group}/position", probes.line)
        _write_samples(artifact, group, excerpt.line)
        if len(probes.stations):
            group = f"stations/{name}/{place}"
            artifact.write(f"{group}/position", probes.stations)
            _write_samples(artifact, group, excerpt.stations)
    for compared in result.references:
        group = f"reference/{_reference_name(compared.row)}/{place}"
        artifact.write(f"{group}/coordinate", compared.coordinate)
        artifact.write(f"{group}/reference_value", compared.reference_value)
        artifact.write(f"{group}/value", compared.value)
        artifact.write(f"{group}/scatter", compared.scatter)


def _write_samples(artifact: ArtifactWriter, group: str, samples: Samples) -> None:
    artifact.write(f"{group}/time", samples.time)
    artifact.write(f"{group}/velocity", samples.velocity)
    artifact.write(f"{group}/pressure", samples.pressure)


def _series(history: History) -> Iterator[tuple[str, Array]]:
    """Yield the errors over time by name, those near walls among them where there are any."""
    yield "time", history.time
    for place in PLACES:
        series = getattr(history, place)
        for measure in ("relative_l2", *EQ41):
            yield f"{place}_{measure}", getattr(series, measure)
    for f in fields(history.walls) if history.walls is not None else ():
        yield f.name, getattr(history.walls, f.name)


def _reference_name(described: ReferenceRow) -> str:
    """Return an HDF5 group's name for a reference profile."""
    instant = "" if described.reference_time is None else f"-t{exact(described.reference_time)}"
    return f"{described.profile} {described.state}{instant} {described.source}".replace(" ", "-")


def _group_name(described: ErrorRow) -> str:
    """Return an HDF5 group's name for a comparison."""
    name = described.compared.replace(", ", "-").replace(" ", "-").replace("=", "")
    return f"{name}-against-{described.against}"


def _numbers(described: ErrorRow) -> Iterator[tuple[str, float | str]]:
    yield "status", described.status
    for f in fields(described):
        value = getattr(described, f.name)
        if isinstance(value, float):
            yield f.name, value


def _excerpts(result: PointResults) -> Iterator[tuple[str, Excerpt]]:
    yield "full", result.full
    for comparison in result.comparisons:
        if comparison.row.against == "full" and len(comparison.history.time):
            yield _group_name(comparison.row), comparison.excerpt
