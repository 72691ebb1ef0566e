"""The artifact of `compare`: errors over time, lines and stations, and the reference profiles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import ArtifactWriter, write_record
from sphrom.artifacts.records.comparison import ReferenceProfile, Samples, Series
from sphrom.compare.point_results import Comparison, Excerpt, PointResults
from sphrom.compare.reference_errors import ReferenceRow
from sphrom.metrics.histories import EQ41, PLACES
from sphrom.metrics.samples import Probes
from sphrom.plots.tables import flat
from sphrom.text import exact

Array = NDArray[np.float64]

FULL_LINE = "full"
"""What the full run is called among lines and stations."""


def write_results(artifact: ArtifactWriter, result: PointResults, probes: Probes) -> None:
    """Store every history, the centrelines and stations, and the reference profiles."""
    place = result.point.file_label
    write_record(artifact, result.ranges, f"ranges/{place}")
    for comparison in (c for c in result.comparisons if len(c.history.time)):
        row = comparison.row
        group = f"series/{group_of(row.compared, row.against)}/{place}"
        write_record(artifact, _series(comparison), group)
    for name, excerpt in _excerpts(result):
        line = Samples.of(excerpt.line, position=probes.line)
        write_record(artifact, line, f"centreline/{name}/{place}")
        if len(probes.stations):
            stations = Samples.of(excerpt.stations, position=probes.stations)
            write_record(artifact, stations, f"stations/{name}/{place}")
    for compared in result.references:
        group = f"reference/{_reference_name(compared.row)}/{place}"
        write_record(artifact, ReferenceProfile.of(compared), group)


def _series(comparison: Comparison) -> Series:
    """Return the errors over time by name, with the errors near walls if there are walls."""
    history, figures = comparison.history, flat(comparison.row)

    def errors(*measures: str) -> dict[str, Array]:
        named = [(place, measure) for place in PLACES for measure in measures]
        return {f"{p}_{measure}": getattr(history.places[p], measure) for p, measure in named}

    return Series(
        time=history.time,
        relative_l2=errors("relative_l2"),
        eq41=errors(*EQ41),
        walls=dict(history.walls),
        status=comparison.row.status,
        figures={name: value for name, value in figures.items() if isinstance(value, float)},
    )


def _reference_name(described: ReferenceRow) -> str:
    """Return an HDF5 group's name for a reference profile."""
    instant = "" if described.reference_time is None else f"-t{exact(described.reference_time)}"
    return f"{described.profile} {described.state}{instant} {described.source}".replace(" ", "-")


def group_of(compared: str, against: str = "full") -> str:
    """Return an HDF5 group's name for a comparison."""
    name = compared.replace(", ", "-").replace(" ", "-").replace("=", "")
    return f"{name}-against-{against}"


def _excerpts(result: PointResults) -> Iterator[tuple[str, Excerpt]]:
    yield FULL_LINE, result.full
    for comparison in result.comparisons:
        if comparison.row.against == "full" and len(comparison.history.time):
            yield group_of(comparison.row.compared), comparison.excerpt
