"""What the artifacts say of a run: its fields at an instant, its line, and Eq. 4.1 over time."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sphrom.artifacts import Artifact, read_record
from sphrom.artifacts.records.comparison import Ranges
from sphrom.artifacts.records.comparison import Samples as StoredSamples
from sphrom.case.points import ParameterPoint
from sphrom.case.sections import ReducedModelSection
from sphrom.compare.artifact import FULL_LINE, group_of
from sphrom.metrics.discrepancy import relative_discrepancy
from sphrom.metrics.samples import Samples
from sphrom.online.rebuilt_run import RebuiltRun
from sphrom.reduction.trial_basis import TrialBasis, truncate
from sphrom.store.basis import read_basis, read_points
from sphrom.store.operators import sized
from sphrom.store.workspace import Workspace

if TYPE_CHECKING:
    from collections.abc import Iterator

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Snapshot:
    """The fields of a run at one instant, where they are known."""

    time: float
    """[s]"""
    last: bool
    """Whether the run became unstable before the instant that was asked for."""
    position: Array
    """(n_points, 2) [m]"""
    values: Mapping[str, Array]
    """(n_points,) `speed` [m/s] and `pressure` [Pa]."""


class StoredRuns:
    """The runs of a case, full and reduced, as their artifacts have them."""

    def __init__(self, workspace: Workspace) -> None:
        self._workspace = workspace
        self._case = workspace.case
        self._bases: dict[str, TrialBasis] = {}
        self._points: Array | None = None

    def snapshot(
        self, model: ReducedModelSection | None, point: ParameterPoint, time: float
    ) -> Snapshot | None:
        """Return the fields of a run, None for the full one, nearest to an instant [s].

        None where the run became unstable before it began.
        """
        if model is None:
            target = self._workspace.full_run(point)
        else:
            target = self._workspace.reduced_run(model, point)
        with self._workspace.open(target) as run:
            times = run.read("time")
            if not len(times):
                return None
            index = int(np.argmin(np.abs(times - time)))
            last = run.text("status") != "complete" and time > times[-1]
            if model is None or model.on_particles:
                position = run.dataset("position")[index]
                velocity = run.dataset("velocity")[index]
                pressure = run.dataset("pressure")[index]
            else:
                position = self._reference_points()
                velocity, pressure = self._rebuilt(model, point, run).fields(index)
        values = {"speed": np.hypot(*np.asarray(velocity).T), "pressure": np.asarray(pressure)}
        return Snapshot(float(times[index]), last, np.asarray(position), values)

    def _reference_points(self) -> Array:
        if self._points is None:
            self._points = read_points(self._workspace)
        return self._points

    def _rebuilt(
        self, model: ReducedModelSection, point: ParameterPoint, run: Artifact
    ) -> RebuiltRun:
        name = self._case.basis_for(model, point)
        if name not in self._bases:
            self._bases[name] = read_basis(self._workspace, name)
        n_modes = sized(self._workspace, model, point).size
        return RebuiltRun(run, truncate(self._bases[name], n_modes), self._case.sound_speed)


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
        return read_record(self._artifact, Ranges, f"ranges/{point.file_label}")
