"""The results at one parameter point, as `compare` finds them, stores them and reads them back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, ArtifactWriter, read_record, write_record
from sphrom.artifacts.records.comparison import Ranges, ReferenceProfile, Series
from sphrom.artifacts.records.comparison import Samples as StoredSamples
from sphrom.case.points import ParameterPoint
from sphrom.compare.costs import RunTiming
from sphrom.compare.measured import Compared, ForceRow, MeasureRow
from sphrom.compare.references import ProfileComparison, ReferenceRow
from sphrom.compare.rows import BEST, ErrorRow, EstimateRow
from sphrom.errors import ArtifactError
from sphrom.metrics.discrepancy import relative_discrepancy
from sphrom.metrics.histories import EQ41, PLACES, History
from sphrom.metrics.samples import Probes, Samples
from sphrom.metrics.series import FlowRow
from sphrom.plots.tables import flat
from sphrom.store.workspace import Workspace
from sphrom.text import exact

Array = NDArray[np.float64]

FULL_LINE = "full"
"""The name of the full run among lines and stations."""
OLDER = "has no ranges of the full run, as older ones; `sphrom compare CASE --force` makes it again"


@dataclass(frozen=True)
class Excerpt:
    """Samples that plots show: line and stations at all times, all probes at one."""

    line: Samples
    stations: Samples
    middle: Samples
    """The snapshot half way through the run alone."""

    @classmethod
    def of(cls, samples: Samples, probes: Probes, middle: int) -> Excerpt:
        """Take the excerpt of samples; a run that ended before the middle gives its end."""
        instant = slice(min(middle, len(samples.time) - 1), middle + 1)
        return cls(
            line=_part(samples, probes.on_line),
            stations=_part(samples, probes.at_stations),
            middle=Samples(
                samples.time[instant],
                samples.velocity[instant].copy(),
                samples.pressure[instant].copy(),
            ),
        )


def _part(samples: Samples, probes: slice) -> Samples:
    """Return the samples at some probes, as copies that keep nothing else alive."""
    return Samples(
        samples.time, samples.velocity[:, probes].copy(), samples.pressure[:, probes].copy()
    )


@dataclass(frozen=True)
class Comparison:
    """One run, or stand-in for a run, against a reference at one parameter point."""

    excerpt: Excerpt
    history: History
    row: ErrorRow


@dataclass
class PointResults:
    """All results at one parameter point; the lists fill while it is compared."""

    point: ParameterPoint
    models: list[str]
    """The reduced models that are run here, by name."""
    full: Excerpt
    exact: Excerpt | None
    ranges: Ranges
    """Of the full run."""
    comparisons: list[Comparison] = field(default_factory=list)
    timings: list[RunTiming] = field(default_factory=list)
    references: list[ProfileComparison] = field(default_factory=list)
    flows: list[FlowRow] = field(default_factory=list)
    estimates: list[EstimateRow] = field(default_factory=list)
    measured: list[Compared] = field(default_factory=list)

    def force_rows(self) -> list[ForceRow]:
        """Return the rows of forces."""
        return [row for each in self.measured for row in each.rows if isinstance(row, ForceRow)]

    def measure_rows(self) -> list[MeasureRow]:
        """Return the rows of flow rates, probes and lines; those of one quantity adjoin."""
        rows = [row for each in self.measured for row in each.rows if isinstance(row, MeasureRow)]
        order = list(dict.fromkeys((row.measured, row.quantity) for row in rows))
        return sorted(rows, key=lambda row: order.index((row.measured, row.quantity)))

    def against(self, reference: str) -> dict[str, Comparison]:
        """Return the comparisons with the `full` run or the `exact` solution, by run."""
        return {c.row.compared: c for c in self.comparisons if c.row.against == reference}

    def complete(self) -> dict[str, Comparison]:
        """Return the comparisons of the reduced models that ran to the end."""
        found = self.against("full")
        return {name: found[name] for name in self.models if found[name].row.status == "complete"}

    def full_against_exact(self) -> History | None:
        """Return the errors of the full run, None without an exact solution."""
        found = self.against("exact").get("full")
        return None if found is None else found.history

    def best(self) -> History | None:
        """Return the best possible errors in the largest basis that models use."""
        best = [c for name, c in self.against("full").items() if name.startswith(BEST)]
        return max(best, key=lambda c: c.row.n_modes or 0).history if best else None


def write_results(artifact: ArtifactWriter, result: PointResults, probes: Probes) -> None:
    """Store every history, the centrelines and stations, and the reference profiles."""
    place = result.point.file_label
    write_record(artifact, result.ranges, f"ranges/{place}")
    for comparison in (c for c in result.comparisons if len(c.history.time)):
        row = comparison.row
        group = f"series/{group_of(row.compared, row.against)}/{place}"
        write_record(artifact, _series(comparison), group)
    for name, excerpt in _excerpts(result):
        line = StoredSamples.of(excerpt.line, position=probes.line)
        write_record(artifact, line, f"centreline/{name}/{place}")
        if len(probes.stations):
            stations = StoredSamples.of(excerpt.stations, position=probes.stations)
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


class StoredComparison:
    """What `compare` found of a case, opened."""

    def __init__(self, artifact: Artifact) -> None:
        self._artifact = artifact

    @classmethod
    @contextmanager
    def of(cls, workspace: Workspace) -> Iterator[StoredComparison]:
        """Open the comparison of a case. Raises ArtifactError when it isn't there or valid."""
        with workspace.open(workspace.comparison()) as artifact:
            yield cls(artifact)

    def line(self, run: str | None, point: ParameterPoint) -> tuple[Array, Samples]:
        """Return where the line is (n_points, 2) [m], and a run there, None for the full one.

        A run that became unstable has so many instants as it has. One that did at once has none.
        """
        name = FULL_LINE if run is None else group_of(run)
        return self._samples("centreline", name, point)

    def station(self, run: str | None, point: ParameterPoint) -> Samples | None:
        """Return a run at the scene's stations, None where it has none."""
        name = FULL_LINE if run is None else group_of(run)
        if f"stations/{name}/{point.file_label}/time" not in self._artifact:
            return None
        return self._samples("stations", name, point)[1]

    def _samples(self, kind: str, name: str, point: ParameterPoint) -> tuple[Array, Samples]:
        group = f"{kind}/{name}/{point.file_label}"
        if f"{group}/time" not in self._artifact:
            empty = np.empty(0)
            return np.empty((0, 2)), Samples(empty, np.empty((0, 0, 2)), np.empty((0, 0)))
        stored = read_record(self._artifact, StoredSamples, group)
        return stored.position, Samples(stored.time, stored.velocity, stored.pressure)

    def is_complete(self, run: str, point: ParameterPoint) -> bool:
        """Return whether a run ran to the end."""
        name = f"series/{group_of(run)}/{point.file_label}/status"
        return name in self._artifact.attributes and self._artifact.text(name) == "complete"

    def discrepancy(
        self, run: str, point: ParameterPoint, quantity: str, over: str
    ) -> tuple[Array, Array]:
        """Return times [s] and Eq. 4.1 [%] of a run's `speed` or `pressure` on the line.

        `over` says whose range divides: that of the `line`, or of the whole `field`. Instants at
        which the full run has no range are left out.
        """
        full, reduced = self.line(None, point)[1], self.line(run, point)[1]
        n_common = len(reduced.time)
        if not n_common:
            return np.empty(0), np.empty(0)
        expected, found = (getattr(s.until(n_common), quantity) for s in (full, reduced))
        ranges = expected.max(axis=1) - expected.min(axis=1)
        if over == "field":
            ranges = getattr(self._ranges(point), quantity)[:n_common]
        told = ranges > 0.0
        span = np.stack((np.zeros(int(told.sum())), ranges[told]), axis=1)
        errors = relative_discrepancy(found[told], expected[told], range_over=span)
        return full.time[:n_common][told], errors

    def _ranges(self, point: ParameterPoint) -> Ranges:
        group = f"ranges/{point.file_label}"
        if f"{group}/time" not in self._artifact:
            raise ArtifactError(f"{self._artifact.path} {OLDER}")
        return read_record(self._artifact, Ranges, group)
