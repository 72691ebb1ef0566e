"""Samples and errors of runs over time, which `compare` stores and reads to draw figures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

import numpy as np

from sphrom.arrays import Array
from sphrom.artifacts import Artifact, ArtifactWriter, read_record, write_record
from sphrom.artifacts.records.comparison import Ranges, ReferenceProfile, Series
from sphrom.artifacts.records.comparison import Samples as StoredSamples
from sphrom.case.points import ParameterPoint
from sphrom.case.study_sections import FULL
from sphrom.compare.comparison_tables import ErrorRow
from sphrom.compare.references import ReferenceRow
from sphrom.metrics.histories import History, instantaneous_range, relative_discrepancy
from sphrom.metrics.measures import Probes, Samples
from sphrom.plots.tables import flat
from sphrom.store.workspace import Workspace
from sphrom.text import exact


class ComparisonWriter:
    """Writes the comparisons at one parameter point."""

    def __init__(self, artifact: ArtifactWriter, point: ParameterPoint, probes: Probes) -> None:
        self.point = point
        self.probes = probes
        self._artifact = artifact
        self._label = point.file_label

    def full_run(self, samples: Samples) -> None:
        """Write the full run on the line and at the stations, and its ranges."""
        speed, pressure = map(instantaneous_range, (samples.speed, samples.pressure))
        ranges = Ranges(time=samples.time, speed=speed, pressure=pressure)
        write_record(self._artifact, ranges, f"ranges/{self._label}")
        self._samples(FULL, samples)

    def run(self, row: ErrorRow, history: History, samples: Samples) -> None:
        """Write the errors over time and the samples of a run, if it has errors."""
        if not len(history.time):
            return
        group = group_of(row.compared, row.against)
        places = history.places.items()
        series = Series(
            time=history.time,
            relative_l2={f"{place}_relative_l2": errors.relative_l2 for place, errors in places},
            over_rms={f"{place}_l2_over_rms": errors.over_rms for place, errors in places},
            eq41={
                f"{place}_{name}": values
                for place, errors in places
                for name, values in errors.eq41.items()
            },
            status=row.status,
            figures={name: v for name, v in flat(row).items() if isinstance(v, float)},
        )
        write_record(self._artifact, series, f"series/{group}/{self._label}")
        if row.against == FULL:
            self._samples(group, samples)

    def profile(self, row: ReferenceRow, profile: ReferenceProfile) -> None:
        """Write the profiles of a reference and of the full run."""
        write_record(self._artifact, profile, f"reference/{_reference_name(row)}/{self._label}")

    def _samples(self, name: str, samples: Samples) -> None:
        parts = (("centreline", self.probes.line, self.probes.on_line),
                 ("stations", self.probes.stations, self.probes.at_stations))  # fmt: skip
        for kind, position, where in parts:
            if len(position):
                velocity, pressure = samples.velocity[:, where], samples.pressure[:, where]
                stored = StoredSamples(
                    position=position, time=samples.time, velocity=velocity, pressure=pressure
                )
                write_record(self._artifact, stored, f"{kind}/{name}/{self._label}")


def _reference_name(row: ReferenceRow) -> str:
    instant = "" if row.reference_time is None else f"-t{exact(row.reference_time)}"
    return f"{row.profile} {row.state}{instant} {row.source}".replace(" ", "-")


def group_of(compared: str, against: str = FULL) -> str:
    """Return the name of the HDF5 group of a comparison."""
    name = compared.replace(", ", "-").replace(" ", "-").replace("=", "")
    return f"{name}-against-{against}"


class StoredComparison:
    """The stored comparisons of a case; runs are selected by name, and None is the full run."""

    def __init__(self, workspace: Workspace, artifact: Artifact) -> None:
        self.workspace = workspace
        self._artifact = artifact

    @classmethod
    @contextmanager
    def of(cls, workspace: Workspace) -> Iterator[StoredComparison]:
        """Open the comparison of a case. Raises ArtifactError when it is missing or not valid."""
        with workspace.open(workspace.comparison()) as artifact:
            yield cls(workspace, artifact)

    def samples(
        self, run: str | None, point: ParameterPoint, at: Literal["line", "stations"] = "line"
    ) -> tuple[Array, Samples]:
        """Return the points of the line or the stations (n_points, 2) [m], and a run's samples.

        The samples of an unstable run end at its last snapshot, and may be empty.
        """
        kind = "centreline" if at == "line" else at
        group = f"{kind}/{FULL if run is None else group_of(run)}/{point.file_label}"
        if f"{group}/time" not in self._artifact:
            return np.empty((0, 2)), Samples(np.empty(0), np.empty((0, 0, 2)), np.empty((0, 0)))
        stored = read_record(self._artifact, StoredSamples, group)
        return stored.position, Samples(stored.time, stored.velocity, stored.pressure)

    def has_errors(self, run: str, point: ParameterPoint) -> bool:
        """Return whether there are errors of a run against the full one."""
        return f"series/{group_of(run, FULL)}/{point.file_label}/time" in self._artifact

    def errors(self, run: str, point: ParameterPoint, against: str = FULL) -> Series | None:
        """Return the errors of a run over time, or None."""
        group = f"series/{group_of(run, against)}/{point.file_label}"
        if f"{group}/time" not in self._artifact:
            return None
        return read_record(self._artifact, Series, group)

    def profile(self, row: ReferenceRow, point: ParameterPoint) -> ReferenceProfile:
        """Return the profiles of a reference and of the full run."""
        group = f"reference/{_reference_name(row)}/{point.file_label}"
        return read_record(self._artifact, ReferenceProfile, group)

    def discrepancy(
        self, run: str, point: ParameterPoint, quantity: str, over: str
    ) -> tuple[Array, Array]:
        """Return times [s] and errors of Eq. 4.1 [%] of a run's `speed` or `pressure` on the line.

        Errors are divided by the range on the `line`, or with `over="field"` of the whole field.
        Times at which the full run has no range are left out.
        """
        full, reduced = self.samples(None, point)[1], self.samples(run, point)[1]
        n_common = len(reduced.time)
        if not n_common:
            return np.empty(0), np.empty(0)
        expected, actual = (getattr(s.at(slice(n_common)), quantity) for s in (full, reduced))
        ranges = instantaneous_range(expected)
        if over == "field":
            stored = read_record(self._artifact, Ranges, f"ranges/{point.file_label}")
            ranges = getattr(stored, quantity)[:n_common]
        varied = ranges > 0.0
        errors = relative_discrepancy(actual[varied], expected[varied], ranges[varied])
        return full.time[:n_common][varied], errors
