"""The results at one parameter point: every comparison, and the samples that plots show."""

from __future__ import annotations

from dataclasses import dataclass

from sphrom.artifacts.records.comparison import Ranges
from sphrom.case.points import ParameterPoint
from sphrom.compare.forces import ComparedForce
from sphrom.compare.measures import ComparedMeasure, MeasureRow
from sphrom.compare.reference_errors import ProfileComparison
from sphrom.compare.rows import ErrorRow, EstimateRow
from sphrom.compare.timings import RunTiming
from sphrom.metrics.flow import FlowRow
from sphrom.metrics.histories import History
from sphrom.metrics.samples import Probes, Samples


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


@dataclass(frozen=True)
class PointResults:
    """All results at one parameter point."""

    point: ParameterPoint
    full: Excerpt
    ranges: Ranges
    """Of the full run."""
    exact: Excerpt | None
    models: list[str]
    """The reduced models that are run here, by name."""
    comparisons: list[Comparison]
    timings: list[RunTiming]
    references: list[ProfileComparison]
    flows: list[FlowRow]
    estimates: list[EstimateRow]
    forces: list[ComparedForce]
    measures: list[ComparedMeasure]

    def measure_rows(self) -> list[MeasureRow]:
        """Return the rows of flow rates, probes and lines; those of one quantity adjoin."""
        rows = [row for each in self.measures for row in each.rows]
        order = list(dict.fromkeys((row.measured, row.quantity) for row in rows))
        return sorted(rows, key=lambda row: order.index((row.measured, row.quantity)))

    def histories(self, against: str) -> dict[str, History]:
        """Return the histories against the full run, or the exact solution, by name."""
        return {c.row.compared: c.history for c in self.comparisons if c.row.against == against}

    def excerpt_of(self, compared: str) -> Excerpt:
        """Return the excerpt of a run by its name."""
        return next(c.excerpt for c in self.comparisons if c.row.compared == compared)
